"""Export as SOFA (AES69): one SingleRoomSRIR file per source, its ambisonic responses at every listener.

Needs the sofar package (extra ``sofa``), which also checks each file against the standard.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.base.files import publish
from soundspaces_sim.exchange.wav import make_folder
from soundspaces_sim.reading.dataset import RirDataset
from soundspaces_sim.sound.ambisonics import CHANNELS
from soundspaces_sim.sound.soundfield import Convention, convert

Progress = Callable[[int, int], None]


def export_sofa(
    ds: RirDataset,
    out: str | Path,
    convention: Convention = "n3d",
    progress: Progress | None = None,
) -> int:
    """Write `out`/<scene>_source<i>.sofa for every source; the number of files. Raises `ConfigError`."""
    try:
        import sofar
    except ImportError:
        raise ConfigError(
            "SOFA export needs the sofar package: `pip install soundspaces-sim[sofa]`"
        ) from None
    folder = make_folder(Path(out))
    count = len(ds.points)
    config = ds.manifest.config.dataset
    for s in range(count):
        fields, _ = ds.get_batch([(s, l) for l in range(count)], "ambisonic")
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
        sofa.ListenerPosition = ds.points
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
            publish(folder / f"{ds.scene}_source{s}.sofa", path.read_bytes())
        if progress is not None:
            progress(s + 1, count)
    return count
