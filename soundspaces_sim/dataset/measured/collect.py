"""What is measured of pairs, collected into a `MeasuredRoom`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.dataset.measured.room import MEASURED, MeasuredRoom, octaves_between

_SAME = 1e-3  # m, within which positions of one name agree


@dataclass
class Places:
    """Named positions, in the order in which they come."""

    what: str  # "source" or "receiver"
    of_name: dict[str, np.ndarray] = field(default_factory=dict)

    def add(self, name: str, position: np.ndarray, where: str) -> int:
        """The number of a name. Raises `DatasetError` for positions that are not finite, or differ from before."""
        if not np.isfinite(position).all():
            raise DatasetError(
                f"{where}: expected a position of {self.what} '{name}' in m, got {_text(position)}"
            )
        known = self.of_name.setdefault(name, position)
        if not np.abs(known - position).max() <= _SAME:
            raise DatasetError(
                f"{where}: {self.what} '{name}' is at {_text(position)} m, and was at {_text(known)} m before; "
                "give other places other names"
            )
        return list(self.of_name).index(name)

    def unnamed(self, position: np.ndarray, where: str) -> int:
        """The number of a place without a name: S1, R1, …"""
        for number, known in enumerate(self.of_name.values()):
            if np.abs(known - position).max() <= _SAME:
                return number
        return self.add(f"{self.what[0].upper()}{len(self.of_name) + 1}", position, where)


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
        shape = len(self.sources.of_name), len(self.receivers.of_name), len(MEASURED), len(octaves)
        values, error = np.full(shape, np.nan), np.full(shape, np.nan)
        for (s, r, octave), (one, off) in self.found.items():
            k = octaves.index(octave)
            values[s, r, :, k], error[s, r, :, k] = one, off
        return MeasuredRoom(
            tuple(self.sources.of_name),
            tuple(self.receivers.of_name),
            np.array(list(self.sources.of_name.values())),
            np.array(list(self.receivers.of_name.values())),
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
