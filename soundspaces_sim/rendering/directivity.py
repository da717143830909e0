"""Directivities of sources and receivers, by name. What they do to an echogram is in `echogram.directed`.

An entry is a subclass of `echogram.endpoints.Directivity`. A new one is a class and a line below; where a
directivity is asked for its name does, for those that need no arguments.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.special import sph_harm_y

from soundspaces_sim.core.errors import ConfigError, SoundSpacesSimError
from soundspaces_sim.core.io.hdf5 import attribute, in_our_words, open_hdf5, plain_dataset, read_numbers
from soundspaces_sim.core.registry import Entry, find
from soundspaces_sim.echogram.endpoints import Directivity

_ROOM = "soundspaces_sim.rendering.directivity"
DIRECTIVITIES: Mapping[str, Entry] = {
    "omni": Entry(f"{_ROOM}:Omni", "alike in all directions"),
    "cardioid": Entry(f"{_ROOM}:Cardioid", "first-order patterns and their powers"),
    "by-frequency": Entry(f"{_ROOM}:FrequencyDependent", "a pattern for each of some frequencies"),
    "harmonics": Entry(f"{_ROOM}:SphericalHarmonics", "coefficients of any order"),
    "measured": Entry(f"{_ROOM}:MeasuredDirectivity", "a SOFA file (FreeFieldDirectivityTF)"),
    "talker": Entry(f"{_ROOM}:Talker", "a human talker, average of 15"),
}


def as_directivity(given: Directivity | str | None, what: str) -> Directivity | None:
    """The directivity that was given, itself or by name. Raises `ConfigError`."""
    if given is None or isinstance(given, Directivity):
        return given
    if not isinstance(given, str):
        raise ConfigError(f"{what}: expected a Directivity or its name, got {given!r}")
    kind = find(what, DIRECTIVITIES, given)
    try:
        return kind()
    except TypeError as error:
        raise ConfigError(
            f"{what}: {given!r} needs arguments ({error}); give soundspaces_sim.{kind.__name__}(…)"
        ) from None


_ANY_HZ = np.array([1000.0])  # of a pattern that does not depend on frequency


@dataclass(frozen=True, kw_only=True)
class Omni(Directivity):
    """Alike in all directions."""

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _ANY_HZ, np.ones((len(directions), 1))


@dataclass(frozen=True)
class Cardioid(Directivity):
    """Pressure (p + (1 - p) cos(theta))^order: `p` 1 omnidirectional, 0.75 subcardioid, 0.5 cardioid,
    0.25 hypercardioid, 0 figure of eight (the names of pyroomacoustics); `order` 2 and up is narrower.

    Raises `ConfigError` unless 0 <= p <= 1 and order is a whole number from 1 to 8.
    """

    p: float = 0.5
    order: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (isinstance(self.p, int | float | np.number) and 0.0 <= self.p <= 1.0):
            raise ConfigError(
                f"Cardioid: expected p from 0 (figure of eight) to 1 (omnidirectional), got {self.p!r}"
            )
        if self.order not in range(1, 9):
            raise ConfigError(f"Cardioid: expected an order from 1 to 8, got {self.order!r}")

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pressure = (self.p + (1.0 - self.p) * directions[:, :1]) ** self.order
        return _ANY_HZ, pressure**2


def _increasing(frequency: np.ndarray) -> bool:
    """Whether frequencies are above 0 and each is above the one before."""
    return bool((frequency > 0.0).all() and (np.diff(frequency) > 0.0).all())


@dataclass(frozen=True)
class FrequencyDependent(Directivity):
    """`patterns` at increasing `frequencies` in Hz, e.g. narrower cardioids higher up; between two of them
    the nearer one counts (geometrically), as with coefficients of materials.

    Turns and gains of the patterns count, their levels do not. Raises `ConfigError` unless there are as
    many of either, in order, and no pattern depends on frequency itself.
    """

    frequencies: tuple[float, ...]
    patterns: tuple[Directivity, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "frequencies", tuple(float(f) for f in self.frequencies))
        object.__setattr__(self, "patterns", tuple(self.patterns))
        f = np.array(self.frequencies)
        if len(f) == 0 or len(f) != len(self.patterns) or not _increasing(f):
            raise ConfigError(
                f"FrequencyDependent: expected increasing frequencies in Hz and as many patterns, got {len(f)} "
                f"frequencies {self.frequencies} and {len(self.patterns)} patterns"
            )
        for pattern in self.patterns:
            if not isinstance(pattern, Directivity) or pattern.energy(np.eye(3))[1].shape[1] != 1:
                raise ConfigError(
                    f"FrequencyDependent: expected patterns without frequencies of their own, got {pattern!r}"
                )

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        columns = [10.0 ** (p.gain_db / 10.0) * p.energy(directions @ p.turn)[1] for p in self.patterns]
        return np.array(self.frequencies), np.concatenate(columns, axis=1)


@dataclass(frozen=True)
class SphericalHarmonics(Directivity):
    """Pressure sum c_nm Y_nm, ACN order and SN3D normalisation; `coefficients` ((N + 1)^2,), real or
    complex, or (k, (N + 1)^2) at k increasing `frequencies` in Hz.

    Raises `ConfigError` if their number is not a square, or does not match the frequencies.
    """

    coefficients: tuple[complex, ...] | tuple[tuple[complex, ...], ...]
    frequencies: tuple[float, ...] = (1000.0,)

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            rows = np.atleast_2d(np.asarray(self.coefficients, complex))
            f = np.atleast_1d(np.asarray(self.frequencies, float))
        except (TypeError, ValueError) as error:
            raise ConfigError(
                f"SphericalHarmonics: expected numbers of shape (n,) or (k, n) ({error})"
            ) from None
        square = rows.ndim == 2 and math.isqrt(rows.shape[1]) ** 2 == rows.shape[1] > 0
        if not square or f.ndim != 1 or len(f) != len(rows) or not _increasing(f):
            raise ConfigError(
                "SphericalHarmonics: expected (N + 1)^2 coefficients at each of some increasing frequencies, got "
                f"coefficients {rows.shape} at {f.size} frequencies"
            )
        if not np.isfinite(rows).all():
            raise ConfigError("SphericalHarmonics: expected finite coefficients")
        object.__setattr__(self, "coefficients", tuple(map(tuple, rows.tolist())))
        object.__setattr__(self, "frequencies", tuple(f.tolist()))

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows = np.array(self.coefficients, complex)
        pressure = real_harmonics(directions, math.isqrt(rows.shape[1]) - 1) @ rows.T
        return np.array(self.frequencies), np.abs(pressure) ** 2


def real_harmonics(directions: np.ndarray, order: int) -> np.ndarray:
    """(n, (order + 1)^2) real spherical harmonics, ACN and SN3D, of unit vectors (n, 3)."""
    theta = np.arccos(np.clip(directions[:, 2], -1.0, 1.0))
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for n in range(order + 1):
        for m in range(-n, n + 1):
            # scipy's are orthonormal and carry the Condon-Shortley sign
            y = sph_harm_y(n, abs(m), theta, phi) * (-1.0) ** m * math.sqrt(4.0 * math.pi / (2 * n + 1))
            columns.append(y.real if m == 0 else math.sqrt(2.0) * (y.real if m > 0 else y.imag))
    return np.stack(columns, axis=1)


# A human talker, from published averages.
#
# Monson, Hunter & Story 2012, "Horizontal directivity of low- and high-frequency energy in speech and singing",
# J. Acoust. Soc. Am. 132(1), 433-441: octave-band levels of normal speech, mean of 15 talkers, in the horizontal
# plane at 60 cm, re the level in front. Elsewhere the pattern is taken to be symmetric about the mouth's axis; a
# real one is a few dB stronger below the mouth than above it.

_HZ = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16000.0])
_ANGLE_DEG = np.arange(0.0, 181.0, 15.0)
_LEVEL_DB = np.array([
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.8, 0.7, 0.6, -0.2, -1.0, -1.7, -1.0, -0.1],
    [-0.1, -0.2, 0.1, -0.7, -0.1, -0.7, -1.7, -0.5],
    [-0.4, -0.5, 0.0, -1.4, -0.8, -1.6, -3.1, -2.3],
    [-0.6, -0.8, -0.1, -1.5, -2.5, -3.9, -5.8, -4.4],
    [-1.1, -1.6, -0.7, -1.4, -4.7, -5.3, -7.0, -5.1],
    [-1.6, -2.3, -1.6, -1.6, -7.0, -6.3, -8.7, -7.2],
    [-2.1, -3.1, -2.8, -2.5, -7.6, -9.0, -11.5, -10.1],
    [-2.7, -3.9, -4.4, -4.6, -7.9, -12.7, -15.0, -14.2],
    [-3.1, -4.5, -5.5, -7.0, -9.3, -14.5, -17.8, -17.8],
    [-3.5, -4.9, -6.0, -7.9, -13.0, -16.7, -21.5, -21.7],
    [-3.6, -5.0, -6.0, -6.9, -15.0, -21.0, -25.0, -23.5],
    [-3.6, -5.1, -5.9, -6.3, -13.1, -18.9, -26.3, -26.7],
])  # fmt: skip


@cache
def _between() -> Callable[[np.ndarray], np.ndarray]:
    """dB at any angle in degrees, without overshoot between measured ones."""
    from scipy.interpolate import PchipInterpolator  # what renders without a talker does not load it

    return PchipInterpolator(_ANGLE_DEG, _LEVEL_DB)


@dataclass(frozen=True, kw_only=True)
class Talker(Directivity):
    """A person who speaks at a normal level towards the heading; the mouth is the source's position."""

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle = np.degrees(np.arccos(np.clip(directions[:, 0], -1.0, 1.0)))
        return _HZ, 10.0 ** (_between()(angle) / 10.0)


# Measured directivities: SOFA files of the convention FreeFieldDirectivityTF (AES69).

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
