"""Spreads of measures by absorption: Jacobians against closed forms, draws, and what tables say."""

from dataclasses import replace

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.echogram.echogram import Arrivals, Echogram
from soundspaces_sim.echogram.material_spread import (
    logits,
    measure_jacobian,
    measure_spread,
    reproducibility,
    variety,
)
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.echogram.measures import room_measures
from soundspaces_sim.echogram.reflection_counts import MaterialGroups, ReflectionCounts
from soundspaces_sim.echogram.refurnish import refurnished
from soundspaces_sim.echogram.time_windows import COUNTS, time_windows
from tests.rooms import box, plain, table

BANDS = (50.0, 500.0, 5000.0)
RATE = np.array([200.0, 90.0])  # 1/s, of what hits walls
ABSORPTION = np.array([[0.2, 0.5], [0.05, 0.1]])
SHARE = np.array([0.3, 0.7])


def _exponential() -> Echogram:
    """Walls that are hit at random: counts are Poisson, weighted by energy n̄ = rate ρ t, and E = exp(-Σ rate α t)."""
    groups = MaterialGroups(("a", "b"), SHARE, ABSORPTION, np.zeros((2, 2)), np.full((2, 2), -0.2))
    edges = np.linspace(0.0, 2.0, 2001)
    window, middle = time_windows(edges, COUNTS), 0.5 * (edges[1:] + edges[:-1])
    time = np.bincount(window, middle) / np.bincount(window)
    time[0] = 0.0  # before the first one counts do not fall further
    mean = time[:, None, None] * SHARE[:, None] * RATE * (1.0 - ABSORPTION)
    one, none = np.ones_like(mean), np.zeros((len(time), 1, 2))
    counts = ReflectionCounts(groups, np.repeat(time[:, None], 2, axis=1), mean, one, one, none)
    energy = np.zeros((2000, 9, 2), np.float32)
    energy[:, 0] = np.exp(-RATE * (SHARE @ ABSORPTION) * middle[:, None])
    early = Arrivals(*(np.empty((0, *s)) for s in ((), (2,), (3,), (2,))))
    return Echogram(BANDS, edges, energy, None, early, np.zeros((2, 2)), False, counts=counts)


def test_jacobian_of_an_exponential_decay() -> None:
    """T30 = 6 ln 10 / Σ rate α, so dT/dα_m = -T rate_m / Σ rate α; Ts = 1 / Σ rate α."""
    echogram = _exponential()
    rates = SHARE[:, None] * RATE
    decay = (rates * ABSORPTION).sum(axis=0)
    found = measure_jacobian(echogram, ("t30", "ts"))
    np.testing.assert_allclose(found[0], -6.0 * np.log(10.0) * rates / decay**2, rtol=4e-3)
    np.testing.assert_allclose(found[1], -rates / decay**2, rtol=1e-2)
    spread = measure_spread(echogram, 0.01 * np.ones((2, 2)), ("t30",))
    np.testing.assert_allclose(spread[0], 0.01 * np.sqrt((found[0] ** 2).sum(axis=0)))


def test_spread_is_that_of_draws() -> None:
    """A tenth of what laboratories differ by in a room: the standard deviation of 400 draws, whose own is 3.5 %, is the
    Jacobian's, z below 4 for all measures."""
    room = box((5.0, 4.0, 3.0), table([0.3, 0.1, 0.2], [0.7] * 3), [0, 0, 1, 1, 2, 2])
    config = plain(walks=160, duration=0.8, materials=True)
    echogram = ss.simulate(room, [[1.2, 1.1, 1.5]], [[3.7, 2.6, 1.1]], config)[0, 0]
    assert echogram.counts is not None
    groups, names = echogram.counts.groups, ("t30", "edt", "c80", "d50")
    spread = 0.1 * reproducibility(groups.absorption, echogram.bands)
    expected = measure_spread(echogram, spread, names)
    rng, draws, found = np.random.default_rng(3), 400, []
    for _ in range(draws):
        absorption = groups.absorption + spread * rng.standard_normal(spread.shape)
        drawn = room_measures(refurnished(echogram, absorption, force=True))
        found.append([getattr(drawn, name) for name in names])
    deviation = np.std(found, axis=0, ddof=1)
    assert np.isfinite(expected).all()
    z = (deviation / expected - 1.0) * np.sqrt(2.0 * (draws - 1))
    assert np.abs(z).max() < 4.0


def test_what_laboratories_and_products_differ_by() -> None:
    """ISO 12999-2:2020, Table 1, for octaves; a carpet's kind against the rows themselves."""
    octaves = 125.0 * 2.0 ** (np.arange(7) - 0.5)
    found = reproducibility(np.full(6, 0.5), tuple(octaves))
    np.testing.assert_allclose(found, [0.105, 0.06, 0.04, 0.035, 0.0385, 0.055])
    carpets = ("carpet", "carpet-heavy", "carpet-thin", "carpet-on-foam", "carpet-tufted", "needle-felt")
    rows = ss.load_scene("demo").materials
    values = logits(np.array([rows.absorption[rows.index(name)] for name in carpets]))
    both = variety(["carpet", "carpet-thin", "marzipan"])
    np.testing.assert_allclose(both[:2], np.sqrt(values.var(axis=0, ddof=1).mean()))
    assert 0.2 < both[2] < 1.5


def test_what_is_refused() -> None:
    echogram = _exponential()
    with pytest.raises(MaterialError, match="has no counts of reflections"):
        measure_jacobian(replace(echogram, counts=None))
    for bad in (np.zeros((2, 3)), np.full((2, 2), np.nan), -np.ones((2, 2))):
        with pytest.raises(MaterialError, match=r"expected \(2, 2\) numbers, none negative"):
            measure_spread(echogram, bad)
    assert measure_spread(echogram).shape == (len(MEASURES), 2)
