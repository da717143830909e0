"""Two walls one behind the other, sources and listeners far below their tops: sound goes round three or four edges.

`python -m tests.transport.far_round` computes `far_round.json` anew by boundary elements (a minute of one core for each
case); the tests read it. Two dimensions, as in `edge_walks`.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tests.transport.boundary_elements import box, pressures, slab
from tests.transport.edge_walks import SPEED, Walk

TABLE = Path(__file__).with_name("far_round.json")
CASES = 6


def far_round(seed: int) -> tuple[Walk, np.ndarray]:
    """(Bodies and a source, (4, 2) places of listeners): two walls of about one height; a wall, and a high body that
    leaves a gap beside its top; a wide wall and a thin one."""
    r, kind = np.random.default_rng(seed), seed % 3
    (first, second), gap = r.uniform(0.03, 0.3, 2), r.uniform(0.4, 3.0)
    if kind == 0:
        top = r.uniform(-0.15, 0.15)
    elif kind == 1:
        top = -r.uniform(0.1, 0.5)
    else:
        first, top = r.uniform(0.5, 1.5), r.uniform(0.1, 0.5)
    behind = box(gap, gap + second, top, top + 4.0) if kind == 1 else slab(gap, gap + second, top)
    below = 1.0 if kind == 1 else 1.2
    source = -first - r.uniform(0.5, 3.0), -r.uniform(0.3, below)
    x = gap + second + r.uniform(0.5, 3.0)
    z = top + r.uniform(0.4, 1.0) if kind == 1 else top - r.uniform(0.3, 1.2)
    walk = Walk([slab(-first, 0.0), behind], source, (x, z - 0.2), (x, z + 0.2), per_band=9)
    return walk, walk.places()[::5]


def _compute() -> None:
    found = []
    for seed in range(CASES):
        walk, places = far_round(seed)
        f, at = walk.frequencies(), np.array(walk.source)
        p = np.array(
            [pressures(walk.bodies, at, places, 2 * np.pi * x / SPEED, False) for x in f.ravel()]
        )
        level = 10.0 * np.log10((np.abs(p.reshape(*f.shape, -1)) ** 2).mean(axis=1)).T
        found.append(np.round(level, 2).tolist())
        TABLE.write_text(json.dumps(found, separators=(",", ":")) + "\n")
        print(seed, flush=True)


if __name__ == "__main__":
    _compute()
