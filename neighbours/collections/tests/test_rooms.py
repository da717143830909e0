"""Reverberation times of the rooms of a collection's buildings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="the extra `figures` is not installed")

from soundspaces_buildings.registry import building_rooms
from soundspaces_collections.rooms import RoomTimes, compared, rooms_of, surveyed, times_by_use

_BANDS = (0.0, 176.0, 775.0, 3409.0, 20000.0)


def _dataset(scene: str, points: np.ndarray, visible: np.ndarray, times: np.ndarray) -> Any:
    """All pairs of points; times (N, N) s in every band."""
    n = len(points)
    source, listener = (a.ravel() for a in np.divmod(np.arange(n * n), n))
    table = {"source": source, "listener": listener, "visible": visible.ravel()}
    table |= {f"t30_{b}": times.ravel() for b in range(4)}
    simulation = SimpleNamespace(bands=_BANDS)
    manifest = SimpleNamespace(
        scene=scene, points=points.tolist(), config=SimpleNamespace(simulation=simulation)
    )
    return SimpleNamespace(manifest=manifest, table=lambda: table)


def test_only_pairs_in_one_room_that_see_each_other_count() -> None:
    """Three places in a nave, of which the third is hidden from the others, and two in the chancel: of all ordered
    pairs two of the nave and two of the chancel count."""
    nave, chancel = building_rooms("church", 7)
    points = [
        np.append(room.inner.mean(axis=0) + (dx, 0.3 * dx), 1.5)
        for room, dx in ((nave, 0.0), (nave, 0.4), (nave, -0.4), (chancel, 0.0), (chancel, 0.2))
    ]
    visible = np.ones((5, 5), bool)
    visible[2, :2] = visible[:2, 2] = False
    times = np.full((5, 5), 9.0)
    times[0, 1], times[1, 0] = 2.0, 3.0
    times[3, 4], times[4, 3] = 1.0, np.nan
    found = rooms_of(_dataset("church-7", np.array(points), visible, times))
    assert [room.pairs for room in found] == [2, 2]
    assert [room.t30 for room in found] == [[2.5] * 4, [1.0] * 4]
    assert rooms_of(_dataset("demo", np.array(points), visible, times)) == []
    assert rooms_of(_dataset("house-3", np.array(points), visible, times)) == []


def _room(use: str, *t30: float | None) -> RoomTimes:
    return RoomTimes(use=use, area=10.0, pairs=2, t30=list(t30))


def test_times_are_means_of_the_middle_bands_by_use() -> None:
    rooms = [
        _room("hall", 9.0, 0.8, 1.0, 9.0),
        _room("living", 9.0, 0.4, 0.6, None),
        _room("living", 9.0, None, 0.6, 9.0),
        _room("bedroom", 9.0, 0.8, 1.0, 9.0),
        _room("living", 9.0, 0.5, 0.6, 9.0),
    ]
    times = times_by_use(rooms, _BANDS)
    assert next(iter(times)) == "living"
    np.testing.assert_allclose(times["living"], [0.5, 0.55])
    np.testing.assert_allclose(surveyed("home", times), [0.5, 0.55, 0.9])
    assert len(surveyed("office", times)) == 4
    # published are 0.35 to 0.69 s
    assert "Of the 3 living rooms and bedrooms" in compared("home", times)
    assert "67 % of them are within that, 33 % above" in compared("home", times)
    assert "no published figure" in compared("office", times) and compared("home", {}) == ""
