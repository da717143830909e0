"""Room measures of waves, and what they are known to."""

from __future__ import annotations

import numpy as np
import pytest
import soundspaces_waves as sw
from msgspec.structs import replace
from soundspaces_parameters.of_waves import LOW_MEASURES, octaves_below
from soundspaces_waves import measures

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError
from tests.marks import ci_slow

SIZE = np.array([3.2, 2.7, 2.4])
CONFIG = ss.SimulationConfig(low=ss.LowConfig(cells_per_wavelength=9.0))


@ci_slow
def test_error_bars_hold_a_finer_lattice_and_other_phases() -> None:
    """What a lattice of half the cells gives differs by no more than the bar of discretisation, in the mean square over
    pairs; what a spring of half the resistance gives, by no more than that of impedance."""
    room = ss.shoebox(tuple(SIZE), absorption=0.2)
    rng = np.random.default_rng(4)
    sources, listeners = (rng.uniform(0.1, 0.9, (n, 3)) * SIZE for n in (2, 5))
    found = sw.low_measures(room, sources, listeners, 1.0, CONFIG)
    assert found.edges == octaves_below(176.0)
    assert "t20, t30, edt, c50" in repr(found)
    assert found.value["c80"].shape == (2, 5, 2)
    low = replace(CONFIG.low, cells_per_wavelength=16.0)
    fine = sw.low_measures(room, sources, listeners, 1.0, replace(CONFIG, low=low))
    spring = sw.simulate_low(
        room, sources, listeners, 1.0, CONFIG, cells_per_wavelength=9.0, reactance=-0.5
    )
    onset = measures._onsets(room, sources, listeners, CONFIG.c)
    of_spring = dict(zip(LOW_MEASURES, measures._measures(spring, found.edges, onset), strict=True))
    for name in ("t20", "edt", "c80", "d50"):
        for bar, changed in ((found.discretisation, fine.value), (found.impedance, of_spring)):
            moved = changed[name] - found.value[name]
            known = np.isfinite(moved) & np.isfinite(bar[name])
            assert known.mean() > 0.4, name
            moved, bars = (np.sqrt(np.mean(x[known] ** 2)) for x in (moved, bar[name]))
            assert moved < bars, name
    small = [np.nanmean(x["c80"]) for x in (found.discretisation, found.impedance)]
    assert small[0] < 0.5 * small[1]  # the lattice matters less than what a table does not say


def test_what_is_refused() -> None:
    room, ends = ss.shoebox(tuple(SIZE)), ([1.0, 1.0, 1.0], [2.0, 1.5, 1.2])
    with pytest.raises(ConfigError, match=r"at least 7\.2 for a second lattice"):
        coarse = replace(CONFIG, low=replace(CONFIG.low, cells_per_wavelength=7.0))
        sw.low_measures(room, *ends, 0.2, coarse)
    with pytest.raises(ConfigError, match="edges up to 176 Hz"):
        sw.low_measures(room, *ends, 0.2, CONFIG, edges=(50.0, 400.0))
    with pytest.raises(ConfigError, match="no octave from 63 Hz on"):
        sw.low_measures(room, *ends, 0.2, replace(CONFIG, low=replace(CONFIG.low, edge=60.0)))
    with pytest.raises(ss.PointError):
        sw.low_measures(room, [9.0, 1.0, 1.0], ends[1], 0.2, CONFIG)
