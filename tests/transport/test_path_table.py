"""The table of discrete paths, and the loop over pairs that fills it."""

from typing import NamedTuple

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.kernel import kernel, set_thread_count
from soundspaces_sim.echogram.echogram import EDGE, EDGE_MIRROR, MIRROR_EDGE, MIRRORS_AND_BACK
from soundspaces_sim.transport.arrivals import for_each_pair as loop
from soundspaces_sim.transport.arrivals.for_each_pair import FoundPath, PathSlots, for_each_pair, store
from soundspaces_sim.transport.model import air_transmission
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.tile import Tile, make_side, make_tile
from tests.rooms import box, plain, table

POINTS = np.array([[1.0, 1.0, 1.0], [2.0, 1.5, 1.2], [3.0, 2.0, 1.4], [1.2, 2.2, 0.8], [2.9, 0.7, 1.9]])


def _table(rng: np.random.Generator, rows: int, columns: int, count: int = 60) -> PathTable:
    second = rng.integers(-1, 3, count)
    planes = np.stack([rng.integers(0, 4, count), second], axis=1)
    return PathTable(
        pair=rng.integers(0, rows * columns, count),
        length=rng.integers(1, 5, count).astype(float),
        at_b=rng.normal(size=(count, 3)),
        at_a=rng.normal(size=(count, 3)),
        energy=rng.uniform(size=(count, 4)),
        planes=planes,
        kind=rng.choice([EDGE, EDGE_MIRROR, MIRROR_EDGE], count),
        wedges=np.stack([rng.integers(0, 9, count), np.full(count, -1)], axis=1),
    )


def _rows(paths: PathTable) -> list[tuple[object, ...]]:
    columns = (
        np.asarray(column).reshape(len(paths.pair), -1).tolist() for column in vars(paths).values()
    )
    return [tuple(map(tuple, row)) for row in zip(*columns, strict=True)]


def test_reversed_twice_is_the_same() -> None:
    paths = _table(np.random.default_rng(1), 3, 5)
    apart = np.ones((3, 5))
    back = paths.reversed(apart)
    assert _rows(back.reversed(apart.T)) == _rows(paths)
    i, j = np.divmod(paths.pair, 5)
    np.testing.assert_array_equal(back.pair, j * 3 + i)
    np.testing.assert_array_equal(back.at_a, paths.at_b)
    np.testing.assert_array_equal(back.kind == MIRROR_EDGE, paths.kind == EDGE_MIRROR)
    two = paths.planes[:, 1] >= 0
    np.testing.assert_array_equal(back.planes[two], paths.planes[two][:, ::-1])
    np.testing.assert_array_equal(back.planes[~two], paths.planes[~two])


def test_paths_from_a_place_to_itself_stay_as_they_are() -> None:
    paths = _table(np.random.default_rng(1), 3, 5)
    distance = np.ones((3, 5))
    distance[1, 2] = distance[2, 4] = 0.0  # the pairs 7 and 14, from b to a as well
    own = np.isin(paths.pair, [7, 14])
    back = paths.reversed(distance)
    itself = np.isin(back.pair, [7, 14])
    assert own.any() and _rows(back.rows(itself)) == _rows(paths.rows(own))
    assert _rows(back.rows(~itself)) == _rows(paths.rows(~own).reversed(distance))


def test_sorted_is_by_pair_then_length() -> None:
    """And by what a path met where these are equal: the order of the parts that were concatenated does not
    matter."""
    rng = np.random.default_rng(2)
    paths = _table(rng, 3, 5)
    ordered = paths.sorted()
    key = list(zip(ordered.pair.tolist(), ordered.length.tolist(), strict=True))
    assert key == sorted(key) and sorted(_rows(ordered)) == sorted(_rows(paths))
    mixed = paths.rows(rng.permutation(len(paths.pair)))
    halves = PathTable.concatenate([mixed.rows(np.arange(20, 60)), mixed.rows(np.arange(20))], 4)
    for one, other in zip(_rows(halves.sorted()), _rows(ordered), strict=True):
        assert one[0:2] == other[0:2] and one[5:] == other[5:]
    assert len(PathTable.concatenate([], 4).pair) == 0


def test_both_directions_have_each_pair_once() -> None:
    paths = _table(np.random.default_rng(3), 4, 4)
    i, j = np.divmod(paths.pair, 4)
    upper = paths.rows(i <= j)
    both = upper.both_directions(1.0 - np.eye(4))
    count = np.bincount(both.pair, minlength=16).reshape(4, 4)
    np.testing.assert_array_equal(count, count.T)
    assert len(both.pair) == len(upper.pair) + (i < j).sum()


class _Counts(NamedTuple):
    paths: np.ndarray  # (A, B) of each pair


@kernel
def _some_paths(
    first: int, last: int, context: _Counts, pairs: np.ndarray, slots: PathSlots, energy: np.ndarray
) -> None:
    """So many paths of each pair as the context says, their length 1 m, 2 m, …"""
    for k in range(first, last):
        i, j = pairs[k]
        for s in range(context.paths[i, j]):
            length = 1.0 + s
            energy[:] = length + i + 0.1 * j
            at = (1.0, 0.0, 0.0)
            store(
                slots,
                k,
                FoundPath(length, at, (0.0, 1.0, 0.0), (i, -1), EDGE, (j, s), (s, -1, -1)),
                energy,
            )


def _tile(same: bool) -> Tile:
    scene = box((4.0, 3.0, 2.5), table(0.3, 0.2))
    model = make_model(scene, POINTS, plain(walks=16, duration=0.1))
    a = make_side(model, POINTS)
    return make_tile(a, a if same else make_side(model, POINTS[:3] + 0.1))


@pytest.mark.parametrize("same", [True, False])
@pytest.mark.parametrize("threads", [1, 3])
def test_pairs_of_any_number_of_paths(same: bool, threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """None, few, and a hundred times more than there is room for at first; by a plain loop in Python."""
    monkeypatch.setattr(loop, "_SLOTS", 2)
    monkeypatch.setattr(loop, "_BLOCK", 4)
    tile = _tile(same)
    count = np.random.default_rng(5).integers(0, 4, (len(POINTS), len(tile.b.ends.points)))
    count[1, 2], count[0, 0] = 230, 0
    set_thread_count(threads)
    try:
        found = for_each_pair(tile, _some_paths, _Counts(count), tile.pairs, lambda _: np.empty(4), 1)
    finally:
        set_thread_count(None)
    expected: list[tuple[int, float, int, int]] = []  # pair, length, i, j
    back: list[tuple[int, float, int, int]] = []
    columns = count.shape[1]
    for i, j in tile.pairs.tolist():
        for s in range(count[i, j]):
            expected.append((i * columns + j, 1.0 + s, i, j))
            if same and i != j:
                back.append((j * columns + i, 1.0 + s, i, j))
    rows = expected + back
    np.testing.assert_array_equal(found.pair, [r[0] for r in rows])
    np.testing.assert_array_equal(found.length, [r[1] for r in rows])
    np.testing.assert_array_equal(found.planes, [[r[2], -1] for r in rows])
    dry = np.array([[r[1] + r[2] + 0.1 * r[3]] * 4 for r in rows])
    np.testing.assert_array_equal(found.energy, dry * air_transmission(tile.model.config, found.length))
    forward = np.arange(len(rows)) < len(expected)
    np.testing.assert_array_equal(found.at_b[forward], [[1.0, 0.0, 0.0]] * len(expected))
    np.testing.assert_array_equal(found.at_b[~forward], np.tile([0.0, 1.0, 0.0], (len(back), 1)))


def test_walls_of_a_shoebox_give_30_paths() -> None:
    """Six of one reflection, 18 of two, and six there and back, in both directions alike (no edges: nothing else)."""
    e = ss.simulate(
        box((4.0, 3.0, 2.5), table(0.3, 0.0)), POINTS[:2], POINTS[:2], plain(walks=8, duration=0.05)
    )
    for s, l in ((0, 1), (1, 0)):
        back = e[s, l].early.kind == MIRRORS_AND_BACK
        planes = e[s, l].early.planes[~back]
        assert back.sum() == 6
        assert ((planes >= 0).sum(axis=1) == 1).sum() == 6 and (
            (planes >= 0).sum(axis=1) == 2
        ).sum() == 18
