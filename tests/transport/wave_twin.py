"""A small wave solver: finite differences in time on a cubic grid, rigid thin screens in the plane before x = `at`.

The standard leapfrog scheme at its Courant limit (Botteldooren 1995); a screen takes away the links between the cells
on its two sides. The grid has no end that absorbs: what comes back from there is later than what is looked at.
"""

from __future__ import annotations

import numpy as np
from numba import njit

SPEED = 343.0
STEP = 0.07  # m: ten points per wave at 500 Hz


@njit(fastmath=True)
def _advance(p, before, at, open_):  # type: ignore[no-untyped-def]
    """Put the next pressure into `before`, from those of two instants."""
    for i in range(1, p.shape[0] - 1):
        for j in range(1, p.shape[1] - 1):
            for k in range(1, p.shape[2] - 1):
                here = p[i, j, k]
                flow = p[i, j - 1, k] + p[i, j + 1, k] + p[i, j, k - 1] + p[i, j, k + 1] - 4.0 * here
                if i != at or open_[j, k]:
                    flow += p[i - 1, j, k] - here
                if i != at - 1 or open_[j, k]:
                    flow += p[i + 1, j, k] - here
                before[i, j, k] = 2.0 * here - before[i, j, k] + flow / 3.0


def _responses(
    shape: tuple[int, int, int],
    at: int,
    open_: np.ndarray,
    source: tuple[int, ...],
    places: np.ndarray,
    until: float,
) -> np.ndarray:
    """(places, steps) pressures after a pulse in one cell, up to `until` s."""
    p = np.zeros(shape, np.float32)
    before = p.copy()
    p[source] = 1.0
    out = np.zeros((len(places), round(until / time_step())))
    for n in range(out.shape[1]):
        _advance(p, before, at, open_)
        p, before = before, p
        out[:, n] = p[tuple(places.T)]
    return out


def time_step() -> float:
    """s"""
    return float(STEP / SPEED / np.sqrt(3.0))


def relative_levels(
    shape: tuple[int, int, int],
    at: int,
    open_: np.ndarray,
    source: tuple[int, ...],
    places: np.ndarray,
    until: float,
    frequency: np.ndarray,
) -> np.ndarray:
    """(places, bands) dB: mean square with the screen over that without, over frequencies (bands, m)."""
    phase = np.exp(
        -2j * np.pi * frequency[..., None] * np.arange(round(until / time_step())) * time_step()
    )
    power = [
        (
            np.abs(_responses(shape, at, gate, source, places, until) @ np.moveaxis(phase, -1, 1)) ** 2
        ).mean(axis=2)
        for gate in (open_, np.ones_like(open_))
    ]
    return np.asarray(10.0 * np.log10(power[0] / power[1]).T)
