"""Export as SOFA (AES69): one SingleRoomSRIR file per source, its ambisonic responses at every listener.

Needs the sofar package (extra ``sofa``), which also checks each file against the standard.
"""

from __future__ import annotations

import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from soundspaces_sim.base.axes import CHANNELS
from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.base.files import make_folder, publish
from soundspaces_sim.exchange.plan import ExportPlan, Progress, carry_out, choose_pairs, samples_of
from soundspaces_sim.reading.dataset import RirDataset
from soundspaces_sim.sound.soundfield import Convention, convert

_PACKED = 0.5  # of float64 samples that were float32, after compression


def plan_sofa(
    ds: RirDataset, out: str | Path, convention: Convention = "n3d", pairs: str | Path = "all"
) -> ExportPlan:
    """`out`/<scene>_source<i>.sofa for every source of the chosen pairs (see `plan.choose_pairs`), with its
    listeners. Raises `ConfigError`."""
    if find_spec("sofar") is None:
        raise ConfigError("SOFA export needs the sofar package: `pip install soundspaces-sim[sofa]`")
    rows = choose_pairs(ds, pairs)
    sources = np.unique(rows[:, 0])

    def write(progress: Progress) -> None:
        folder = make_folder(Path(out))
        for done, s in enumerate(sources.tolist()):
            content = _sofa_bytes(ds, s, rows[rows[:, 0] == s, 1], convention)
            publish(folder / f"{ds.scene}_source{s}.sofa", content, durable=False)
            progress(done + 1, len(sources))

    size = int(len(rows) * CHANNELS * samples_of(ds) * 8 * _PACKED)
    return ExportPlan(Path(out), len(sources), size, write)


def export_sofa(
    ds: RirDataset,
    out: str | Path,
    convention: Convention = "n3d",
    progress: Progress | None = None,
    pairs: str | Path = "all",
) -> int:
    """Write the files of `plan_sofa`; their number. Raises `ConfigError`, `DatasetError`."""
    return carry_out(plan_sofa(ds, out, convention, pairs), progress)


def _sofa_bytes(ds: RirDataset, s: int, listeners: np.ndarray, convention: Convention) -> bytes:
    """The file of a source and its listeners."""
    import sofar

    count = len(listeners)
    config = ds.manifest.config.dataset
    fields, _ = ds.get_batch([(s, l) for l in listeners], "ambisonic")
    sofa = sofar.Sofa("SingleRoomSRIR")
    sofa.GLOBAL_Title = f"{ds.scene}, source {s}"
    sofa.GLOBAL_RoomType = "reverberant"
    sofa.GLOBAL_RoomDescription = f"simulated with soundspaces_sim {ds.manifest.code_version}"
    sofa.GLOBAL_ApplicationName = "soundspaces_sim"
    sofa.GLOBAL_ApplicationVersion = ds.manifest.code_version
    sofa.GLOBAL_References = config.citation
    if config.licence:
        sofa.GLOBAL_License = config.licence
    sofa.GLOBAL_Comment = (
        f"Ambisonics of order 2, ACN, {convention}; X = +x, Y = +y, Z = +z of the scene. Pressure of a "
        "source whose direct sound is sqrt(1 / (4 pi)) / r."
    )
    sofa.Data_IR = np.stack([convert(field, convention) for field in fields]).astype(float)
    sofa.Data_SamplingRate = float(ds.rate)
    sofa.Data_Delay = np.zeros((1, CHANNELS))
    sofa.ListenerPosition = ds.points[listeners]
    sofa.SourcePosition = np.repeat(ds.points[s : s + 1], count, axis=0)
    sofa.ReceiverPosition = np.zeros((CHANNELS, 3, 1))
    sofa.ReceiverPosition_Type = "spherical harmonics"
    sofa.ReceiverView = np.tile(np.array([[1.0], [0.0], [0.0]]), (CHANNELS, 1, 1))
    sofa.ReceiverUp = np.tile(np.array([[0.0], [0.0], [1.0]]), (CHANNELS, 1, 1))
    for optional in ("ReceiverDescriptions", "EmitterDescriptions"):
        sofa.delete(optional)  # sofar 1.3 cannot write arrays of strings with netCDF4 1.7
    sofa.MeasurementDate = np.zeros(count)
    sofa.verify()
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "one.sofa"
        sofar.write_sofa(str(path), sofa)
        return path.read_bytes()
