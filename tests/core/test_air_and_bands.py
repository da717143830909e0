"""Air absorption against ISO 9613-1's table, and band arithmetic."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import ArrayLike

import soundspaces_sim as ss
from soundspaces_sim.core.numerics import air
from soundspaces_sim.core.numerics.bands import (
    DEFAULT_BANDS,
    band_means,
    center_frequencies,
    check_edges,
    named_edges,
    nominal,
)
from soundspaces_sim.transport.model import air_table
from tests import iso9613


@pytest.mark.parametrize(
    ("temperature", "humidity", "frequency", "db_per_km"),
    # ISO 9613-1:1993, table 1 (exact midband frequencies 1000 * 10^(3 k / 10) Hz), 101.325 kPa
    [(20, 50, 1000.0, 4.66), (20, 50, 3981.07, 29.4), (20, 50, 125.89, 0.445), (10, 70, 1000.0, 3.66)],
)
def test_air_absorption(temperature: float, humidity: float, frequency: float, db_per_km: float) -> None:
    m = air.absorption(frequency, temperature, humidity, 101.325)
    assert 10.0 / np.log(10.0) * m * 1000.0 == pytest.approx(db_per_km, rel=0.01)


BANDS = ((0.0, 176.0, 775.0, 3409.0, 20000.0), (0.0, 20000.0), (88.4, 176.8, 5656.9, 11313.7))


@pytest.mark.parametrize("bands", BANDS)
@pytest.mark.parametrize("metres", [0.0, 10.0, 100.0, 200.0, 1700.0])
def test_what_air_leaves_of_a_band_is_the_mean_over_it(bands: tuple[float, ...], metres: float) -> None:
    """Against adaptive quadrature of ISO 9613-1 as written in tests/iso9613.py."""
    expected = [iso9613.left(low, high, metres) for low, high in pairwise(bands)]
    np.testing.assert_allclose(air.Air().transmission(bands, metres), expected, rtol=1e-6)


def test_air_of_the_octave_at_4_khz() -> None:
    """A band from 2.83 to 5.66 kHz loses what the standard's octave does: 29.4 dB/km at its centre (table 1), and
    a little more over 100 m for its slope."""
    lost = -10.0 * np.log10(air.Air().transmission((2818.4, 5623.4), 100.0)[0])
    assert lost == pytest.approx(2.94, rel=0.11)


def test_speed_of_sound() -> None:
    assert air.speed_of_sound(20.0) == pytest.approx(343.2)
    assert air.speed_of_sound(0.0) == pytest.approx(331.3, abs=0.1)


def test_octave_values_come_back_in_octave_bands() -> None:
    f = 125.0 * 2.0 ** np.arange(6)
    edges = (125.0 * 2.0 ** (np.arange(7) - 0.5)).tolist()
    values = np.random.default_rng(0).random((3, 6))
    np.testing.assert_allclose(band_means(f, values, edges), values)


def test_default_bands_average_over_log_frequency() -> None:
    f = 125.0 * 2.0 ** np.arange(6)
    mean = band_means(f, np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0]), DEFAULT_BANDS)
    # [176, 775]: from 176.8 to 707.1 Hz the value is 1
    assert mean[1] == pytest.approx(np.log(707.107 / 176.777) / np.log(775 / 176), rel=1e-4)
    np.testing.assert_allclose(center_frequencies(DEFAULT_BANDS)[1:3], [369.3, 1625.5], rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "count", "first", "last"), [("octaves", 9, 63.0, 16e3), ("thirds", 26, 50.0, 16e3)]
)
def test_bands_by_name_are_those_of_iec_61260(name: str, count: int, first: float, last: float) -> None:
    """The nominal frequencies of its table of thirds from 50 Hz, and every third of them; edges are half a band off."""
    thirds = [50, 63, 80, 100, 125, 160, 200, 250, 315, 400, 500, 630, 800, 1000, 1250, 1600, 2000, 2500, 3150, 4000,
              5000, 6300, 8000, 10000, 12500, 16000]  # fmt: skip
    edges = np.array(named_edges(name))
    centre = np.sqrt(edges[1:] * edges[:-1])
    assert len(centre) == count
    np.testing.assert_allclose(centre, thirds if name == "thirds" else thirds[1::3], rtol=0.02)
    np.testing.assert_allclose(edges[1:] / edges[:-1], 10.0 ** (0.3 if name == "octaves" else 0.1))
    assert [nominal(centre[0]), nominal(centre[-1])] == [first, last]


def test_bands_by_edges() -> None:
    assert named_edges("paper") == DEFAULT_BANDS
    assert named_edges("0, 500,8000") == (0.0, 500.0, 8000.0)
    for bad in ("octave", "", "100", "100,50", "nan,5", "1,,2"):
        with pytest.raises(ss.ConfigError, match="bands"):
            named_edges(bad)


@pytest.mark.parametrize(
    "edges", [[], [100.0], [200.0, 100.0], [-1.0, 10.0], [0.0, float("nan")], "abc"]
)
def test_bad_edges(edges: object) -> None:
    with pytest.raises(ss.ConfigError, match="bands"):
        check_edges(edges)  # type: ignore[arg-type]


def test_air_far_away_is_that_of_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """A table of 20 km (a face beyond all measure) integrates over the bands at 2 km, and a hundredth of what comes
    after; between, it is that of the length itself to 1e-5."""
    config, asked = ss.SimulationConfig(), 0
    transmission = air.Air.transmission

    def counted(self: air.Air, bands: Sequence[float], lengths: ArrayLike) -> np.ndarray:
        nonlocal asked
        asked += np.size(lengths)
        return transmission(self, bands, lengths)

    monkeypatch.setattr(air.Air, "transmission", counted)
    table = air_table(config, 20000.0, 0.1)
    assert len(table) > 200_000 and asked < 22_000
    for at in (19_000, 20_049, 20_150, 33_333, 123_456, 200_001):
        assert config.air is not None
        np.testing.assert_allclose(
            table[at], transmission(config.air, config.bands, 0.1 * at), rtol=1e-5, atol=1e-300
        )


def test_air_after_a_length_is_the_same_in_any_table() -> None:
    """A tile's table ends where its longest path does: no bit may tell."""
    config = ss.SimulationConfig()
    whole = air_table(config, 4000.0, 0.1)
    for longest in (1500.0, 1999.75, 2000.05, 2007.0, 2010.0, 3456.7):
        table = air_table(config, longest, 0.1)
        np.testing.assert_array_equal(table, whole[: len(table)])
