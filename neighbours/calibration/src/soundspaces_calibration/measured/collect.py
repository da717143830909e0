"""What is measured of pairs, collected into a `MeasuredRoom`."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from soundspaces_calibration.measured.room import MEASURED, MeasuredRoom, octaves_between
from soundspaces_sim import DatasetError

_SAME = 1e-3  # m, within which positions of one name agree
_FARTHEST = 1e5  # m
_MOST_VALUES = 2**25  # of a room: all pairs, octaves and measures


@dataclass
class Places:
    """Named positions, in the order in which they come."""

    what: str  # "source" or "receiver"
    names: dict[str, int] = field(default_factory=dict)
    positions: list[np.ndarray] = field(default_factory=list)
    cubes: dict[tuple[int, ...], list[int]] = field(default_factory=dict)  # numbers by place, to `_SAME`

    def add(self, name: str, position: np.ndarray, where: str) -> int:
        """The number of a name. Raises `DatasetError` for positions that cannot be, or differ from before."""
        if not (np.abs(position) < _FARTHEST).all():
            raise DatasetError(
                f"{where}: expected a position of {self.what} '{name}' in m, got {_text(position)}"
            )
        number = self.names.setdefault(name, len(self.names))
        if number == len(self.positions):
            self.positions.append(position)
            self.cubes.setdefault(_cube(position), []).append(number)
        known = self.positions[number]
        if not np.abs(known - position).max() <= _SAME:
            raise DatasetError(
                f"{where}: {self.what} '{name}' is at {_text(position)} m, and was at {_text(known)} m before; "
                "give other places other names"
            )
        return number

    def unnamed(self, position: np.ndarray, where: str) -> int:
        """The number of a place without a name: S1, R1, …"""
        if (np.abs(position) < _FARTHEST).all():
            around = itertools.product(*((n - 1, n, n + 1) for n in _cube(position)))
            for number in sorted(n for cube in around for n in self.cubes.get(cube, ())):
                if np.abs(self.positions[number] - position).max() <= _SAME:
                    return number
        return self.add(f"{self.what[0].upper()}{len(self.names) + 1}", position, where)


def _cube(position: np.ndarray) -> tuple[int, ...]:
    return tuple(np.floor(position / _SAME).astype(np.int64).tolist())


def _text(position: np.ndarray) -> str:
    return "({:g}, {:g}, {:g})".format(*position)


@dataclass
class Collection:
    """Measures (measures,) with errors of pairs in octaves."""

    where: str
    sources: Places = field(default_factory=lambda: Places("source"))
    receivers: Places = field(default_factory=lambda: Places("receiver"))
    found: dict[tuple[int, int, float], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def add(
        self, pair: tuple[int, int], octave: float, values: np.ndarray, error: np.ndarray, where: str
    ) -> None:
        """Raises `DatasetError` where a pair comes twice, and for values that cannot be."""
        key = (*pair, octave)
        if key in self.found:
            raise DatasetError(
                f"{where}: this pair's octave of {octave:g} Hz was given before; give the mean of repeated "
                "measurements"
            )
        for name, value in zip(MEASURED, values, strict=True):
            low, high, unit = _POSSIBLE[name]
            if np.isnan(value) or low < value < high:
                continue
            percent = "; is it in per cent?" if name == "d50" and 1.0 <= value <= 100.0 else ""
            raise DatasetError(
                f"{where}: {name} must lie between {low:g} and {high:g}{unit}, got {value:g}{percent}"
            )
        for name, value in zip(MEASURED, error, strict=True):
            if not (np.isnan(value) or 0.0 < value < np.inf):
                raise DatasetError(
                    f"{where}: {name}_error must be a standard error above 0, got {value:g}"
                )
        self.found[key] = values, error

    def room(self) -> MeasuredRoom:
        """Raises `DatasetError` if there is nothing."""
        if not any(np.isfinite(values).any() for values, _ in self.found.values()):
            raise DatasetError(
                f"{self.where}: no {', '.join(MEASURED)} of any pair; expected at least one"
            )
        given = sorted({octave for _, _, octave in self.found})
        octaves = octaves_between(given[0], given[-1])
        shape = len(self.sources.names), len(self.receivers.names), len(MEASURED), len(octaves)
        if math.prod(shape) > _MOST_VALUES:
            raise DatasetError(
                f"{self.where}: {shape[0]:,} sources and {shape[1]:,} receivers are too many pairs; "
                "give few sources with all their receivers in each file"
            )
        values, error = np.full(shape, np.nan), np.full(shape, np.nan)
        for (s, r, octave), (one, off) in self.found.items():
            k = octaves.index(octave)
            values[s, r, :, k], error[s, r, :, k] = one, off
        return MeasuredRoom(
            tuple(self.sources.names),
            tuple(self.receivers.names),
            np.array(self.sources.positions),
            np.array(self.receivers.positions),
            octaves,
            values,
            error,
        )


_POSSIBLE = {
    "t30": (0.0, 100.0, " s"),
    "edt": (0.0, 100.0, " s"),
    "c80": (-60.0, 90.0, " dB"),
    "d50": (0.0, 1.0, ""),
}
