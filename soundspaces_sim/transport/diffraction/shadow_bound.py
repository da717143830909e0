"""How loud the sound past edges may be at most, near the boundary of a shadow and in it.

Several edges are summed and multiplied as if each were long beside a wave (T33a, T34, T35d). Of bodies that are
not, the sum has no bound of itself: about a cube of 0.8 m it was up to 8 dB too loud below 180 Hz. In sight an edge
leaves 1 - B(delta) of the straight path's pressure, with B of (T33) for the detour by the edge. At the boundary of
the shadow that is a half, and twice that where a face adds a wave at grazing incidence. So direct sound and the
paths round edges have at most the energy

    E_0 |2 (1 - B(delta))|²

together (T35h), with that of the free field, E_0, and the least detour delta by an edge that the straight path
passes: by its line, and that by the end beyond which the apex lies, added. B is taken at the mean frequency of a
band. In the shadow delta is taken as 0.
"""

from __future__ import annotations

import numpy as np
from scipy.special import modfresnelm

from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.coherence import (
    Together,
    band_centres,
    scale_together,
    sums_of,
)
from soundspaces_sim.transport.model import air_transmission
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.tile import Tile

_PATHS = ("diffraction", "double_diffraction")  # tables of paths round edges alone


def left_in_sight(detour: np.ndarray, k: np.ndarray) -> np.ndarray:
    """|1 - B| of (T33), (..., b), for detours (...) m and wave numbers (b,)."""
    u = np.sqrt(np.maximum(detour, 0.0)[..., None] * k)
    tail = modfresnelm(u)[0]  # of exp(-j t²), from u on
    return np.asarray(np.abs(1.0 - np.exp(0.25j * np.pi) / np.sqrt(np.pi) * tail))


def _most(tile: Tile) -> np.ndarray:
    """(A, B, b) J/m² that direct sound and paths round edges of each pair have together at most."""
    config, passed = tile.model.config, tile.passed
    assert passed is not None
    free = INV_4PI / np.maximum(tile.distance, config.least_distance) ** 2
    left = left_in_sight(passed, band_centres(config.bands, config.c))
    return np.asarray(air_transmission(config, tile.distance) * free[..., None] * 4.0 * left**2)


def connect(tile: Tile) -> PathTable | None:
    """Scale what other techniques have found; no paths of its own."""
    wanted = [(tile.walls == 0).ravel()]
    wanted += [np.full(len(paths.pair), name in _PATHS) for name, paths in tile.discrete.items()]

    def factors(some: Together) -> np.ndarray:
        together = np.add.reduceat(sums_of(tile, some)[1], some.start[:-1])
        most = _most(tile).reshape(tile.walls.size, -1)[some.pair[some.start[:-1]]]
        factor = np.divide(most, together, out=np.ones_like(most), where=together > most)
        return np.repeat(factor, np.diff(some.start), axis=0)

    scale_together(tile, np.concatenate(wanted), factors)
    return None
