"""A small wave solver: finite differences in time on a cubic grid, rigid thin screens in the plane before x = `at`, or
bodies, rigid or locally reacting.

The standard leapfrog scheme at its Courant limit (Botteldooren 1995); a screen takes away the links between the cells
on its two sides, a body those to its own cells. The grid has no end that absorbs: what comes back from there is later than what is looked at.
"""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel

SPEED = 343.0
STEP = 0.07  # m: ten points per wave at 500 Hz
OPEN = np.uint8(63)  # all sides of a cell


@kernel(fastmath=True)
def advance(p, before, links, keep, over):  # type: ignore[no-untyped-def]
    """Put the next pressure into `before`: bits 2a and 2a + 1 of `links` are a cell's open sides down and up axis a,
    `keep` and `over` (7,) what walls on so many others take."""
    third = np.float32(1.0 / 3.0)
    for i in range(1, p.shape[0] - 1):
        for j in range(1, p.shape[1] - 1):
            for k in range(1, p.shape[2] - 1):
                here, flow, cut, open_ = p[i, j, k], np.float32(0.0), 6, links[i, j, k]
                if open_ & 1:
                    flow, cut = flow + p[i - 1, j, k] - here, cut - 1
                if open_ & 2:
                    flow, cut = flow + p[i + 1, j, k] - here, cut - 1
                if open_ & 4:
                    flow, cut = flow + p[i, j - 1, k] - here, cut - 1
                if open_ & 8:
                    flow, cut = flow + p[i, j + 1, k] - here, cut - 1
                if open_ & 16:
                    flow, cut = flow + p[i, j, k - 1] - here, cut - 1
                if open_ & 32:
                    flow, cut = flow + p[i, j, k + 1] - here, cut - 1
                last = keep[cut] * before[i, j, k]
                before[i, j, k] = (np.float32(2.0) * here - last + flow * third) * over[cut]


def walls_of(admittance: float) -> tuple[np.ndarray, np.ndarray]:
    """(`keep`, `over`) of `advance`, of walls of a specific admittance."""
    loss = np.arange(7) * (0.5 * admittance / np.sqrt(3.0))
    return (1.0 - loss).astype(np.float32), (1.0 / (1.0 + loss)).astype(np.float32)


def absorption_of(admittance: float) -> float:
    """At random incidence, of a locally reacting wall (Kuttruff, Room Acoustics, the integral over angles)."""
    z = 1.0 / admittance
    return float(8.0 / z * (1.0 + 1.0 / (1.0 + z) - 2.0 / z * np.log(1.0 + z)))


def _responses(
    links: np.ndarray,
    source: tuple[int, ...],
    places: np.ndarray,
    until: float,
    admittance: float,
) -> np.ndarray:
    """(places, steps) pressures after a pulse in one cell, up to `until` s."""
    keep, over = walls_of(admittance)
    p = np.zeros(links.shape, np.float32)
    before = p.copy()
    p[source] = 1.0
    out = np.zeros((len(places), round(until / time_step())))
    for n in range(out.shape[1]):
        advance(p, before, links, keep, over)
        p, before = before, p
        out[:, n] = p[tuple(places.T)]
    return out


def time_step() -> float:
    """s"""
    return float(STEP / SPEED / np.sqrt(3.0))


def _relative(
    links: np.ndarray,
    source: tuple[int, ...],
    places: np.ndarray,
    until: float,
    frequency: np.ndarray,
    admittance: float = 0.0,
) -> np.ndarray:
    """(places, bands) dB: mean square with these links over that with all of them."""
    phase = np.exp(
        -2j * np.pi * frequency[..., None] * np.arange(round(until / time_step())) * time_step()
    )
    power = [
        np.abs(_responses(given, source, places, until, admittance) @ np.moveaxis(phase, -1, 1)) ** 2
        for given in (links, np.full_like(links, OPEN))
    ]
    return np.asarray(10.0 * np.log10(power[0].mean(axis=2) / power[1].mean(axis=2)).T)


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
    links = np.full(shape, OPEN, np.uint8)
    links[at][~open_] &= np.uint8(62)
    links[at - 1][~open_] &= np.uint8(61)
    return _relative(links, source, places, until, frequency)


def levels_past(
    solid: np.ndarray,
    source: tuple[int, ...],
    places: np.ndarray,
    until: float,
    frequency: np.ndarray,
    admittance: float = 0.0,
) -> np.ndarray:
    """`relative_levels` past bodies of a specific admittance, where cells are `solid`."""
    links = np.where(solid, np.uint8(0), OPEN)
    for axis in range(3):
        for side, step in ((1, 1), (2, -1)):
            links[np.roll(solid, step, axis)] &= np.uint8(63 - (side << 2 * axis))
    return _relative(links, source, places, until, frequency, admittance)
