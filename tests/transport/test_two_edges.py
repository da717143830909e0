"""Paths by two edges in a flat, against a general minimizer."""

from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import optimize

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.transport.arrivals.connect import Context, Scratch, _double_may_be_heard
from soundspaces_sim.transport.arrivals.prepared import prepare_wedges
from soundspaces_sim.transport.arrivals.technique import context_of, direct_sound
from soundspaces_sim.transport.arrivals.two_edges import (
    estimate,
    meets_both,
    shares_of,
    two_edge_field,
    two_edge_path,
)
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.tile import make_side, make_tile
from tests.marks import ci_slow
from tests.rooms import table
from tests.transport.exact_wedge import SPEED
from tests.transport.test_diffraction import CONFIG

_NEAR = 1e-3  # m, of an end, where rounding may have it either way
_BEYOND = 0.2  # m, most that the way by the ends of an edge is longer


def _is_blocked(scene: ss.Scene, on_edges: np.ndarray, ends: np.ndarray) -> bool:
    """Whether a leg of a way by two edges meets a surface more than a centimetre from where it begins and ends."""
    mesh = trimesh.Trimesh(scene.vertices - scene.center, scene.faces, process=False)
    way = np.stack([ends[0], *on_edges, ends[1]])
    for begin, leg in zip(way[:-1], np.diff(way, axis=0), strict=True):
        length = float(np.linalg.norm(leg))
        hits, _, _ = mesh.ray.intersects_location([begin], [leg / length])
        along = (hits - begin) @ leg / length
        if ((along > 1e-2) & (along < length - 1e-2)).any():
            return True
    return False


def test_paths_by_two_edges_are_shortest() -> None:
    """The demo, fourteen points: of every such arrival the length is the least by way of both edges' lines, where the
    places of that are on the edges, else that by their ends, which is little longer. Where something is in the way
    of the least one, the arrival goes beside it."""
    scene = ss.load_scene("demo")
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    points = low + (high - low) * np.random.default_rng(1).random((14, 3))
    points[:, 2] = low[2] + 1.5
    model = make_model(scene, points, CONFIG)
    wedges = model.prepared.part(prepare_wedges).wedges
    echoes = simulate_tile(model, points, points)[0]
    local, minimize, found = points - scene.center, optimize.minimize, list[bool]()
    for i in range(len(points)):
        for j in range(i):
            for arrival in echoes[i, j].arrivals:
                if arrival.kind != "two edges":
                    continue
                rows = list(arrival.edges)
                start, along = wedges.start[rows], wedges.along[rows]
                limit = wedges.length[rows]

                def length(
                    z: np.ndarray, start: Any = start, along: Any = along, ends: Any = (i, j)
                ) -> float:
                    x = start + z[:, None] * along
                    legs = (local[ends[0]] - x[0], x[0] - x[1], x[1] - local[ends[1]])
                    return float(sum(np.linalg.norm(leg) for leg in legs))

                tries: Any = [
                    minimize(
                        length,
                        share * limit,
                        method="Nelder-Mead",
                        options={"xatol": 1e-8, "fatol": 1e-13},
                    )
                    for share in (0.5, 0.1, 0.9)
                ]
                best = min(tries, key=lambda t: t.fun)
                found.append(bool((best.x > _NEAR).all() and (best.x < limit - _NEAR).all()))
                if found[-1]:
                    assert abs(arrival.delay * SPEED - best.fun) < 1e-4
                    continue
                by_ends = length(np.clip(best.x, 0.01, limit - 0.01))
                bounded = minimize(length, 0.5 * limit, bounds=[(0.0, x) for x in limit])
                if _is_blocked(scene, start + bounded.x[:, None] * along, local[[i, j]]):
                    assert 0.0 < arrival.delay * SPEED - bounded.fun < _BEYOND
                    continue
                assert min(abs(arrival.delay * SPEED - x) for x in (by_ends, bounded.fun)) < 2e-3
                assert by_ends - best.fun < 2.0 * _BEYOND
    assert found.count(True) >= 20


@kernel
def _bounded(context: Context, scratch: Scratch, found: np.ndarray) -> None:
    """Counts (4,): paths by two edges between all points, those whose field (T34) at the lowest wave number is at most 3
    dB above what is estimated; of those that meet both edges, those that may be heard where half of that energy is."""
    a, b, edges, spectrum, pair = (
        context.a,
        context.b,
        context.scene.edges,
        context.scene.spectrum,
        scratch.pair,
    )
    for i in range(len(a.points)):
        for j in range(len(b.points)):
            u, v = a.ends[i], b.ends[j]
            for n in range(a.seen.link_start[u], a.seen.link_start[u + 1]):
                for m in range(b.seen.link_start[v], b.seen.link_start[v + 1]):
                    if edges.links.reverse[b.seen.link[m]] != a.seen.link[n]:
                        continue
                    e, f = a.seen.wedge[a.seen.link_row[n]], b.seen.wedge[b.seen.link_row[m]]
                    ok, x = two_edge_path(edges.wedges, e, f, row(a.points, i), row(b.points, j))
                    if not ok:
                        continue
                    pair.least[:] = 0.0
                    shares = shares_of(edges.wedges, x)
                    two_edge_field(
                        edges.wedges, x, shares, spectrum, pair.least, scratch.double, pair.field
                    )
                    for k in range(len(pair.least)):
                        pair.least[k] = 0.5 * abs(pair.field[k, 0]) ** 2
                    found[0] += 1
                    found[1] += estimate(edges.wedges, x, shares, spectrum.k[0, 0]) > pair.least[0]
                    if meets_both(edges.wedges, x):
                        found[2] += 1
                        found[3] += _double_may_be_heard(
                            edges, spectrum, a.seen, b.seen, n, m, 0.0, False, pair.least
                        )


@pytest.mark.parametrize("size", [0.15, 0.6, 3.0])
@ci_slow
def test_what_two_edges_bring_is_not_estimated_too_low(size: float) -> None:
    """Over the edges of a slab, points as far off as it is wide and up to twenty times as far: whatever the size, the
    estimate is at most 3 dB below the exact field."""
    slab = trimesh.creation.box(extents=(0.1 * size, 30.0, 10.0))
    slab.apply_translation((0.0, 0.0, -5.0))
    scene = ss.Scene(slab.vertices, slab.faces, np.zeros(len(slab.faces), int), table(0.0, 0.0))
    low, high = [0.1, -1.0, -1.0], [2.0, 1.0, 1.0]
    points = np.random.default_rng(3).uniform(low, high, (40, 3)) * size
    points[:20, 0] *= -1.0
    model = make_model(scene, points, CONFIG)
    sides = make_side(model, points[:20]), make_side(model, points[20:])
    tile = make_tile(sides[0], sides[1])
    context, scratch = context_of(tile, *direct_sound(tile))
    found = np.zeros(4, np.int64)
    _bounded(context, scratch(1), found)
    assert found[2] >= 300 and found[1] == found[0] and found[3] == found[2], found
