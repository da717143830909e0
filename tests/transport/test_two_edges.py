"""Paths by two edges in a flat, against a general minimizer."""

from typing import Any

import numpy as np
from scipy import optimize

import soundspaces_sim as ss
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import make_model
from tests.transport.exact_wedge import SPEED
from tests.transport.test_diffraction import CONFIG


def test_paths_by_two_edges_are_shortest_and_on_their_edges() -> None:
    """The demo, nine points: of every such arrival the length is the least by way of both edges' lines, and the places
    where it is least are on the edges."""
    scene = ss.load_scene("demo")
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    points = low + (high - low) * np.random.default_rng(1).random((9, 3))
    points[:, 2] = low[2] + 1.5
    model = make_model(scene, points, CONFIG)
    wedges = model.prepared.part(prepare_wedges).wedges
    echoes = simulate_tile(model, points, points)[0]
    local, minimize, found = points - scene.center, optimize.minimize, 0
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
                assert abs(arrival.delay * SPEED - best.fun) < 1e-4
                assert (best.x > -1e-4).all() and (best.x < limit + 1e-4).all()
                found += 1
    assert found >= 5
