"""Which level surfaces are storeys."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.build.inspect import inspect_scene, report_text
from soundspaces_sim.scene.storeys import find_storeys
from tests.marks import ci_slow
from tests.rooms import box, table


def _built(*parts: tuple[np.ndarray, np.ndarray], name: str = "built") -> ss.Scene:
    """A scene of vertices and faces."""
    start = np.cumsum([0, *(len(v) for v, _ in parts)])
    vertices = np.concatenate([v for v, _ in parts])
    faces = np.concatenate([f + n for (_, f), n in zip(parts, start, strict=False)])
    return ss.Scene(vertices, faces, np.zeros(len(faces), int), table(0.2, 0.3), name=name)


def _room(x: float, y: float, z: float, at: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    scene = box((x, y, z), table(0.2, 0.3))
    return scene.vertices + [0.0, 0.0, at], scene.faces


def _block(
    x0: float, x1: float, y0: float, y1: float, z0: float, z1: float
) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.box(bounds=[[x0, y0, z0], [x1, y1, z1]])
    return np.array(mesh.vertices), np.array(mesh.faces)


def _sheet(
    x0: float, x1: float, y0: float, y1: float, z: float, up: bool
) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return vertices, faces if up else faces[:, ::-1]


def _classroom() -> ss.Scene:
    """Desks, and cupboards 1.98 m high and 0.6 m deep along two walls and back to back in the middle."""
    desks = [
        _block(1.5 + 1.4 * i, 2.1 + 1.4 * i, 1.2 + 2 * j, 2.6 + 2 * j, 0.7, 0.75)
        for i in range(4) for j in range(2)
    ]  # fmt: skip
    cupboards = [
        _block(0.0, 9.0, 6.4, 7.0, 0.0, 1.98),
        _block(0.0, 0.6, 0.0, 6.3, 0.0, 1.98),
    ]
    return _built(_room(9.0, 7.0, 4.2), *desks, *cupboards, name="classroom")


def _stairs(rise: float, steps: int) -> list[tuple[np.ndarray, np.ndarray]]:
    return [_block(1.0 + 0.3 * i, 1.3 + 0.3 * i, 0.5, 1.5, 0.0, rise * (i + 1)) for i in range(steps)]


def test_tops_of_cupboards_are_no_storey() -> None:
    scene = _classroom()
    storeys = find_storeys(scene)
    np.testing.assert_allclose(storeys.floors, [0.0], atol=1e-6)
    assert len(storeys.left_out) == 1 and "1.98 m is no storey" in storeys.left_out[0]
    assert np.all(ss.make_grid(scene).points[:, 2] == 1.5)


def test_the_back_of_a_suspended_ceiling_is_no_storey() -> None:
    hall, flat = _room(10.0, 8.0, 6.0), (0.05, 9.95, 0.05, 7.95, 2.8)
    outward = find_storeys(_built(hall, _sheet(*flat, up=True)))  # a box's floor faces down, out of it
    np.testing.assert_allclose(outward.floors, [0.0], atol=1e-6)
    assert "back of a ceiling" in outward.left_out[0]
    floor = find_storeys(_built(hall, _sheet(*flat, up=False)))
    np.testing.assert_allclose(floor.floors, [0.0, 2.8], atol=1e-6)
    assert not floor.walked[1]


@pytest.mark.parametrize("rise", [0.18, 0.3])
def test_a_gallery_is_a_storey_if_stairs_lead_there(rise: float) -> None:
    """12 m² of 96: too few for a storey that cannot be walked onto."""
    steps = round(2.7 / rise)
    gallery = _block(1.0 + 0.3 * steps, 12.0, 0.0, 2.2, 2.5, 2.7)
    storeys = find_storeys(_built(_room(12.0, 8.0, 5.5), gallery, *_stairs(rise, steps)))
    np.testing.assert_allclose(storeys.floors, [0.0, 2.7] if rise == 0.18 else [0.0], atol=1e-6)
    assert storeys.walked.all()


@pytest.mark.usefixtures("no_t30")
@ci_slow
def test_points_of_a_gallery_above_a_void_are_flagged() -> None:
    """A gallery of 6 x 8 m in a hall of 12 x 8 m: half of a flat slice at its height is in mid-air."""
    scene = _built(_room(12.0, 8.0, 6.0), _block(6.0, 12.0, 0.0, 8.0, 2.8, 3.0), name="hall")
    followed = ss.make_grid(scene, config=ss.GridConfig(spacing=1.0, rays=100))
    np.testing.assert_array_equal(np.bincount(followed.storey), [96, 48])
    report = inspect_scene(scene, ss.GridConfig(spacing=1.0, rays=100, follow_floor=False))
    np.testing.assert_array_equal(report.storey_points, [96, 96])
    np.testing.assert_array_equal(report.in_air, [0, 48])
    assert any(
        "48 of the 96 points on the storey at 3.00 m are in mid-air" in w for w in report.warnings
    )


@pytest.mark.slow
def test_what_is_looked_at_of_a_large_hall_is_a_sample() -> None:
    """50 x 40 m have 8,000 candidates at half a metre, of which every second is enough; each step is told."""
    steps: list[str] = []
    hall = box((50.0, 40.0, 6.0), table(0.5, 0.5))
    report = inspect_scene(hall, ss.GridConfig(rays=20), steps.append)
    assert 3800 <= report.candidates <= 4000
    assert report.spacing == pytest.approx(0.5 * 2.0**0.5, abs=0.01)
    assert any("more than 4,000 candidates" in note for note in report.notes)
    assert steps == ["Placing points", "Following rays", "Simulating 12 pairs"]
    assert report.t30.shape == (4,) and report.t30_pairs == 12


@pytest.mark.usefixtures("no_t30")
def test_flats_above_each_other_are_storeys_and_are_flagged() -> None:
    scene = _built(_room(6.0, 5.0, 2.5), _room(6.0, 5.0, 2.5, 2.7), name="flats")
    storeys = find_storeys(scene)
    np.testing.assert_allclose(storeys.floors, [0.0, 2.7], atol=1e-6)
    assert storeys.walked.sum() == 1
    # 6 x 5 m less 0.3 m along the walls, to a cell of 0.1 m
    np.testing.assert_allclose(storeys.area, 5.4 * 4.4, rtol=0.06)
    report = inspect_scene(scene, ss.GridConfig(rays=100))
    np.testing.assert_array_equal(report.storey_points, [120, 120])
    text = report_text(report)
    assert "cannot be walked onto" in text and "Nothing looks wrong" not in text
