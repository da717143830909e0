"""Error bars of radiance transfer, from groups of patches, against products of every batch at full resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.transport import integrator
from soundspaces_sim.transport.model import EARLY_S, Model
from soundspaces_sim.transport.paths.technique import SPECULAR
from soundspaces_sim.transport.radiance_transfer.pair_transfer import (
    Endpoints,
    make_endpoints,
    transfer,
)
from soundspaces_sim.transport.radiance_transfer.plan import make_transfer_plan
from soundspaces_sim.transport.radiance_transfer.technique import RADIANCE_TRANSFER
from soundspaces_sim.transport.simulate import model_between
from soundspaces_sim.transport.tables import BATCHES
from soundspaces_sim.transport.tile import Side, make_side, make_sums, make_tile

RUNS = 10


def _runs_of(model: Model, point: np.ndarray) -> Side:
    """A point so many times, with the subpaths of as many seeds."""
    side = make_side(model, np.repeat(point[None], RUNS, axis=0))
    keys = np.array([point_keys(point[None], seed)[0] for seed in range(RUNS)])
    return replace(side, ends=side.ends._replace(keys=keys))


def _apart(ends: Endpoints, i: int) -> Endpoints:
    """The batches of point i, each as a point of its own that has no other."""
    reflections, drawn = ends.reflections, ends.drawn
    start = np.empty((BATCHES, BATCHES + 1), np.int64)
    carried = np.full((BATCHES, *drawn.reflection.shape[1:]), -1, np.int64)
    for k in range(BATCHES):
        start[k, : k + 1], start[k, k + 1 :] = reflections.start[i, k], reflections.start[i, k + 1]
        carried[k, k] = drawn.reflection[i, k]

    def each(of_points: np.ndarray) -> np.ndarray:
        return np.repeat(of_points[i : i + 1], BATCHES, axis=0)

    return Endpoints(
        reflections._replace(start=start, direction=each(reflections.direction)),
        drawn._replace(
            reflection=carried,
            scale=each(drawn.scale),
            population=each(drawn.population),
            subpath=each(drawn.subpath),
        ),
        ends.subpaths,
        np.arange(BATCHES, dtype=np.uint64) + ends.keys[i] + np.uint64(1),
    )


def _alone(ends: Endpoints, i: int) -> Endpoints:
    reflections, drawn, one = ends.reflections, ends.drawn, slice(i, i + 1)
    return Endpoints(
        reflections._replace(start=reflections.start[one], direction=reflections.direction[one]),
        type(drawn)(*(column[one] for column in drawn)),
        ends.subpaths,
        ends.keys[one],
    )


def _by_window(edges: np.ndarray, split: float, values: np.ndarray) -> np.ndarray:
    """(2, K, b) early and late sums of `values` (K, bins, b)."""
    late = np.clip((edges[1:] - split) / np.diff(edges), 0.0, 1.0)
    return np.asarray(np.einsum("wt,ktb->wkb", np.stack([1.0 - late, late]), values))


@pytest.mark.slow
def test_error_bars_are_those_of_products_at_full_resolution() -> None:
    """A home, 600 subpaths, three pairs, ten seeds: errors over those by products of each batch between patches, in
    bins, are 1 within .1 in the mean over pairs and bands, early and late. With patches of a group taken for alike
    early ones were .87."""
    scene = load_scene("home-7011")
    points = (grid := ss.make_grid(scene).points)[np.linspace(0, len(grid) - 1, 5).astype(int)]
    config = ss.SimulationConfig(walks=600, radiance_transfer=ss.RadianceTransferConfig(subpaths="own"))
    model = model_between(scene, points[:1], points[1:], config, 0)
    plan, source = make_transfer_plan(model), _runs_of(model, points[0])
    edges, window = model.time_edges, model.world.window_of_bin
    starts = np.append(edges[np.unique(window, return_index=True)[1]], edges[-1])
    ratios = []
    for point in points[1:4]:
        a, b = replace(source), _runs_of(model, point)
        tile = make_tile(a, b)
        walks = integrator._trace(tile, make_sums(tile, False), [SPECULAR], None, None)
        sums = make_sums(tile, False)
        integrator.join_walks(tile, walks, sums, [RADIANCE_TRANSFER])
        of_a, of_b = (of_side.once(make_endpoints) for of_side in walks)
        split = tile.distance[0, 0] / model.config.c + EARLY_S
        variances = []
        for i in range(RUNS):
            coarse = _by_window(starts, split, sums.batches[i, i, :BATCHES].astype(float))
            both = [
                transfer(plan, _apart(of, i), _alone(to, i)) for of, to in ((of_a, of_b), (of_b, of_a))
            ]
            ways = [0.5 * (t.there.energy[:, :, 0] + t.back.energy[:, 0]) for t in both]
            fine = np.einsum("bkt,tb->ktb", sum(ways), plan.restore)
            of_fine = _by_window(edges[plan.first_bin :], split, fine)
            whole = coarse.sum(axis=1)
            # windows and bins are not cut alike where late sound begins: energies agree in both together
            np.testing.assert_allclose(of_fine.sum(axis=(0, 1)), 2.0 * whole.sum(axis=0), rtol=0.02)
            variances.append([x.var(axis=1, ddof=1) / whole**2 for x in (coarse, of_fine)])
        mean = np.mean(variances, axis=0)
        ratios.append(mean[0] / mean[1])  # (2, b)
    assert np.isfinite(ratios).all()
    of_windows = np.sqrt(np.mean(ratios, axis=(0, 2)))
    assert np.all(np.abs(of_windows - 1.0) < 0.1), ratios
