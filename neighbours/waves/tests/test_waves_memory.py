"""What waves state of memory is what they take, and is refused before it is taken."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from soundspaces_waves import lattice, spectrum
from soundspaces_waves.scheme import make_wave_scene

import soundspaces_sim as ss
from tests.rooms import box, table, two_rooms


def _peak(scene: ss.Scene) -> float:
    """Bytes per cell that a lattice and its scheme take at most."""
    small = make_wave_scene(box((1.5, 1.4, 1.3), table(0.1, 0.1)), 150.0, 12.0, 343.0)  # compiles
    small.scheme(np.unique(small.component))
    tracemalloc.start()
    try:
        waves = make_wave_scene(scene, 150.0, 12.0, 343.0)
        waves.scheme(np.unique(waves.component))
        return tracemalloc.get_traced_memory()[1] / waves.lattice.cells
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("scene", [box((5.0, 4.0, 3.0), table(0.1, 0.1)), two_rooms(table(0.1, 0.1))])
def test_a_cell_takes_what_is_stated(scene: ss.Scene) -> None:
    """Arrays alone are counted here; the process's own memory is some 5 % more."""
    stated = lattice._OF_CELL
    assert 0.8 * stated < _peak(scene) < stated


def test_a_long_transform_is_refused_before_it_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """120 s take 17 GB in the form that is kept; nothing near it is touched."""
    monkeypatch.setattr("soundspaces_sim.core.memory.free_memory", lambda: 8e9)
    step, spacing = 3e-4, 0.16
    steps = spectrum.record_steps(176.0, 120.0, step)
    tracemalloc.start()
    try:
        with pytest.raises(ss.ConfigError, match=r"transform of waves of 120 s: .* GB .*are needed"):
            spectrum.make_transform(176.0, 120.0, steps, step, spacing, 343.0, None)
        assert tracemalloc.get_traced_memory()[1] < 1e8
    finally:
        tracemalloc.stop()


def test_a_transform_takes_little_more_than_it_is() -> None:
    step, spacing = 3e-4, 0.16
    steps = spectrum.record_steps(176.0, 3.0, step)
    tracemalloc.start()
    try:
        made = spectrum.make_transform(176.0, 3.0, steps, step, spacing, 343.0, None)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1.4 * made.matrix.nbytes
