"""Walks past walls, doors, pillars and furniture, and the levels along them by boundary elements.

`python -m tests.transport.edge_walks` computes `edge_walks.json` anew (some ten minutes of one core); the tests read it.
Everything is even along y, so that two dimensions are enough: an arrival of length L has in three dimensions sqrt(k /
2 pi L) of what it has in two (stationary phase along y), so energies of arrivals are compared times 4 pi L with those of
a line source whose free field is e^(-jkr)/sqrt(r).
"""

from __future__ import annotations

import json
import sys
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.transport.boundary_elements import Body, box, pressures, slab

SPEED = 343.0
BANDS = (0.0, 176.0, 775.0, 3409.0, 8000.0)  # Hz; the first is taken from 88 Hz on, as the engine does
TABLE = Path(__file__).with_name("edge_walks.json")
_STEP = 0.02


class Walk(NamedTuple):
    """A source and a line of places, (x, z) m, about some bodies."""

    bodies: list[Body]
    source: tuple[float, float]
    first: tuple[float, float]
    last: tuple[float, float]
    floor: bool = False
    per_band: int = 7  # frequencies; more where paths differ by many waves

    def frequencies(self) -> np.ndarray:
        """(4, n) Hz, evenly in log f."""
        edges = (0.5 * BANDS[1], *BANDS[1:])
        return np.array([np.geomspace(a, b, 2 * self.per_band + 1)[1::2] for a, b in pairwise(edges)])

    def places(self) -> np.ndarray:
        """(n, 2) every 2 cm, no place on the plane of a face."""
        a, b = np.array(self.first), np.array(self.last)
        length = np.linalg.norm(b - a)
        s = np.arange(0.5 * _STEP, length, _STEP)[:, None] / length
        return np.asarray(a + s * (b - a))


WALKS = {
    "wall of 2 cm": Walk([slab(-0.01, 0.01)], (-1.5, -0.4), (1.2, -0.5), (1.2, 0.7)),
    "wall of 20 cm": Walk([slab(-0.1, 0.1)], (-2.0, -0.5), (2.0, -0.6), (2.0, 1.0)),
    "wall of 20 cm, near": Walk([slab(-0.1, 0.1)], (-0.6, -0.15), (0.5, -0.4), (0.5, 0.5)),
    "wall of 20 cm, source above": Walk([slab(-0.1, 0.1)], (-2.0, 0.3), (2.0, -0.6), (2.0, 0.6)),
    "jamb of 12 cm": Walk([slab(-0.06, 0.06)], (-1.0, -1.0), (-0.5, 0.4), (1.5, 0.4)),
    "jamb of 12 cm, along the wall": Walk([slab(-0.06, 0.06)], (-1.5, 0.3), (0.7, -0.9), (0.7, 0.5)),
    "pillar of 40 cm": Walk(
        [box(-0.2, 0.2, -0.2, 0.2)], (-2.0, 0.1), (1.0, -1.0), (1.0, 1.0), per_band=28
    ),
    "cupboard on a floor": Walk(
        [box(-0.3, 0.3, 0.0, 1.0)], (-1.5, 0.6), (1.2, 0.06), (1.2, 1.6), True, 28
    ),
    "cupboard on a floor, source above": Walk(
        [box(-0.3, 0.3, 0.0, 1.0)], (-1.5, 1.3), (1.2, 0.06), (1.2, 1.4), True, 28
    ),
    "table top": Walk([box(-0.4, 0.4, 0.71, 0.75)], (-1.2, 1.2), (1.0, 1.3), (1.0, 0.1), True),
}


def _compute(names: list[str]) -> None:
    found = json.loads(TABLE.read_text()) if TABLE.exists() else {}
    for name in names:
        walk, f = WALKS[name], WALKS[name].frequencies()
        p = np.array(
            [
                pressures(
                    walk.bodies,
                    np.array(walk.source),
                    walk.places(),
                    2.0 * np.pi * x / SPEED,
                    walk.floor,
                )
                for x in f.ravel()
            ]
        )
        level = 10.0 * np.log10((np.abs(p.reshape(*f.shape, -1)) ** 2).mean(axis=1)).T
        found[name] = np.round(level, 2).tolist()
        lines = [f"{json.dumps(k)}: {json.dumps(v, separators=(',', ':'))}" for k, v in found.items()]
        TABLE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        print(name, flush=True)


if __name__ == "__main__":
    _compute(sys.argv[1:] or list(WALKS))
