"""Measured directivities: SOFA files of the convention FreeFieldDirectivityTF (AES69)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from soundspaces_sim.core.errors import ConfigError, SoundSpacesSimError
from soundspaces_sim.core.io.hdf5 import attribute, in_our_words, open_hdf5, plain_dataset, read_numbers
from soundspaces_sim.echogram.endpoints import Directivity

MOST_SAMPLES = 2**26  # of a dataset
_EXPECTED = "expected a SOFA file with Data.Real, Data.Imag, N and ReceiverPosition"
_AT_ONCE = 1 << 20  # directions times triangles looked at together


class DirectivityError(SoundSpacesSimError):
    """A directivity file is missing, or not a usable FreeFieldDirectivityTF SOFA file."""


@dataclass(frozen=True)
class MeasuredDirectivity(Directivity):
    """The pattern in a SOFA file, `measurement` counted from 0 (instruments have one per note).

    Between measured directions energies are interpolated linearly over the triangles of their convex hull;
    values are as in the file for level ``pattern``. The file's view and up vectors are its front and top.
    Raises `DirectivityError` if the file cannot be used.
    """

    path: str | Path
    measurement: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        _load(str(self.path), self.measurement)

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        data = _load(str(self.path), self.measurement)
        out = np.empty((len(directions), data.energy.shape[1]))
        step = max(_AT_ONCE // len(data.facets), 1)
        for first in range(0, len(directions), step):
            rows = slice(first, first + step)
            # a direction's weights of a triangle's corners; none is negative in the triangle it passes
            weight = np.einsum("fij,qj->qfi", data.inverse, directions[rows])
            facet = weight.min(axis=2).argmax(axis=1)
            share = np.maximum(weight[np.arange(len(facet)), facet], 0.0)
            share /= share.sum(axis=1, keepdims=True)
            out[rows] = np.einsum("qc,qck->qk", share, data.energy[data.facets[facet]])
        return data.frequency, out


class _Measured(NamedTuple):
    frequency: np.ndarray  # (k,) Hz
    directions: np.ndarray  # (R, 3) unit, own axes
    energy: np.ndarray  # (R, k)
    facets: np.ndarray  # (F, 3) corners
    inverse: np.ndarray  # (F, 3, 3) directions to weights of the corners


@lru_cache(maxsize=8)
def _load(path: str, measurement: int) -> _Measured:
    with (
        open_hdf5(Path(path), DirectivityError, "SOFA file", _EXPECTED) as sofa,
        in_our_words(path, DirectivityError, _EXPECTED),
    ):
        return _read(sofa, path, measurement)


def _read(sofa: h5py.File, path: str, measurement: int) -> _Measured:
    kind = attribute(sofa, "SOFAConventions", path, DirectivityError, _EXPECTED) or ""
    if kind != "FreeFieldDirectivityTF":
        raise DirectivityError(f"{path}: expected SOFA convention FreeFieldDirectivityTF, got {kind!r}")
    real, imag = (_item(sofa, name, path) for name in ("Data.Real", "Data.Imag"))
    frequency = np.ravel(_values(_item(sofa, "N", path), path))
    count = real.shape[0]
    if not 0 <= measurement < count:
        raise ConfigError(f"{path}: expected a measurement from 0 to {count - 1}, got {measurement!r}")
    energy = _values(real, path, measurement) ** 2 + _values(imag, path, measurement) ** 2
    if not (np.isfinite(energy).all() and np.isfinite(frequency).all() and (frequency >= 0.0).all()):
        raise DirectivityError(f"{path}: Data.Real, Data.Imag or N has values that cannot be")
    receivers = _item(sofa, "ReceiverPosition", path)
    position = _values(receivers, path)
    position = (
        position[:, :, min(measurement, position.shape[2] - 1)] if position.ndim == 3 else position
    )
    if energy.shape != (len(position), len(frequency)) or np.any(np.diff(frequency) <= 0.0):
        raise DirectivityError(
            f"{path}: expected increasing frequencies and data (measurements, receivers, frequencies), got "
            f"{real.shape} with {len(position)} receivers and {len(frequency)} frequencies"
        )
    directions = _unit(_cartesian(position, receivers, path), path)
    front = _vector(sofa, "SourceView", measurement, [1.0, 0.0, 0.0], path)
    top = _vector(sofa, "SourceUp", measurement, [0.0, 0.0, 1.0], path)
    left = np.cross(top, front)
    if np.linalg.norm(left) < 1e-6:
        raise DirectivityError(f"{path}: SourceView and SourceUp are parallel")
    left /= np.linalg.norm(left)
    directions = directions @ np.stack([front, left, np.cross(front, left)], axis=1)
    _, unique = np.unique(np.round(directions, 6), axis=0, return_index=True)
    directions, energy = directions[unique], energy[unique]
    try:
        hull = ConvexHull(directions)
    except (QhullError, ValueError) as error:
        raise DirectivityError(
            f"{path}: the {len(directions)} measured directions span no volume"
        ) from error
    if -hull.equations[:, 3].max() <= 1e-6:  # the centre must lie inside
        raise DirectivityError(
            f"{path}: expected directions all around, got {len(directions)} on one side"
        )
    inverse = np.linalg.inv(directions[hull.simplices].transpose(0, 2, 1))
    return _Measured(frequency, directions, energy, hull.simplices, inverse)


def _vector(sofa: h5py.File, name: str, row: int, default: list[float], path: str) -> np.ndarray:
    if name not in sofa:
        return np.array(default)
    item = _item(sofa, name, path)
    rows = np.atleast_2d(_values(item, path))
    return _unit(_cartesian(rows[[min(row, len(rows) - 1)]], item, path), path)[0]


def _values(item: h5py.Dataset, path: str, where: Any = ...) -> np.ndarray:
    return np.asarray(read_numbers(item, where, path, DirectivityError, _EXPECTED), float)


def _item(sofa: h5py.File, name: str, path: str) -> h5py.Dataset:
    found = plain_dataset(sofa, name, path, DirectivityError, _EXPECTED)
    if math.prod(found.shape) > MOST_SAMPLES:
        raise DirectivityError(
            f"{path}: {name} has more than {MOST_SAMPLES:,} values, which is the limit"
        )
    return found


def _cartesian(position: np.ndarray, item: h5py.Dataset, path: str) -> np.ndarray:
    kind = attribute(item, "Type", path, DirectivityError, _EXPECTED) or "cartesian"
    if kind == "cartesian":
        return position
    if kind != "spherical":
        raise DirectivityError(f"{path}: expected cartesian or spherical coordinates, got {kind!r}")
    azimuth, elevation = np.deg2rad(position[:, 0]), np.deg2rad(position[:, 1])
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)


def _unit(vectors: np.ndarray, path: str) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    if not (np.isfinite(length).all() and (length > 0.0).all()):
        raise DirectivityError(f"{path}: expected directions that are finite and not zero")
    return np.asarray(vectors / length)
