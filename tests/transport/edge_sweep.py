"""Random shapes walked past in two dimensions, ours against boundary elements: which are worst.

    python -m tests.transport.edge_sweep [--first 0] [--count 8] [--kinds wall,pillar] [--table file.json]

References are kept in a file of their own, so that a second run takes only our side anew; the first takes some 15 s
of one core for each walk. Sizes are .02 to 1.5 m, distances .25 to 4 m, sources above and below. The walks of
`edge_sweep.json`, the first few of each kind, are a slow test (`test_edge_walks`).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.transport.boundary_elements import box, pressures, slab
from tests.transport.edge_walks import SPEED, Walk

_BELOW = 0.05  # m, least height over a floor


def _log(r: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(r.uniform(np.log(low), np.log(high))))


def _beyond(r: np.random.Generator, half: float) -> tuple[float, float]:
    """(x of a source on the left, x of a listener on the right) of a body of half a width, m."""
    return -half - _log(r, 0.5, 4.0), half + _log(r, 0.25, 2.5)


def _wall(r: np.random.Generator) -> Walk:
    half = 0.5 * _log(r, 0.02, 1.5)
    a, b = _beyond(r, half)
    return Walk([slab(-half, half)], (a, r.uniform(-1.2, 0.8)), (b, -0.8), (b, 0.7), per_band=9)


def _jamb(r: np.random.Generator) -> Walk:
    """Past the end of a wall, along a line across its plane or over its top."""
    half = 0.5 * _log(r, 0.02, 0.5)
    a, _ = _beyond(r, half)
    z = r.uniform(0.05, 0.7)
    return Walk([slab(-half, half)], (a, r.uniform(-1.2, 0.3)), (-0.5, z), (1.2, z), per_band=9)


def _pillar(r: np.random.Generator) -> Walk:
    half, deep = 0.5 * _log(r, 0.02, 1.2), 0.5 * _log(r, 0.02, 1.2)
    a, b = _beyond(r, half)
    body = [box(-half, half, -deep, deep)]
    return Walk(body, (a, r.uniform(-0.8, 0.8)), (b, -deep - 0.5), (b, deep + 0.5), per_band=14)


def _cupboard(r: np.random.Generator) -> Walk:
    half, high = 0.5 * _log(r, 0.05, 1.5), _log(r, 0.1, 1.5)
    a, b = _beyond(r, half)
    body = [box(-half, half, 0.0, high)]
    return Walk(body, (a, r.uniform(0.2, 2.0)), (b, _BELOW), (b, high + 0.5), True, 14)


def _table(r: np.random.Generator) -> Walk:
    half, thick, high = 0.5 * _log(r, 0.3, 1.5), _log(r, 0.02, 0.06), r.uniform(0.4, 1.1)
    a, b = _beyond(r, half)
    body = [box(-half, half, high - thick, high)]
    return Walk(body, (a, r.uniform(0.2, 1.9)), (b, _BELOW), (b, 1.6), True, 14)


def _shelf(r: np.random.Generator) -> Walk:
    """A wide flat body in the air."""
    half, thick = 0.5 * _log(r, 0.2, 1.5), _log(r, 0.02, 0.1)
    a, b = _beyond(r, half)
    body = [box(-half, half, -thick, 0.0)]
    return Walk(body, (a, r.uniform(-0.8, 0.8)), (b, -0.8), (b, 0.8), per_band=14)


def _raised(r: np.random.Generator) -> Walk:
    """A wall or a cupboard with a gap below."""
    half, gap, high = 0.5 * _log(r, 0.03, 0.6), _log(r, 0.05, 0.6), _log(r, 0.3, 1.5)
    a, b = _beyond(r, half)
    body = [box(-half, half, gap, gap + high)]
    return Walk(body, (a, r.uniform(0.1, 2.0)), (b, _BELOW), (b, min(gap + high + 0.4, 1.8)), True, 14)


KINDS: dict[str, Callable[[np.random.Generator], Walk]] = {
    "wall": _wall,
    "jamb": _jamb,
    "pillar": _pillar,
    "cupboard": _cupboard,
    "table": _table,
    "shelf": _shelf,
    "raised": _raised,
}


def random_walk(kind: str, seed: int) -> Walk:
    """The walk of a kind with a number."""
    walk = KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind)]))
    return walk._replace(
        source=tuple(np.round(walk.source, 3)),
        first=tuple(np.round(walk.first, 3)),
        last=tuple(np.round(walk.last, 3)),
    )


def exact_pressures(walk: Walk) -> np.ndarray:
    """(n, 4, f) by boundary elements."""
    f = walk.frequencies()
    p = np.array(
        [
            pressures(
                walk.bodies, np.array(walk.source), walk.places(), 2.0 * np.pi * x / SPEED, walk.floor
            )
            for x in f.ravel()
        ]
    )
    return np.moveaxis(p.reshape(*f.shape, -1), -1, 0)


def level(pressure: np.ndarray) -> np.ndarray:
    """(n, 4) dB"""
    return np.asarray(10.0 * np.log10((np.abs(pressure) ** 2).mean(axis=2)))


def described(walk: Walk) -> str:
    """Its measures."""
    corners = walk.bodies[0].corners
    return (
        f"x {corners[:, 0].min():.3f}..{corners[:, 0].max():.3f} z {corners[:, 1].min():.3f}.."
        f"{corners[:, 1].max():.3f} source {walk.source} at x {walk.first[0]} z {walk.first[1]}..{walk.last[1]}"
    )


def _row(kind: str, seed: int, ours: np.ndarray, exact: np.ndarray, walk: Walk) -> str:
    off = np.abs(ours - exact)
    steps, expected = (np.abs(np.diff(x, axis=0)).max(axis=0) for x in (ours, exact))
    at = walk.places()[off.argmax(axis=0)]
    places = " ".join(f"{p[1] if walk.first[0] == walk.last[0] else p[0]:5.2f}" for p in at)
    return (
        f"{kind:9s} {seed:3d} off {np.array2string(off.max(axis=0), precision=2, floatmode='fixed')} "
        f"rms {np.array2string(np.sqrt((off**2).mean(axis=0)), precision=2, floatmode='fixed')} "
        f"excess step {np.array2string(steps - expected, precision=2, floatmode='fixed')} at {places} | "
        f"{described(walk)}"
    )


def main() -> None:
    """Print walks as they are done, then the worst first."""
    from tests.transport.test_edge_walks import levels_of

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=8, help="of each kind")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--table", type=Path, default=Path("edge_sweep.json"))
    args = parser.parse_args()
    known = json.loads(args.table.read_text()) if args.table.exists() else {}
    rows = []
    for seed in range(args.first, args.first + args.count):
        for kind in args.kinds.split(","):
            walk, name = random_walk(kind, seed), f"{kind} {seed}"
            began = time.process_time()
            if name not in known:
                known[name] = np.round(level(exact_pressures(walk)), 2).tolist()
                args.table.write_text(json.dumps(known))
            exact, between = np.array(known[name]), time.process_time()
            ours = levels_of(walk)
            off = np.abs(ours - exact).max(axis=0)
            steps, expected = (np.abs(np.diff(x, axis=0)).max(axis=0) for x in (ours, exact))
            score = max((off / [1.0, 0.5, 0.5, 0.5]).max(), ((steps - expected) / 0.3).max())
            rows.append((score, _row(kind, seed, ours, exact, walk)))
            took = f"{between - began:.0f} + {time.process_time() - between:.0f} s"
            print(f"{score:5.1f} {rows[-1][1]} ({took})", flush=True)
    print("worst first")
    for score, row in sorted(rows, reverse=True):
        print(f"{score:5.1f} {row}")


if __name__ == "__main__":
    main()
