"""Sound through building elements: what a wall lets pass is what a sheet of its material does, however it is meshed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.transport.element_depths import element_areas
from soundspaces_sim.transport.elements import APART, WHOLE, cross_walls
from soundspaces_sim.transport.preparation import prepare_scene
from tests.marks import ci_slow, few
from tests.rooms import box, plain, table, two_rooms
from tests.transport.test_agreement import MIXED, _agree, _engine, _twin

P, Q = [1.2, 1.0, 1.2], [6.5, 2.8, 1.4]
Mesh = tuple[np.ndarray, np.ndarray]  # vertices and faces


def _wall(thickness: float, middle: float = 4.0) -> Mesh:
    """A closed wall between two rooms, of twelve triangles, that goes a millimetre into all that is about it."""
    wall = box((thickness, 4.002, 2.502), MIXED)
    return wall.vertices + [middle - thickness / 2, -0.001, -0.001], wall.faces


def _rooms(materials: ss.MaterialTable, rows: int | list[int] | np.ndarray, wall: Mesh) -> ss.Scene:
    """Two rooms of 4 x 4 x 2.5 m side by side along x, and what is between them."""
    room, (vertices, faces) = box((8.0, 4.0, 2.5), materials), wall
    of_wall = np.broadcast_to(np.repeat(rows, 2 if np.ndim(rows) else 1), len(faces))
    return ss.Scene(
        np.concatenate([room.vertices, vertices]),
        np.concatenate([room.faces, faces + len(room.vertices)]),
        np.concatenate([room.face_material, of_wall]),
        materials,
    )


def _solid(
    materials: ss.MaterialTable,
    rows: int | list[int] | np.ndarray,
    thickness: float,
    inward: bool = False,
) -> ss.Scene:
    vertices, faces = _wall(thickness)
    return _rooms(materials, rows, (vertices, faces[:, ::-1] if inward else faces))


@kernel
def _cross(
    first: int, last: int, scene: tuple[Any, ...], p: np.ndarray, q: np.ndarray, out: np.ndarray
) -> None:
    for i in range(first, last):
        out[i] = 1.0
        cross_walls(scene[0], scene[1], row(p, i), row(q, i), out[i])


def _passed(scene: ss.Scene, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(n, 4) share of energy that passes straight between (n, 3) points."""
    prepared = prepare_scene(scene, plain())
    out = np.empty((len(p), 4))
    _cross(0, len(p), (prepared.geometry, prepared.surfaces), p - scene.center, q - scene.center, out)
    return out


def _between(seed: int, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Points of both rooms whose lines pass the wall well within its outline."""
    rng = np.random.default_rng(seed)
    low, high = np.array([0.1, 0.9, 0.6]), np.array([2.6, 3.1, 1.9])
    return rng.uniform(low, high, (count, 3)), rng.uniform(low, high, (count, 3)) + [5.3, 0.0, 0.0]


@pytest.mark.parametrize("inward", [False, True])
@pytest.mark.parametrize("reverse", [False, True])
def test_direct_sound_passes_once(inward: bool, reverse: bool) -> None:
    """Through the less transmitting material in every band, from either side, however its faces are wound."""
    materials = table(
        [[0.1] * 4, [0.2] * 4, [0.05] * 4], 0.5, [[0.0] * 4, [0.4, 0.1, 0.3, 0.0], [0.2, 0.3, 0.3, 0.1]]
    )
    scene = _solid(materials, [1, 2, 1, 1, 2, 2], 0.2, inward)
    ends = [np.array([2.0, 1.0, 1.2]), np.array([6.0, 2.5, 1.4])]
    p, q = reversed(ends) if reverse else ends
    e = ss.simulate(scene, [p], [q], plain(walks=8, connections={"subpaths": 0}, duration=0.03))[0, 0]
    assert e.direct is not None
    free = 1.0 / (4.0 * np.pi * np.sum((p - q) ** 2))
    np.testing.assert_allclose(e.direct.energy, free * np.array([0.2, 0.1, 0.3, 0.0]), rtol=1e-9)


@pytest.mark.parametrize("seed", few(range(6), 0, 4))
def test_no_damage_changes_what_passes(seed: int) -> None:
    """A triangle is missing, some are wound the other way (of a mesh that hangs together), corners are parted: all
    lines through the wall, also those through the hole, have its transmission, once."""
    rng = np.random.default_rng(seed)
    vertices, faces = _wall(rng.uniform(0.02, 0.42))
    p, q = _between(seed)
    share = np.array([[0.0] * 4, [0.4, 0.1, 0.3, 0.01]])
    materials = table([[0.1] * 4, [0.2] * 4], 0.5, share)
    turned, missing = faces.copy(), np.delete(faces, rng.integers(12), axis=0)
    some = rng.choice(12, 3, replace=False)
    turned[some] = turned[some, ::-1]
    meshes = [(vertices, faces), (vertices, turned), (vertices, missing), (vertices, faces[:4])]
    for gap in 10.0 ** np.arange(-7, -1):
        parted = vertices[faces].reshape(-1, 3) + rng.uniform(-gap, gap, (36, 3)) / 2.0
        meshes.append((parted, np.arange(36).reshape(12, 3)))
    for mesh in meshes:
        for a, b in ((p, q), (q, p)):
            out = _passed(_rooms(materials, 1, mesh), a, b)
            # A line may slip through a gap between triangles, in and out: of 200 at most some.
            clean = np.isclose(out, share[1], rtol=1e-9).all(axis=1)
            assert clean.mean() > 0.97
            assert np.isfinite(out).all()


@ci_slow
def test_depth_has_no_limit_at_which_sound_jumps() -> None:
    """From one element to two, by at most a tenth of the way (in dB) a centimetre, however oblique the line is."""
    materials = table([[0.1] * 4, [0.2] * 4], 0.5, [[0.0] * 4, [0.1] * 4])
    p, q = _between(0, 40)
    depths = np.arange(0.3, 1.3, 0.01)
    levels = np.array(
        [10.0 * np.log10(_passed(_rooms(materials, 1, _wall(d)), p, q)[:, 0]) for d in depths]
    )
    np.testing.assert_allclose(levels[depths < WHOLE - 1e-6], -10.0, atol=1e-6)
    np.testing.assert_allclose(levels[depths > APART + 1e-6], -20.0, atol=1e-6)
    steps = np.diff(levels, axis=0)
    assert (steps < 1e-9).all() and (steps > -1.0).all()


@pytest.mark.parametrize("gap", [0.0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1])
def test_two_leaves_are_two_elements(gap: float) -> None:
    """Whether they touch or not."""
    materials = table([[0.1] * 4, [0.2] * 4], 0.5, [[0.0] * 4, [0.4, 0.1, 0.3, 0.01]])
    (v, f), (w, g) = _wall(0.1, 3.95 - gap / 2), _wall(0.1, 4.05 + gap / 2)
    p, q = _between(1)
    out = _passed(_rooms(materials, 1, (np.concatenate([v, w]), np.concatenate([f, g + len(v)]))), p, q)
    np.testing.assert_allclose(
        out, np.broadcast_to(np.square([0.4, 0.1, 0.3, 0.01]), out.shape), rtol=1e-9
    )


def test_a_body_in_a_wall_is_an_element_of_its_own() -> None:
    """Whatever lies within a wall is passed as well, from either side."""
    materials = table([[0.1] * 4] * 3, 0.5, [[0.0] * 4, [0.4] * 4, [0.1, 0.2, 0.3, 0.5]])
    (v, f), (w, g) = _wall(0.3), _wall(0.1, 4.05)
    scene = _rooms(materials, 1, (np.concatenate([v, w]), np.concatenate([f, g + len(v)])))
    scene = ss.Scene(scene.vertices, scene.faces, np.repeat([0, 1, 2], 12), materials)
    p, q = _between(2)
    expected = 0.4 * np.array([0.1, 0.2, 0.3, 0.5])
    for a, b in ((p, q), (q, p)):
        out = _passed(scene, a, b)
        np.testing.assert_allclose(out, np.broadcast_to(expected, out.shape), rtol=1e-9)


def test_counts_of_what_was_taken_for_what() -> None:
    vertices, faces = box((0.2, 3.0, 2.0), MIXED).vertices + [4.0, 0.5, 0.2], _wall(0.2)[1]
    turned = faces.copy()
    turned[[0, 5]] = turned[[0, 5], ::-1]
    found = element_areas(_rooms(MIXED, 1, (vertices, turned)))
    # The narrow sides, 3 and 2 m from the opposite ones, are those of something deep.
    assert (found.whole, found.deep, found.sheets) == pytest.approx((12.0, 2.0, 0.0), abs=1e-6)
    assert found.turned == 2
    found = element_areas(_rooms(MIXED, 1, (vertices, faces[:2])))
    assert (found.whole, found.deep, found.sheets) == pytest.approx((0.0, 0.0, 6.0), abs=1e-6)


def _late(scene: ss.Scene, seed: int = 0) -> float:
    """dB, of what is not straight."""
    e = ss.simulate(scene, [P], [Q], plain(walks=4000, duration=0.6), seed=seed)
    return float(10.0 * np.log10(e.energy[0, 0].sum()))


@ci_slow
def test_late_sound_does_not_jump() -> None:
    """Beyond a wall of R = 20 dB; what twice R would take is 17 dB."""
    materials = table([[0.1] * 4, [0.2] * 4], 0.5, [[0.0] * 4, [0.01] * 4])
    vertices, faces = _wall(0.2)
    whole = _late(_rooms(materials, 1, (vertices, faces)))
    turned = faces.copy()
    turned[0] = turned[0, ::-1]
    rng = np.random.default_rng(0)
    soup = vertices[faces].reshape(-1, 3) + rng.uniform(-5e-4, 5e-4, (36, 3))
    for mesh in (
        (vertices, turned),
        (vertices, np.delete(faces, 8, axis=0)),
        (vertices, np.delete(faces, 0, axis=0)),
        (soup, np.arange(36).reshape(12, 3)),
        _wall(0.34),
        _wall(0.5),
    ):
        assert _late(_rooms(materials, 1, mesh)) == pytest.approx(whole, abs=1.5)


@ci_slow
@pytest.mark.parametrize("transfer", [False, True])
def test_a_wall_of_some_thickness_is_a_sheet_to_sound(transfer: bool) -> None:
    """Energies beyond a sheet of the same material, windows of 20 to 160 ms; of different seeds."""
    # Without transfer subpaths energies are noisier.
    settings = {"radiance_transfer": {"enabled": transfer}, "walks": 1000 if transfer else 3000}
    x = _engine(_solid(MIXED, 1, 0.002), P, Q, 24, **settings)
    y = _engine(two_rooms(MIXED, 1, False), [1.2, 1.0, 1.2 + 1e-9], Q, 24, **settings)
    for band in range(3):  # in the last one nothing passes
        _agree(x[:, band], y[:, band], f"solid wall, band {band}", 0.06)


@pytest.mark.slow
def test_against_a_forward_tracer() -> None:
    """Beyond a sheet, an independent tracer's energies: beyond a solid wall the engine's are the same."""
    x = _engine(_solid(MIXED, 1, 0.002), P, Q, 16)[:, 0]
    _agree(x, _twin(two_rooms(MIXED, 1, False), P, Q, 0, 60), "solid wall", 0.12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_techniques_agree_beyond_solids(seed: int) -> None:
    """With and without radiance transfer; the wall is thick, of materials drawn at random."""
    rng = np.random.default_rng(seed)
    absorption = rng.uniform(0.02, 0.4, (3, 4))
    materials = table(absorption, rng.uniform(0.2, 0.9, (3, 4)), rng.uniform(0.1, 0.5, (3, 4)))
    scene = _solid(materials, rng.integers(3, size=6), 0.3)
    x = _engine(scene, P, Q, 24, radiance_transfer={"enabled": False}, walks=16000)
    y = _engine(scene, [1.2, 1.0, 1.2 + 1e-9], Q, 24, walks=16000)  # other random numbers
    for band in range(4):
        _agree(x[:, band], y[:, band], f"band {band}", 0.05)
