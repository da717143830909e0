"""What a technique adds to a tile is finite and not negative, or the simulation stops and names the pair."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.errors import SimulationError
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, rows_of_thread
from soundspaces_sim.transport.tables import CHANNELS

_BOUND = 1.001  # of a moment against its energy: harmonics (SN3D) are at most 1, and sums are rounded


class Origin(NamedTuple):
    """Of a table: which technique filled it, and between which points."""

    technique: str
    rows: np.ndarray  # (R, 3) m
    columns: np.ndarray  # (C, 3) m
    bands: tuple[float, ...]  # (b + 1,) edges, Hz

    def at(self, i: int, j: int, band: int) -> str:
        """Names of a cell."""
        p, q = ("({:.3f}, {:.3f}, {:.3f})".format(*x) for x in (self.rows[i], self.columns[j]))
        edges = f"{self.bands[band]:g} to {self.bands[band + 1]:g} Hz"
        return f"technique '{self.technique}', pair {p} and {q} m, band {band} ({edges})"


def check_table(table: np.ndarray, origin: Origin) -> None:
    """Raise `SimulationError` unless `table` (R, C, bins, 9, b) holds finite energies, none negative, with moments
    within them."""
    if table.size == 0:
        return
    bad = np.empty((len(table), 3), np.int64)
    over_rows(_first_bad, len(table), table, bad, least=rows_of_thread(table))
    for i in np.flatnonzero(bad[:, 0] >= 0)[:1]:
        j, t, b = bad[i]
        _fail(f"{origin.at(i, j, b)}, time bin {t}", table[i, j, t, :, b])


def check_sums(values: np.ndarray, origin: Origin) -> None:
    """The same of energies `values` (R, C, …, b)."""
    for index in np.argwhere(~(np.isfinite(values) & (values >= 0.0)))[:1]:
        _fail(origin.at(index[0], index[1], index[-1]), values[tuple(index)])


def check_paths(pair: np.ndarray, energy: np.ndarray, origin: Origin) -> None:
    """The same of discrete paths: `pair` (n,) i C + j, `energy` (n, b)."""
    for k, band in np.argwhere(~(np.isfinite(energy) & (energy >= 0.0)))[:1]:
        i, j = divmod(int(pair[k]), len(origin.columns))
        _fail(f"{origin.at(i, j, band)}, a discrete path", energy[k, band])


def _fail(where: str, got: object) -> None:
    raise SimulationError(
        f"{where}: expected finite energy of 0 or more, and moments within it, got {got}; this is a defect of "
        "soundspaces_sim, please report the scene and the settings"
    )


@kernel
def _first_bad(first: int, last: int, table: np.ndarray, bad: np.ndarray) -> None:
    """Write to `bad` (rows, 3) the column, bin and band of the first value that cannot be in rows `first` to `last`
    of `table` (rows, columns, bins, 9, b), -1 if there is none."""
    for i in range(first, last):
        bad[i, 0] = -1
        for j in range(table.shape[1]):
            for t in range(table.shape[2]):
                row = table[i, j, t]
                for b in range(row.shape[1]):
                    energy = row[0, b]
                    ok = energy < np.inf
                    for c in range(CHANNELS):
                        ok &= abs(row[c, b]) <= _BOUND * energy  # false for NaN and below zero
                    if not ok and bad[i, 0] < 0:
                        bad[i, 0], bad[i, 1], bad[i, 2] = j, t, b
