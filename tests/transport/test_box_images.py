"""Specular paths of a rectangular room as images: against a lattice by hand, against subpaths, and where they end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.transport.integrator import Made, run_techniques
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.paths.box_images import find_walls
from soundspaces_sim.transport.paths.technique import SPECULAR
from soundspaces_sim.transport.preparation import make_model

SIZE = np.array([5.0, 4.0, 3.0])
WALLS = {"west": 0.1, "east": 0.2, "south": 0.05, "north": 0.15, "floor": 0.3, "ceiling": 0.4}
SCATTERING = 0.1
A = np.array([[1.0, 1.2, 1.5]])
B = np.array([[3.6, 2.1, 1.2], [4.0, 3.0, 2.0]])
DURATION = 0.2


def _scene() -> ss.Scene:
    return ss.shoebox(SIZE, WALLS, SCATTERING)


def _model(scene: ss.Scene, duration: float = DURATION, walks: int = 16) -> Model:
    config = ss.SimulationConfig(
        walks=walks, duration=duration, reflection="random", air_absorption=False
    )
    return make_model(scene, np.concatenate([A, B]), config)


def _specular(model: Model, a: np.ndarray = A, b: np.ndarray | None = B) -> Made:
    return run_techniques(model, a, b, True, None, [SPECULAR])


def _by_hand(p: np.ndarray, q: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(bins, 4) energy and first moments (W, Y, Z, X) of all images but those of discrete arrivals."""
    kept = (1.0 - np.array(list(WALLS.values())).reshape(3, 2)) * (1.0 - SCATTERING)
    most = int(np.ceil(edges[-1] / SIZE.min())) + 1
    m = np.stack(np.meshgrid(*[np.arange(-most, most + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    place = np.where(m % 2 == 0, m * SIZE + p, (m + 1) * SIZE - p)
    towards = place - q
    length = np.linalg.norm(towards, axis=1)
    far, near = (np.abs(m) + 1) // 2, np.abs(m) // 2
    far, near = np.where(m > 0, far, near), np.where(m > 0, near, far)
    energy = np.prod(kept[:, 0] ** near * kept[:, 1] ** far, axis=1) / (4.0 * np.pi * length**2)
    count = np.abs(m).sum(axis=1)
    use = (count > 2) & ~((count == 3) & (np.abs(m).max(axis=1) == 3)) & (length < edges[-1])
    rows = np.searchsorted(edges, length[use], "right") - 1
    moments = np.column_stack([np.ones(use.sum()), (towards / length[:, None])[use][:, [1, 2, 0]]])
    out = np.zeros((len(edges) - 1, 4))
    np.add.at(out, rows, energy[use, None] * moments)
    return out


def test_images_are_those_of_a_lattice_by_hand() -> None:
    """Energies and directions of all bins, both ways: within 0.1 %, of tables by angle and single precision."""
    model = _model(_scene())
    longest = model.world.settings.images_length
    bins = int(np.searchsorted(model.time_edges * 343.0, longest)) - 1
    edges = model.time_edges[: bins + 1] * 343.0
    assert bins > 50
    made = _specular(model)
    for j in range(len(B)):
        for p, q, found in ((A[0], B[j], made.sums.to_b[0, j]), (B[j], A[0], made.sums.to_a[j, 0])):
            expected = _by_hand(p, q, edges)
            scale = expected[:, :1].clip(1e-12)
            for band in range(found.shape[2]):
                assert np.abs((found[:bins, :4, band] - expected) / scale).max() < 1e-3
    # exact: alike in all batches
    batches = made.sums.batches[:, :, :16]
    first = model.world.window_of_bin[bins - 1]
    assert np.ptp(batches[:, :, :, :first], axis=2).max() == 0.0


def test_subpaths_find_the_same_on_average() -> None:
    """By eight seeds, in three stretches of time: within four standard errors, of 4 % at most. Receiver volumes reach
    to a metre around a point, so that a stretch has sound of its neighbours: half a per cent besides."""
    model = _model(_scene(), walks=1000)
    exact = _specular(model).sums.to_b[0, :, :, 0, 0]
    without = model.world._replace(settings=model.world.settings._replace(images_length=0.0))
    runs = np.array(
        [
            _specular(replace(model, world=without, seed=seed)).sums.to_b[0, :, :, 0, 0]
            for seed in range(8)
        ]
    )
    at = np.searchsorted(model.time_edges, [0.05, 0.1, 0.15, 0.2])[:-1]
    found, mean = np.add.reduceat(runs, at, axis=2), np.add.reduceat(exact, at, axis=1)
    error = found.std(axis=0, ddof=1) / np.sqrt(len(runs)) / mean
    assert error.max() < 0.04
    assert (np.abs(found.mean(axis=0) / mean - 1.0) < 4.0 * error + 0.005).all()


def test_a_turned_room_has_the_same_images() -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    scene = _scene()
    turned = replace(scene, vertices=scene.vertices @ turn.T)
    one, other = _specular(_model(scene)), _specular(make_model(
        turned, np.concatenate([A, B]) @ turn.T, _model(scene).config), A @ turn.T, B @ turn.T)  # fmt: skip
    np.testing.assert_allclose(
        one.sums.to_b[:, :, 1:40, 0].sum(axis=2), other.sums.to_b[:, :, 1:40, 0].sum(axis=2), rtol=1e-3
    )


def test_a_pair_has_the_same_bits_both_ways_and_in_any_tile() -> None:
    model = _model(_scene())
    there, back = _specular(model, A, B).sums, _specular(model, B, A).sums
    np.testing.assert_array_equal(there.to_b, back.to_a)
    np.testing.assert_array_equal(there.to_a, back.to_b)
    both = _specular(model, np.concatenate([A, B]), None).sums
    np.testing.assert_array_equal(both.to_b[0, 1:], there.to_b[0])
    np.testing.assert_array_equal(both.to_b[1:, 0], there.to_a[:, 0])


@pytest.mark.parametrize("what", ["table", "open", "two materials", "two rooms"])
def test_other_scenes_have_none(what: str) -> None:
    scene = _scene()
    if what == "open":
        scene = replace(
            scene, faces=scene.faces[2:], face_material=scene.face_material[2:], face_label=scene.face_label[2:]
        )  # fmt: skip
    elif what == "two materials":
        rows = scene.face_material.copy()
        rows[0] = rows[2]
        scene = replace(scene, face_material=rows)
    else:
        offset = [6.0, 0.0, 0.0] if what == "two rooms" else [2.0, 1.5, 0.7]
        size = SIZE if what == "two rooms" else np.array([1.0, 1.0, 0.05])
        vertices = np.concatenate([scene.vertices, scene.vertices / SIZE * size + offset])
        scene = replace(
            scene, vertices=vertices, faces=np.concatenate([scene.faces, scene.faces + len(scene.vertices)]),
            face_material=np.tile(scene.face_material, 2), face_label=np.tile(scene.face_label, 2),
        )  # fmt: skip
    assert _model(scene).world.settings.images_length == 0.0


def test_where_lattices_grow_too_large_subpaths_go_on() -> None:
    """Late energy is there, too, with errors of its own."""
    model = _model(_scene(), duration=0.5)
    longest = model.world.settings.images_length
    assert 0.0 < longest < 0.5 * 343.0
    made = _specular(model)
    late = model.time_edges[:-1] * 343.0 > longest + 5.0
    assert made.sums.to_b[0, 0, late[: made.sums.to_b.shape[2]], 0].sum() > 0.0


def test_walls_are_found_with_their_inner_sides() -> None:
    scene = _scene()
    walls = find_walls(scene.geometry, scene.corners - scene.center)
    assert walls is not None
    np.testing.assert_allclose(np.sort(walls.size), np.sort(SIZE))
    normal, middle = scene.geometry.normal, (scene.corners - scene.center).mean(axis=1)
    inward = np.where(walls.inner == 0, 1.0, -1.0)[..., None] * normal[walls.faces]
    assert ((inward * middle[walls.faces]).sum(axis=-1) < 0.0).all()
