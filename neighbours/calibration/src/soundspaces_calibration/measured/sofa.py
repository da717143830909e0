"""Measured rooms from SOFA files (AES69): responses with positions of sources and listeners.

Any convention that has Data.IR (M, 1, N), or with ambisonic channels (of which the first is taken), and positions
in the scene's coordinates. Places have no names there: they are S1, S2, …, R1, R2, … in the order of the files.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from soundspaces_calibration.measured.collect import Collection
from soundspaces_calibration.measured.responses import add_response
from soundspaces_calibration.measured.room import MeasuredRoom
from soundspaces_sim import DatasetError
from soundspaces_sim.parts import (
    attribute,
    data_delay,
    delayed,
    in_our_words,
    open_hdf5,
    plain_dataset,
    read_numbers,
)

_MOST_SAMPLES = 2**28
_EXPECTED = "expected a SOFA file with Data.IR, Data.SamplingRate, SourcePosition and ListenerPosition"


def read_sofa(files: Sequence[Path]) -> MeasuredRoom:
    """The room of one or more files. Raises `DatasetError`."""
    out = Collection(", ".join(map(str, files[:3])))
    for path in files:
        with (
            open_hdf5(path, DatasetError, "SOFA file", _EXPECTED) as sofa,
            in_our_words(str(path), DatasetError, _EXPECTED),
        ):
            _add(sofa, str(path), out)
    return out.room()


def _add(sofa: h5py.File, path: str, out: Collection) -> None:
    responses = _item(sofa, "Data.IR", path)
    if responses.ndim not in (3, 4) or (responses.ndim == 4 and responses.shape[3] != 1):
        raise DatasetError(
            f"{path}: expected Data.IR of one emitter (M, R, N), got shape {responses.shape}"
        )
    ambisonic = "ReceiverPosition" in sofa and _kind(sofa, "ReceiverPosition", path).startswith(
        "spherical harmonics"
    )
    if responses.shape[1] != 1 and not ambisonic:
        raise DatasetError(
            f"{path}: expected one receiver, or ambisonic ones, got {responses.shape[1]}; write a file per "
            "microphone, with its place as ListenerPosition"
        )
    rate = float(np.ravel(_values(_item(sofa, "Data.SamplingRate", path), ..., path))[0])
    count = responses.shape[0]
    sources, listeners = (
        _positions(sofa, name, count, path) for name in ("SourcePosition", "ListenerPosition")
    )
    delay = data_delay(sofa, count, responses.shape[1], path, DatasetError)[:, 0]
    for m in range(count):
        where = f"{path}, measurement {m}"
        pair = out.sources.unnamed(sources[m], where), out.receivers.unnamed(listeners[m], where)
        response = delayed(np.ravel(_values(responses, (m, 0), path))[None], delay[m : m + 1])[0]
        add_response(out, pair, response, rate, where)


def _positions(sofa: h5py.File, name: str, count: int, path: str) -> np.ndarray:
    """(count, 3) m."""
    found = np.atleast_2d(_values(_item(sofa, name, path), ..., path))
    if found.shape not in ((1, 3), (count, 3)):
        raise DatasetError(f"{path}: expected {name} of shape (1, 3) or ({count}, 3), got {found.shape}")
    kind = _kind(sofa, name, path)
    unit = attribute(_item(sofa, name, path), "Units", path, DatasetError, _EXPECTED)
    words = [
        w.rstrip("s").replace("meter", "metre")
        for w in re.split(r"[\s,;]+", str(unit or "").lower())
        if w
    ]
    wanted = [["degree", "degree", "metre"]] if kind == "spherical" else [["metre"], ["metre"] * 3]
    if words and words not in wanted:
        raise DatasetError(
            f"{path}: {name} is {kind}, and its units are {unit!r}; expected {', '.join(wanted[-1])}"
        )
    if kind == "spherical":
        azimuth, elevation = np.deg2rad(found[:, 0]), np.deg2rad(found[:, 1])
        level = np.cos(elevation)
        around = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
        found = found[:, 2:] * np.stack(around, axis=1)
    elif kind != "cartesian":
        raise DatasetError(f"{path}: expected {name} as cartesian or spherical, got {kind!r}")
    return np.broadcast_to(found, (count, 3))


def _kind(sofa: h5py.File, name: str, path: str) -> str:
    found = attribute(_item(sofa, name, path), "Type", path, DatasetError, _EXPECTED)
    return str(found or "cartesian")


def _item(sofa: h5py.File, name: str, path: str) -> h5py.Dataset:
    found = plain_dataset(sofa, name, path, DatasetError, _EXPECTED)
    if math.prod(found.shape) > _MOST_SAMPLES:
        raise DatasetError(
            f"{path}: {name} has more than {_MOST_SAMPLES:,} values, which is the limit; split it into files of a "
            "folder"
        )
    return found


def _values(item: h5py.Dataset, where: object, path: str) -> np.ndarray:
    return np.asarray(read_numbers(item, where, path, DatasetError, _EXPECTED), float)
