"""A small wave solver: finite differences in time on a cubic grid, rigid thin screens in the plane before x = `at`, or
rigid bodies.

The standard leapfrog scheme at its Courant limit (Botteldooren 1995); a screen takes away the links between the cells
on its two sides, a body those to its own cells. The grid has no end that absorbs: what comes back from there is later than what is looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel

SPEED = 343.0
STEP = 0.07  # m: ten points per wave at 500 Hz


@kernel(fastmath=True)
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


@kernel(fastmath=True)
def _advance_past(p, before, solid):  # type: ignore[no-untyped-def]
    """`_advance` past bodies: cells that are `solid`."""
    for i in range(1, p.shape[0] - 1):
        for j in range(1, p.shape[1] - 1):
            for k in range(1, p.shape[2] - 1):
                if solid[i, j, k]:
                    continue
                here, flow = p[i, j, k], 0.0
                for step in (-1, 1):
                    if not solid[i + step, j, k]:
                        flow += p[i + step, j, k] - here
                    if not solid[i, j + step, k]:
                        flow += p[i, j + step, k] - here
                    if not solid[i, j, k + step]:
                        flow += p[i, j, k + step] - here
                before[i, j, k] = 2.0 * here - before[i, j, k] + flow / 3.0


Advance = Callable[[np.ndarray, np.ndarray], None]


def _responses(
    advance: Advance,
    shape: tuple[int, int, int],
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
        advance(p, before)
        p, before = before, p
        out[:, n] = p[tuple(places.T)]
    return out


def time_step() -> float:
    """s"""
    return float(STEP / SPEED / np.sqrt(3.0))


def _relative(
    both: tuple[Advance, Advance],
    shape: tuple[int, int, int],
    source: tuple[int, ...],
    places: np.ndarray,
    until: float,
    frequency: np.ndarray,
) -> np.ndarray:
    """(places, bands) dB: mean square by the first way of advancing over that by the second."""
    phase = np.exp(
        -2j * np.pi * frequency[..., None] * np.arange(round(until / time_step())) * time_step()
    )
    power = [
        (
            np.abs(_responses(advance, shape, source, places, until) @ np.moveaxis(phase, -1, 1)) ** 2
        ).mean(axis=2)
        for advance in both
    ]
    return np.asarray(10.0 * np.log10(power[0] / power[1]).T)


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
    both = partial(_advance, at=at, open_=open_), partial(_advance, at=at, open_=np.ones_like(open_))
    return _relative(both, shape, source, places, until, frequency)


def levels_past(
    solid: np.ndarray,
    source: tuple[int, ...],
    places: np.ndarray,
    until: float,
    frequency: np.ndarray,
) -> np.ndarray:
    """`relative_levels` past bodies, where cells are `solid`."""
    both = partial(_advance_past, solid=solid), partial(_advance_past, solid=np.zeros_like(solid))
    return _relative(both, solid.shape, source, places, until, frequency)
