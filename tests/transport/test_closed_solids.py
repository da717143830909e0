"""Sound through closed solids: what a wall of some thickness lets pass is what a sheet of its material does."""

from __future__ import annotations

import logging

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.transport.preparation import prepare_scene
from tests.marks import ci_slow
from tests.rooms import box, plain, table, two_rooms
from tests.transport.test_agreement import MIXED, _agree, _engine, _twin

P, Q = [1.2, 1.0, 1.2], [6.5, 2.8, 1.4]


def _rooms(
    materials: ss.MaterialTable, rows: object, thickness: float, inward: bool = False
) -> ss.Scene:
    """Two rooms of 4 x 4 x 2.5 m side by side along x, and between them a solid wall whose middle is at x = 4."""
    room, wall = box((8.0, 4.0, 2.5), materials), box((thickness, 4.002, 2.502), materials, rows)
    faces = wall.faces[:, ::-1] if inward else wall.faces
    return ss.Scene(
        np.concatenate([room.vertices, wall.vertices + [4.0 - thickness / 2, -0.001, -0.001]]),
        np.concatenate([room.faces, faces + len(room.vertices)]),
        np.concatenate([room.face_material, wall.face_material]),
        materials,
    )


@pytest.mark.parametrize("inward", [False, True])
@pytest.mark.parametrize("reverse", [False, True])
def test_direct_sound_passes_once(inward: bool, reverse: bool) -> None:
    """Through the least transmitting material in every band, from either side, however its faces are wound."""
    materials = table(
        [[0.1] * 4, [0.2] * 4, [0.05] * 4], 0.5, [[0.0] * 4, [0.4, 0.1, 0.3, 0.0], [0.2, 0.3, 0.3, 0.1]]
    )
    scene = _rooms(materials, [1, 2, 1, 1, 2, 2], 0.2, inward)
    ends = [np.array([2.0, 1.0, 1.2]), np.array([6.0, 2.5, 1.4])]
    p, q = reversed(ends) if reverse else ends
    e = ss.simulate(scene, [p], [q], plain(walks=8, connections={"subpaths": 0}, duration=0.03))[0, 0]
    assert e.direct is not None
    free = 1.0 / (4.0 * np.pi * np.sum((p - q) ** 2))
    np.testing.assert_allclose(e.direct.energy, free * np.array([0.2, 0.1, 0.3, 0.0]), rtol=1e-9)


def test_outside_reflects_as_the_table_says_and_inside_nothing() -> None:
    materials = table([[0.1] * 4, [0.2] * 4], 0.5, [[0.3] * 4, [0.05] * 4])
    prepared = prepare_scene(_rooms(materials, [0, 1, 1, 1, 1, 1], 0.1), plain())
    energy = prepared.surfaces.energy[prepared.geometry.material]  # (F, 2, l, b)
    outside, inside = energy[12:, 0], energy[12:, 1]
    np.testing.assert_allclose(outside.sum(axis=1)[:2], 0.6 + 0.05)
    np.testing.assert_allclose(outside.sum(axis=1)[2:], 0.75 + 0.05)
    np.testing.assert_allclose(inside, np.broadcast_to([[0.0], [0.0], [1.0]], inside.shape))
    np.testing.assert_allclose(energy[:12].sum(axis=2), 0.9)


def test_points_in_solids_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    scene, quick = _rooms(MIXED, 1, 0.4), plain(walks=8, connections={"subpaths": 0}, duration=0.03)
    with caplog.at_level(logging.WARNING, "soundspaces_sim"):  # whatever other tests have set
        ss.simulate(scene, [P], [Q], quick)
        assert "closed solids" not in caplog.text
        ss.simulate(scene, [P], [Q, [4.05, 1.0, 1.0]], quick)
    assert "1 of 3 points lie in closed solids, the first at (4.050, 1.000, 1.000) m" in caplog.text


@ci_slow
@pytest.mark.parametrize("transfer", [False, True])
def test_a_wall_of_some_thickness_is_a_sheet_to_sound(transfer: bool) -> None:
    """Energies beyond a sheet of the same material, windows of 20 to 160 ms; of different seeds."""
    # Without transfer subpaths energies are noisier.
    settings = {"radiance_transfer": {"enabled": transfer}, "walks": 1000 if transfer else 3000}
    x = _engine(_rooms(MIXED, 1, 0.002), P, Q, 24, **settings)
    y = _engine(two_rooms(MIXED, 1, False), [1.2, 1.0, 1.2 + 1e-9], Q, 24, **settings)
    for band in range(3):  # in the last one nothing passes
        _agree(x[:, band], y[:, band], f"solid wall, band {band}", 0.06)


@pytest.mark.slow
def test_against_a_forward_tracer() -> None:
    """Beyond a sheet, an independent tracer's energies: beyond a solid wall the engine's are the same."""
    x = _engine(_rooms(MIXED, 1, 0.002), P, Q, 16)[:, 0]
    _agree(x, _twin(two_rooms(MIXED, 1, False), P, Q, 0, 60), "solid wall", 0.12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_techniques_agree_beyond_solids(seed: int) -> None:
    """With and without radiance transfer; the wall is thick, of materials drawn at random."""
    rng = np.random.default_rng(seed)
    absorption = rng.uniform(0.02, 0.4, (3, 4))
    materials = table(absorption, rng.uniform(0.2, 0.9, (3, 4)), rng.uniform(0.1, 0.5, (3, 4)))
    scene = _rooms(materials, rng.integers(3, size=6), 0.3)
    x = _engine(scene, P, Q, 24, radiance_transfer={"enabled": False}, walks=16000)
    y = _engine(scene, [1.2, 1.0, 1.2 + 1e-9], Q, 24, walks=16000)  # other random numbers
    for band in range(4):
        _agree(x[:, band], y[:, band], f"band {band}", 0.05)
