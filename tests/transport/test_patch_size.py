"""Patches grow with rooms, and late sound is what it is without them."""

from __future__ import annotations

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.transport.radiance_transfer.patch_size import patch_size
from soundspaces_sim.transport.radiance_transfer.patches import PATCH_SIZE
from tests.marks import few
from tests.rooms import box, plain, table
from tests.stats import repeat
from tests.transport.test_patches import _model


def _size(scene: ss.Scene) -> float:
    return patch_size(scene.geometry, scene.corners - scene.center, scene.areas)


@pytest.mark.parametrize("name", few(["demo", "home-7001", "hall-7001"], "demo", "hall-7001"))
def test_rooms_with_furniture_and_common_halls_keep_small_patches(name: str) -> None:
    assert _size(load_scene(name)) == PATCH_SIZE


def test_half_of_the_ways_in_a_cube_are_as_long_as_their_distribution_has_it() -> None:
    """Of ways between random points of a cube's faces by Lambert's law, drawn by NumPy from one face."""
    rng, n, side = np.random.default_rng(0), 400_000, 40.0
    x, y = rng.uniform(0.0, side, (2, n))
    r, phi = np.sqrt(rng.uniform(size=n)), rng.uniform(0.0, 2.0 * np.pi, n)
    d = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1.0 - r**2)])
    wall = np.where(d[:2] > 0.0, side - np.stack([x, y]), np.stack([x, y])) / np.abs(d[:2])
    way = np.minimum(wall.min(axis=0), side / d[2])
    found = _size(box((side, side, side), table(0.1, 0.5)))
    assert found == pytest.approx(np.median(way) / 8.0, rel=0.03)


def test_a_large_room_has_as_many_patches_as_a_small_one_of_its_shape() -> None:
    """100,000 m³ and 800,000 m³: the time and memory of late sound are bounded."""
    counts = [
        len(_model(box((60.0 * k, 50.0 * k, 33.0 * k), table(0.1, 0.3))).world.patches.weight)
        for k in (1, 2)
    ]
    assert counts[1] == pytest.approx(counts[0], rel=0.02) and counts[0] < 2500


@pytest.mark.slow
def test_late_energy_of_a_large_room_is_that_without_patches() -> None:
    """30 × 25 × 16.5 m, with patches of 1.9 m: energies of four windows up to 1.2 s, near a wall and in the middle,
    against receiver volumes alone; means of seeds agree within four standard errors, and within 2 % on average."""
    scene = box((30.0, 25.0, 16.5), table(0.15, 0.4))
    assert _size(scene) > 1.7
    points = [[4.0, 5.0, 1.5]], [[0.3, 20.0, 2.0], [16.0, 12.0, 6.0]]

    def run(transfer: bool) -> np.ndarray:
        config = plain(
            walks=3000 if transfer else 16000, duration=1.2, denoise=False, radiance_transfer=transfer
        )

        def once(seed: int) -> np.ndarray:
            echoes = ss.simulate(scene, *points, config, seed + 100 * transfer)
            return np.array([echoes[0, l].histogram(0.3)[0] for l in range(2)])

        return repeat(once, 10)

    with_patches, without = run(True), run(False)
    assert with_patches.shape == (10, 2, 4)
    ratio = with_patches.mean(axis=0) / without.mean(axis=0)
    spread = [x.std(axis=0, ddof=1) / x.mean(axis=0) / np.sqrt(10.0) for x in (with_patches, without)]
    error = np.hypot(*spread)
    assert (error < 0.025).all()
    assert (np.abs(ratio - 1.0) < 4.0 * error).all() and abs(ratio.mean() - 1.0) < 0.02
