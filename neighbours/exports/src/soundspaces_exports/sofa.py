"""Export as SOFA (AES69): SingleRoomSRIR files of ambisonic responses, one per source with its listeners, or
one per listener with its sources.

Needs the sofar package (extra ``sofa``), which also checks each file against AES69-2022. What that leaves out and
older readers ask for (type and unit of every vector) is added.
"""

from __future__ import annotations

import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from soundspaces_sim import ConfigError, RirDataset
from soundspaces_sim.parts import (
    SECOND_ORDER_CHANNELS as CHANNELS,
    Convention,
    ExportPlan,
    ExportProgress as Progress,
    choose_pairs,
    convert_ambisonics as convert,
    install_hint,
    make_folder,
    publish_file as publish,
    response_samples_of as samples_of,
)

Per = Literal["source", "listener"]
_UNKNOWN = "not stated"
_TEXTS = "ReceiverDescriptions", "EmitterDescriptions"  # sofar 1.3 cannot write these with netCDF4 1.7
_UNSAID = (
    "RoomVolume",
    "RoomCorners",
    "RoomCornerA",
    "RoomCornerB",
)  # defaults would be taken for what was measured
_PACKED = 0.5  # of float64 samples that were float32, after compression


def plan_sofa(
    ds: RirDataset,
    out: str | Path,
    convention: Convention = "n3d",
    pairs: str | Path = "all",
    per: Per = "source",
) -> ExportPlan:
    """`out`/<scene>_source<i>.sofa for every source of the chosen pairs (see `plan.choose_pairs`), with its
    listeners; `per` ``listener``: <scene>_listener<i>.sofa with its sources. Raises `ConfigError`."""
    if find_spec("sofar") is None:
        raise ConfigError(f"SOFA export needs the sofar package: {install_hint('sofa')}")
    if per not in get_args(Per):
        raise ConfigError(f"per: expected {' or '.join(get_args(Per))}, got {per!r}")
    rows = choose_pairs(ds, pairs)
    column = get_args(Per).index(per)
    ends = np.unique(rows[:, column])
    places = [Path(out) / f"{ds.scene}_{per}{end}.sofa" for end in ends.tolist()]

    def write(progress: Progress) -> None:
        make_folder(Path(out))
        for done, (path, end) in enumerate(zip(places, ends.tolist(), strict=True)):
            title = f"{ds.scene}, {per} {end}"
            content = _sofa_bytes(ds, title, rows[rows[:, column] == end], convention)
            publish(path, content, durable=False)
            progress(done + 1, len(ends))

    size = int(len(rows) * CHANNELS * samples_of(ds) * 8 * _PACKED)
    return ExportPlan(Path(out), len(ends), size, write, places)


def _sofa_bytes(ds: RirDataset, title: str, pairs: np.ndarray, convention: Convention) -> bytes:
    """The file of some pairs (M, 2)."""
    import sofar

    config = ds.manifest.config
    fields, _ = ds.get_batch(pairs, "ambisonic")
    sofa = sofar.Sofa("SingleRoomSRIR")
    sofa.GLOBAL_Title = title
    sofa.GLOBAL_RoomType = "reverberant"
    sofa.GLOBAL_RoomDescription = f"simulated with soundspaces_sim {ds.manifest.code_version}"
    sofa.GLOBAL_ApplicationName = "soundspaces_sim"
    sofa.GLOBAL_ApplicationVersion = ds.manifest.code_version
    sofa.GLOBAL_References = config.dataset.citation
    sofa.GLOBAL_AuthorContact = config.dataset.author or _UNKNOWN
    sofa.GLOBAL_Organization = config.dataset.organization or _UNKNOWN
    if config.dataset.licence:
        sofa.GLOBAL_License = config.dataset.licence
    sofa.GLOBAL_Comment = (
        f"Ambisonics of order 2, ACN, {convention}; X = +x, Y = +y, Z = +z of the scene. Pressure of a "
        "source whose direct sound is sqrt(1 / (4 pi)) / r."
    )
    sofa.Data_IR = np.stack([convert(field, convention) for field in fields]).astype(float)
    sofa.Data_SamplingRate = float(ds.rate)
    sofa.Data_Delay = np.zeros((1, CHANNELS))
    sofa.ListenerPosition = ds.points[pairs[:, 1]]
    sofa.SourcePosition = ds.points[pairs[:, 0]]
    sofa.RoomTemperature = config.simulation.temperature_c + 273.15
    sofa.ReceiverPosition = np.zeros((CHANNELS, 3, 1))
    sofa.ReceiverPosition_Type = "spherical harmonics"
    sofa.ReceiverView = np.tile(np.array([[1.0], [0.0], [0.0]]), (CHANNELS, 1, 1))
    sofa.ReceiverUp = np.tile(np.array([[0.0], [0.0], [1.0]]), (CHANNELS, 1, 1))
    for optional in (*_TEXTS, *_UNSAID):
        sofa.delete(optional)
    for vector in ("ListenerUp", "ReceiverUp", "SourceUp", "EmitterUp"):
        sofa.add_attribute(f"{vector}_Type", "cartesian")
        sofa.add_attribute(f"{vector}_Units", "metre")
    sofa.MeasurementDate = np.zeros(len(pairs))
    sofa.verify()
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "one.sofa"
        sofar.write_sofa(str(path), sofa)
        return path.read_bytes()
