"""A room from above: what is cut is dark, the floor is seen through the missing ceiling, outside is white."""

from __future__ import annotations

import numpy as np
from soundspaces_collections.axonometric import above_picture, gallery, inside_picture

import soundspaces_sim as ss


def test_the_demo_from_above() -> None:
    scene = ss.load_scene("demo")
    picture = above_picture(scene, pixels=160, elevation_deg=89.9)
    height, width, _ = picture.shape
    low, high = scene.bounds
    assert max(height, width) == 160 and picture.min() >= 0.0 and picture.max() <= 1.0
    # Straight from above with azimuth -60°, +X of the scene lies 30° below the picture's right.
    c, s = np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30))
    step = (c * (high[0] - low[0]) + s * (high[1] - low[1])) / width

    def pixel(x: float, y: float) -> tuple[float, ...]:
        x, y = x - 0.5 * (low[0] + high[0]), y - 0.5 * (low[1] + high[1])
        row, column = height / 2 - (c * y - s * x) / step, width / 2 + (c * x + s * y) / step
        return tuple(picture[int(row), int(column)].tolist())

    for wall in ((-0.1, 3.0), (10.9, 3.0), (4.0, -0.1), (4.0, 8.5)):  # the outer walls, 0.2 m thick
        assert pixel(*wall) == (0.25, 0.25, 0.25)
    assert (picture[0, 0] == 1.0).all()
    seen = {pixel(i + 0.5, j + 0.5) for i in range(10) for j in range(8)}
    assert len(seen) > 4  # floor, rugs, beds, …


def test_a_room_from_within() -> None:
    scene = ss.shoebox((4.0, 3.0, 2.5))
    picture = inside_picture(scene, np.array([2.0, 1.5, 1.25]), 0.0, width=80)
    assert picture.shape == (60, 80, 3) and picture.min() >= 0.0 and picture.max() < 1.0  # no sky
    # Floor, wall ahead and ceiling, from below up, are of three colours.
    column = picture[:, 40]
    assert len(np.unique(column[[2, 30, 58]], axis=0)) == 3
    np.testing.assert_allclose(
        picture, picture[:, ::-1], atol=0.12
    )  # the room is the same to the left and right


def test_a_page_of_scenes() -> None:
    page = gallery([ss.load_scene(f"room-{k}") for k in (0, 1, 2)], columns=2)
    assert [a.get_title() for a in page.axes] == ["room-0", "room-1", "room-2", ""]
