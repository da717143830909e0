"""What a calibration has found: fitted absorption, and measures before and after beside what was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soundspaces_calibration.fit_materials import MaterialFit
from soundspaces_calibration.measured.room import MEASURED, MeasuredRoom


class Turn(NamedTuple):
    """One simulation and the fit to it. `change`: the largest of the absorption's changes over their spreads;
    `misfit`: root mean square of measured minus simulated values over their standard errors, of fitted pairs;
    `within`: whether counts of reflections reach as far as the fit has gone."""

    misfit: float
    change: float
    within: bool


@dataclass(frozen=True)
class Calibration:
    """A fit of `measured` and how near it comes. Arrays of pairs are (S, R, measures, K) of `MEASURED`.

    `fit`: absorption that `after` was simulated with, with spreads; `table` (M, K): what it was before;
    `undetermined` (M, K): where the measurement told nothing, as the first simulation showed, so that the table's
    value has stayed; `held_out` (S, R): pairs that were left out of the fit; `interference`: standard deviations of
    single responses about the energies of `after`; `widened`: by what standard errors were multiplied, as the fit
    asked for (1: not at all); `settled`: whether the last change was within spreads; `materials`: a file of
    materials with it all.
    """

    scene: str
    measured: MeasuredRoom
    held_out: np.ndarray
    fit: MaterialFit
    table: np.ndarray
    undetermined: np.ndarray
    before: np.ndarray
    after: np.ndarray
    interference: np.ndarray
    turns: tuple[Turn, ...]
    widened: float
    materials: str

    @property
    def settled(self) -> bool:
        """Whether the last fit changed absorption by less than its spread, within reach of the counts."""
        return self.turns[-1].within and self.turns[-1].change <= 1.0

    def __repr__(self) -> str:
        lines = [
            f"Calibration of {self.scene!r}: {len(self.fit.names)} materials, {len(self.turns)} simulations"
        ]
        for what, pairs in (("fitted", ~self.held_out), ("held out", self.held_out)):
            before, after = self.errors(self.before, pairs), self.errors(self.after, pairs)
            if np.isfinite(before).any():
                each = zip(MEASURED, before, after, strict=True)
                told = ", ".join(f"{n.upper()} {b:.2f} → {a:.2f}" for n, b, a in each if np.isfinite(b))
                lines.append(f"{what} pairs, errors in JND: {told}")
        return "\n".join(lines)

    def differences(self, values: np.ndarray) -> np.ndarray:
        """(S, R, measures, K) absolute differences from what was measured, JND; NaN where one is missing."""
        return np.asarray(np.abs(values - self.measured.values) / self.measured.jnd)

    def errors(self, values: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """(measures,) mean of `differences` over octaves and `pairs` (S, R), where both simulations have values."""
        both = np.isfinite(self.differences(self.before) + self.differences(self.after))
        found = np.where(both, self.differences(values), np.nan)[pairs]
        return _means(found.swapaxes(0, 1).reshape(len(MEASURED), -1))

    def least(self, pairs: np.ndarray) -> np.ndarray:
        """(measures,) what `errors` would be in the mean if energies were known exactly, as single responses
        interfere: sqrt(2/π) times their standard deviations, normal as they nearly are."""
        known = np.isfinite(self.differences(self.before) + self.differences(self.after))
        share = np.sqrt(2.0 / np.pi) * self.interference / self.measured.jnd
        found = np.where(known, share, np.nan)[pairs]
        return _means(found.swapaxes(0, 1).reshape(len(MEASURED), -1))


def _means(rows: np.ndarray) -> np.ndarray:
    """(n,) means of (n, k) where they are finite; NaN of rows that are nowhere."""
    known = np.isfinite(rows)
    count = known.sum(axis=1)
    total = np.where(known, rows, 0.0).sum(axis=1)
    return np.divide(total, count, out=np.full(len(rows), np.nan), where=count > 0)
