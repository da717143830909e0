"""Extents of triangles in columns: a sloping one whose extents are known, and blocks that change nothing."""

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.scene import heightfield
from soundspaces_sim.scene.heightfield import footprints, vertical_spans

CELL = 0.25
RAMP = np.array(
    [
        [[0.0, 0.0, 0.0], [4.0, 0.0, 2.0], [4.0, 4.0, 2.0]],
        [[0.0, 0.0, 0.0], [4.0, 4.0, 2.0], [0.0, 4.0, 0.0]],
    ]
)
WALL = np.array([[[1.1, 0.6, 0.0], [1.1, 3.4, 0.0], [1.1, 3.4, 5.0]]])


def test_extents_of_a_ramp() -> None:
    """z = x / 2: in the columns from x to x + 1/4 its spans begin at x / 2 and end at x / 2 + 1/8."""
    cells, spans = vertical_spans(RAMP, CELL)
    column = np.repeat(np.arange(cells.nx * cells.ny), np.diff(spans.start))
    x = cells.x0 + CELL * (column // cells.ny)
    inside = (x > -1e-9) & (x < 4.0 - 1e-9)
    low, high = np.full(cells.nx, np.inf), np.full(cells.nx, -np.inf)
    np.minimum.at(low, (column // cells.ny)[inside], spans.bottom[inside])
    np.maximum.at(high, (column // cells.ny)[inside], spans.top[inside])
    at = cells.x0 + CELL * np.arange(cells.nx)
    seen = np.isfinite(low)
    assert seen.sum() == 16
    np.testing.assert_allclose(low[seen], at[seen] / 2.0, atol=2e-5)
    np.testing.assert_allclose(high[seen], at[seen] / 2.0 + CELL / 2.0, atol=2e-5)


def test_the_highest_face_between_two_heights() -> None:
    """The wall hides the ramp in its own columns, up to where it is too high; of equal faces the first counts."""
    corners, value = np.concatenate([RAMP, WALL, WALL]), np.array([0, 0, 1, 2])
    cells, _ = vertical_spans(corners, CELL)
    found = footprints(corners, value, cells, 0.01, 2.5)
    assert set(np.unique(found)) == {-1, 0, 1}
    walls = np.argwhere(found == 1)
    assert set(walls[:, 0]) == {int((1.1 - cells.x0) / CELL)}
    # it rises by 5 m over 2.8 m: 2.5 m at y = 2, where its columns end
    assert cells.y0 + CELL * (walls[:, 1].max() + 1) == pytest.approx(2.0, abs=CELL)


@pytest.mark.parametrize("at_a_time", [1, 7, 1000])
def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch, at_a_time: int) -> None:
    scene = ss.load_scene("demo")
    corners, value = np.ascontiguousarray(scene.corners[::40]), scene.face_material[::40]
    cells, spans = vertical_spans(corners, 0.1)
    whole = footprints(corners, value, cells, 0.1, 2.0)
    monkeypatch.setattr(heightfield, "_AT_A_TIME", at_a_time)
    for own, other in zip(vertical_spans(corners, 0.1)[1], spans, strict=True):
        np.testing.assert_array_equal(own, other)
    np.testing.assert_array_equal(footprints(corners, value, cells, 0.1, 2.0), whole)
