"""Long echograms: memory is known before it is taken, and bounded."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build.plan import block_size
from soundspaces_sim.core import memory as free
from soundspaces_sim.core.numerics.kernel import thread_count
from soundspaces_sim.transport import simulate as module
from soundspaces_sim.transport.memory import TileMemory, tile_memory
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.radiance_transfer.convolution import make_convolution, product_count
from soundspaces_sim.transport.radiance_transfer.prepared import patch_groups, transfer_subpaths
from tests.marks import CI_SLOW
from tests.rooms import plain

FINE = ((0.0, 0.001), (0.05, 0.002), (0.1, 0.005), (0.2, 0.01))
GB = 1e9


def _model(points: np.ndarray, **more: object) -> Model:
    room = ss.shoebox((6, 5, 3), absorption=0.3)
    return make_model(room, points, plain(**{"walks": 16, **more}))


def _points(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform([1, 1, 1], [5, 4, 2], (count, 3))


@pytest.mark.parametrize(("steps", "first"), [(6, 0), (7, 3), (100, 20), (101, 100)])
def test_products_are_counted_as_they_are_made(steps: int, first: int) -> None:
    assert product_count(steps, first) == len(make_convolution(steps, first).forward)


def test_the_largest_side_is_what_fits() -> None:
    memory = TileMemory(1e8, 7e6, 6e4)
    for budget in (4e8, 1e9, 3e9, 2e10):
        side = memory.largest_side(budget)
        assert memory.of(side) <= budget < memory.of(side + 1)
    assert memory.largest_side(0.0) == 1


@pytest.mark.parametrize(("duration", "count"), [(1.0, 16), pytest.param(4.0, 8, marks=CI_SLOW)])
def test_a_tile_takes_no_more_than_is_reckoned(duration: float, count: int) -> None:
    points = _points(count)
    model = _model(points, duration=duration, time_grid=FINE)
    _ = model.once(transfer_subpaths), model.once(patch_groups)
    expected = tile_memory(model, thread_count()).of(count)
    alone = tile_memory(model, thread_count(), same=True).of(count)
    tracemalloc.start()
    try:
        module.simulate_pairs(model, points, None)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 0.1 * expected < peak < alone < expected


def test_all_pairs_of_one_side_may_be_more_than_two_sides_have(monkeypatch: pytest.MonkeyPatch) -> None:
    """400 points for .6 s, where half of 24 GB is free for them; as many on either side of a tile are not."""
    model = _model(_points(4), duration=0.6)
    monkeypatch.setattr(module, "free_memory", lambda: 24.0 * GB)
    assert module.largest_side(model, 400) == 400
    two_sides = module.largest_side(model, 0)
    assert two_sides < 400
    assert module.largest_side(model, 500) == two_sides  # no part of them is all of them
    assert module.largest_side(model, module.SIDE + 1) == two_sides
    assert module.largest_side(model, 10) == two_sides


def test_a_minute_takes_as_much_as_a_few_seconds() -> None:
    points = _points(4)
    minute = tile_memory(_model(points, duration=60.0), 2)
    assert minute.of(16) < 2.5 * GB
    assert minute.of(16) < 2.0 * tile_memory(_model(points, duration=5.0), 2).of(16)
    assert tile_memory(_model(points, duration=60.0, time_grid=FINE), 2).of(16) > 5.0 * GB


def test_smaller_tiles_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    points = _points(7)
    model = _model(points, duration=0.3, radiance_transfer=False)
    whole = module.simulate_pairs(model, points, None)[0]
    memory = tile_memory(model, thread_count())
    monkeypatch.setattr(TileMemory, "largest_side", lambda *_: 3)
    parts = module.simulate_pairs(model, points, None)[0]
    np.testing.assert_array_equal(whole.energy, parts.energy)
    np.testing.assert_array_equal(whole.relative_error, parts.relative_error)
    assert memory.of(3) < memory.of(100)


def test_what_there_is_no_memory_for_is_refused_before_it_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = _points(2)
    model = _model(points, duration=60.0, time_grid=FINE)
    for where in (free, module):
        monkeypatch.setattr(where, "free_memory", lambda: 2.0 * GB)
    tracemalloc.start()
    try:
        with pytest.raises(
            ss.ConfigError, match=r"echograms of 60 s in 6,0.. bins: .* GB are free; shorten"
        ):
            module.simulate_pairs(model, points, None)
        assert tracemalloc.get_traced_memory()[1] < 1e7
    finally:
        tracemalloc.stop()


def test_tiles_of_long_echograms_are_small() -> None:
    """The plan of a job is the same on every machine, so it reckons with memory that every worker has."""
    points = _points(4)
    assert block_size(1000, _model(points, duration=1.0)) > 100
    assert block_size(1000, _model(points, duration=60.0)) < 60
    assert block_size(1000, _model(points, duration=60.0, time_grid=FINE)) == 1
