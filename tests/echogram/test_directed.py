"""Directive ends: patterns, and what they do to echograms made by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.axes import head_matrix, spherical_harmonics
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.directed import aim, band_energy, bin_gains, departures, gains
from soundspaces_sim.echogram.echogram import Arrival, Arrivals
from soundspaces_sim.rendering.directivity import (
    DIRECTIVITIES,
    DirectivityError,
    as_directivity,
    real_harmonics,
)

ANGLES = np.deg2rad(np.array([0.0, 30.0, 60.0, 90.0, 135.0, 180.0]))
AROUND = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], axis=1)


def _directions(n: int, seed: int = 1) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def _echogram(paths: np.ndarray, early: Arrivals, direct: Arrival | None) -> ss.Echogram:
    """One bin per path, which came from `paths` (n, 3)."""
    table = np.repeat(spherical_harmonics(paths)[:, :, None], 4, axis=2).astype(np.float32)
    edges = np.arange(len(paths) + 1) * 0.001
    return ss.Echogram(DEFAULT_BANDS, edges, table, direct, early, np.zeros((2, 4)), True)


def _pair() -> tuple[ss.Echogram, ss.Echogram, np.ndarray, np.ndarray]:
    """p -> q and q -> p: five bins of one path each, direct sound, three mirror paths; and the departure
    directions of the paths and of the mirror paths."""
    leave, arrive = _directions(5, 2), _directions(5, 3)
    out, back = _directions(3, 4), _directions(3, 5)
    delay = np.array([0.002, 0.003, 0.004])
    energy = np.arange(1.0, 13.0).reshape(3, 4)
    # in order of delay either way, but planes (7, 2) come back as (2, 7)
    there = Arrivals(delay, energy, back, np.array([[5, -1], [7, 2], [2, 7]]))
    again = Arrivals(delay, energy, out, np.array([[5, -1], [2, 7], [7, 2]]))
    direct = Arrival(0.001, np.full(4, 2.0), np.array([0.6, 0.0, 0.8]))
    other = Arrival(0.001, np.full(4, 2.0), -direct.direction)
    return _echogram(arrive, there, direct), _echogram(leave, again, other), leave, out


@pytest.mark.parametrize(
    ("pattern", "mean", "wanted"),
    [
        (ss.Omni(), 1.0, [1.0] * 6),
        (ss.Cardioid(), 1 / 3, ((1.0 + np.cos(ANGLES)) / 2.0) ** 2),
        (ss.Cardioid(p=0.0), 1 / 3, np.cos(ANGLES) ** 2),
        (ss.Cardioid(p=0.25), 1 / 4, (0.25 + 0.75 * np.cos(ANGLES)) ** 2),
        (ss.Cardioid(order=2), 1 / 5, ((1.0 + np.cos(ANGLES)) / 2.0) ** 4),
        (ss.SphericalHarmonics((0.5, 0.0, 0.0, 0.5)), 1 / 3, ((1.0 + np.cos(ANGLES)) / 2.0) ** 2),
    ],
)
def test_patterns_and_their_means(pattern: ss.Directivity, mean: float, wanted: list[float]) -> None:
    """Closed forms; the means over the sphere are the inverses of the textbook directivity factors 1, 3, 3,
    4, 5, 3."""
    to = aim(pattern, DEFAULT_BANDS, "pattern")
    assert to is not None
    np.testing.assert_allclose(gains(to, AROUND), np.repeat(np.array(wanted)[:, None], 4, 1), atol=1e-12)
    np.testing.assert_allclose(to.pattern.moments[0], mean, rtol=1e-12)
    power = aim(pattern, DEFAULT_BANDS, "power")
    assert power is not None
    np.testing.assert_allclose(gains(power, AROUND), gains(to, AROUND) / mean, rtol=1e-12, atol=1e-15)


def test_a_talker_is_the_published_one() -> None:
    """Monson et al. 2012: octave levels at 90° and 180°; octave bands read their columns back exactly."""
    octaves = tuple(62.5 * 2.0 ** (k + 0.5) for k in range(9))
    got = 10.0 * np.log10(band_energy(ss.Talker(), AROUND, octaves))
    np.testing.assert_allclose(got[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(got[3], [-1.6, -2.3, -1.6, -1.6, -7.0, -6.3, -8.7, -7.2], atol=1e-9)
    np.testing.assert_allclose(got[5], [-3.6, -5.1, -5.9, -6.3, -13.1, -18.9, -26.3, -26.7], atol=1e-9)
    up = band_energy(ss.Talker(), np.array([[0.0, 0.0, 1.0]]), octaves)
    np.testing.assert_allclose(10.0 * np.log10(up[0]), got[3], atol=1e-9)


def test_turning() -> None:
    """A heading of 90° faces +Y; pitch up; a source's turn comes on top of its directivity's."""
    front = np.eye(3)[[0, 1, 2]]
    for pattern, strongest in (
        (ss.Cardioid(heading_deg=90.0), 1),
        (ss.Cardioid(pitch_deg=90.0), 2),
        (ss.Source((0, 0, 0), ss.Cardioid(), heading_deg=90.0), 1),
        (ss.Source((0, 0, 0), ss.Cardioid(heading_deg=30.0), heading_deg=-30.0), 0),
        (ss.Source((0, 0, 0), ss.Cardioid(heading_deg=90.0), roll_deg=90.0), 2),
    ):
        to = aim(pattern, DEFAULT_BANDS, "pattern")
        assert to is not None
        np.testing.assert_allclose(gains(to, front)[strongest], 1.0, atol=1e-12)


@pytest.mark.parametrize("p", [1.0, 0.75, 0.5, 0.25, 0.0])
def test_bins_are_exact_for_first_order_patterns(p: float) -> None:
    """sum d_nm S_nm of a bin with many paths is the sum of their energies times the pattern."""
    d, w = _directions(20, 6), np.random.default_rng(7).uniform(size=20)
    bins = (w @ spherical_harmonics(d))[None, :, None] * np.ones(4)
    pattern = ss.Cardioid(p, heading_deg=37.0, pitch_deg=-20.0, roll_deg=11.0)
    to = aim(pattern, DEFAULT_BANDS, "power")
    assert to is not None
    cosine = d @ head_matrix(37.0, -20.0, 11.0)[:, 0]
    mean = p**2 + (1.0 - p) ** 2 / 3.0
    wanted = (w * (p + (1.0 - p) * cosine) ** 2).sum() / w.sum() / mean
    np.testing.assert_allclose(bin_gains(to, bins), wanted, rtol=1e-9)


def test_bins_stay_in_the_patterns_range_and_keep_the_mean() -> None:
    """A narrow pattern, cut at order 2, would be negative behind: it is not; a diffuse bin gets the mean."""
    to = aim(ss.Cardioid(order=6), DEFAULT_BANDS, "pattern")
    assert to is not None
    table = np.repeat(spherical_harmonics(_directions(500, 8))[:, :, None], 4, axis=2)
    assert bin_gains(to, table).min() >= 0.0 and bin_gains(to, table).max() <= 1.0
    np.testing.assert_allclose(bin_gains(to, np.eye(9)[None, :, [0, 0, 0, 0]]), 1.0 / 13.0, rtol=1e-9)
    np.testing.assert_allclose(bin_gains(to, np.zeros((1, 9, 4))), 1.0 / 13.0, rtol=1e-9)


def test_direct_and_early_take_the_pattern_at_departure() -> None:
    """Exactly its square (`level` pattern); bins of one path each as well, for a cardioid."""
    echogram, reverse, leave, out = _pair()
    pattern = ss.Cardioid(heading_deg=70.0, level="pattern")
    front = head_matrix(70.0, 0.0, 0.0)[:, 0]
    got = ss.directed(echogram, reverse, source=pattern)
    assert got.direct is not None and echogram.direct is not None

    def square(d: np.ndarray) -> np.ndarray:
        return np.asarray(((1.0 + d @ front) / 2.0) ** 2)

    np.testing.assert_allclose(got.direct.energy, 2.0 * square(-echogram.direct.direction), rtol=1e-12)
    # path 1 left towards out[2]: its planes (7, 2) are (2, 7) reversed
    own = out[[0, 1, 2]]
    np.testing.assert_array_equal(departures(echogram.early, reverse.early), own)
    np.testing.assert_allclose(
        got.early.energy, echogram.early.energy * square(own)[:, None], rtol=1e-12
    )
    np.testing.assert_allclose(
        got.energy, echogram.energy * square(leave)[:, None, None], rtol=1e-5, atol=1e-6
    )
    np.testing.assert_array_equal(got.early.direction, echogram.early.direction)


def test_a_microphone_takes_the_pattern_at_arrival() -> None:
    echogram, *_ = _pair()
    got = ss.directed(echogram, listener=ss.Listener((0, 0, 0), ss.Cardioid(), heading_deg=70.0))
    front = head_matrix(70.0, 0.0, 0.0)[:, 0]
    assert got.direct is not None and echogram.direct is not None
    wanted = 2.0 * ((1.0 + echogram.direct.direction @ front) / 2.0) ** 2
    np.testing.assert_allclose(got.direct.energy, wanted, rtol=1e-12)
    share = ((1.0 + echogram.early.direction @ front) / 2.0) ** 2
    np.testing.assert_allclose(got.early.energy, echogram.early.energy * share[:, None], rtol=1e-12)
    arrive = echogram.energy[:, [3, 1, 2], 0]
    share = ((1.0 + arrive @ front) / 2.0) ** 2
    np.testing.assert_allclose(got.energy[:, 0, 0], share, rtol=1e-5, atol=1e-6)


def test_omnidirectional_ends_change_nothing() -> None:
    echogram, reverse, *_ = _pair()
    assert ss.directed(echogram, reverse) is echogram
    same = ss.directed(echogram, reverse, source=ss.Omni(), listener=ss.Omni())
    np.testing.assert_allclose(same.energy, echogram.energy, rtol=1e-6)
    np.testing.assert_allclose(same.early.energy, echogram.early.energy, rtol=1e-12)
    louder = ss.directed(echogram, reverse, source=ss.Omni(gain_db=10.0))
    np.testing.assert_allclose(louder.early.energy, 10.0 * echogram.early.energy, rtol=1e-12)


def test_what_is_not_the_reverse_is_refused() -> None:
    echogram, reverse, *_ = _pair()
    with pytest.raises(ss.PairIndexError, match="needs the echogram"):
        ss.directed(echogram, source=ss.Cardioid())
    late = replace(reverse, early=replace(reverse.early, delay=reverse.early.delay + 1e-6))
    with pytest.raises(ss.PairIndexError, match="do not match"):
        ss.directed(echogram, late, source=ss.Cardioid())


def test_by_frequency() -> None:
    """Omnidirectional to the edge at 775 Hz, a cardioid above it."""
    pattern = ss.FrequencyDependent((400.0, 775.0**2 / 400.0), (ss.Omni(), ss.Cardioid()))
    behind = band_energy(pattern, np.array([[-1.0, 0.0, 0.0]]), DEFAULT_BANDS)
    np.testing.assert_allclose(behind, [[1.0, 1.0, 0.0, 0.0]], atol=1e-12)


def test_harmonics_of_any_order() -> None:
    d = _directions(30)
    np.testing.assert_allclose(real_harmonics(d, 2), spherical_harmonics(d), atol=1e-12)
    # the addition theorem: sum_m Y_nm^2 = 1 in every order (SN3D)
    y = real_harmonics(d, 6)
    for n in range(7):
        np.testing.assert_allclose((y[:, n * n : (n + 1) ** 2] ** 2).sum(axis=1), 1.0, atol=1e-12)


def test_a_measured_directivity(tmp_path: Path) -> None:
    """A cardioid written by sofar, spherical coordinates, seen along +Y: exact at what was measured, close
    between; frequencies go to their bands."""
    sofar = pytest.importorskip("sofar")
    azimuth, elevation = (
        x.ravel() for x in np.meshgrid(np.arange(0.0, 360.0, 10.0), np.arange(-90.0, 91.0, 10.0))
    )
    sofa = sofar.Sofa("FreeFieldDirectivityTF")
    sofa.ReceiverPosition = np.stack([azimuth, elevation, np.ones_like(azimuth)], axis=1)
    sofa.ReceiverPosition_Type, sofa.ReceiverPosition_Units = "spherical", "degree, degree, metre"
    sofa.SourceView, sofa.SourceUp = [[0, 1, 0]], [[0, 0, 1]]
    for name in ("EmitterDescriptions", "Description"):
        sofa.delete(name)  # optional, and strings do not survive some netCDF4 versions
    sofa.N = [100.0, 5000.0]
    cosine = np.cos(np.deg2rad(elevation)) * np.sin(np.deg2rad(azimuth))
    pressure = np.stack([np.ones_like(cosine), 0.5 + 0.5 * cosine], axis=1)[None]
    phase = np.exp(1j * np.linspace(0.0, 3.0, pressure.size)).reshape(pressure.shape)
    sofa.Data_Real, sofa.Data_Imag = (pressure * phase).real, (pressure * phase).imag
    path = tmp_path / "cardioid.sofa"
    sofar.write_sofa(str(path), sofa)
    pattern = ss.MeasuredDirectivity(path)
    frequency, at = pattern.energy(AROUND)
    np.testing.assert_array_equal(frequency, [100.0, 5000.0])
    wanted = ((1.0 + np.cos(ANGLES)) / 2.0) ** 2
    on_grid = [0, 1, 2, 3, 5]
    np.testing.assert_allclose(at[on_grid, 1], wanted[on_grid], atol=1e-9)
    np.testing.assert_allclose(at[:, 0], 1.0, atol=1e-9)
    between = _directions(200)
    error = pattern.energy(between)[1][:, 1] - ((1.0 + between[:, 0]) / 2.0) ** 2
    assert np.abs(error).max() < 0.01  # second difference over 10°: (pi / 18)^2 / 8 at most, twice over
    with pytest.raises(ss.ConfigError, match="from 0 to 0"):
        ss.MeasuredDirectivity(path, 3)
    with pytest.raises(DirectivityError, match="nowhere"):
        ss.MeasuredDirectivity("nowhere.sofa")


def test_by_name() -> None:
    assert isinstance(as_directivity("talker", "source"), ss.Talker)
    assert as_directivity(None, "source") is None
    with pytest.raises(ss.ConfigError, match="omni, cardioid"):
        as_directivity("trumpet", "source")
    with pytest.raises(ss.ConfigError, match="needs arguments"):
        as_directivity("measured", "source")
    with pytest.raises(ss.ConfigError, match="expected a Directivity or its name"):
        as_directivity(3, "source")  # type: ignore[arg-type]
    assert as_directivity("omni", "source") == ss.Omni()
    assert as_directivity("cardioid", "source") == ss.Cardioid()
    assert set(DIRECTIVITIES) >= {"by-frequency", "harmonics", "measured", "talker"}


def test_bad_ends_and_patterns() -> None:
    with pytest.raises(ss.PointError, match="three finite coordinates"):
        ss.Source((0.0, np.nan, 1.0))
    with pytest.raises(ss.ConfigError, match="finite angles"):
        ss.Talker(heading_deg=np.inf)
    with pytest.raises(ss.ConfigError, match="Directivity"):
        ss.Listener((0, 0, 0), "talker")  # type: ignore[arg-type]
    with pytest.raises(ss.ConfigError, match="power or pattern"):
        ss.Omni(level="loud")  # type: ignore[arg-type]
    with pytest.raises(ss.ConfigError, match="figure of eight"):
        ss.Cardioid(1.5)
    with pytest.raises(ss.ConfigError, match="order from 1 to 8"):
        ss.Cardioid(order=0)
    with pytest.raises(ss.ConfigError, match="as many patterns"):
        ss.FrequencyDependent((100.0,), ())
    with pytest.raises(ss.ConfigError, match="frequencies of their own"):
        ss.FrequencyDependent((100.0,), (ss.Talker(),))
    with pytest.raises(ss.ConfigError, match=r"\(N \+ 1\)\^2"):
        ss.SphericalHarmonics((1.0, 0.0))


def test_a_mouth_ahead_of_the_head() -> None:
    """An offset of the directivity is that of the source: in a mirror room all arrivals are those of the place it
    speaks from, whether the point is simulated there or moved there."""
    speed = 343.0
    place, mouth, ear = np.array([1.0, 1.2, 1.5]), np.array([0.0, 0.1, 0.0]), np.array([3.0, 2.0, 1.4])

    def room(s: np.ndarray, l: np.ndarray) -> ss.Echogram:
        """Direct sound and the floor's mirror image."""
        images = np.array([s, s * [1.0, 1.0, -1.0]]) - l
        r = np.linalg.norm(images, axis=1)
        energy = np.repeat(1.0 / (4.0 * np.pi * r[:, None] ** 2), 4, axis=1)
        direct = Arrival(r[0] / speed, energy[0], images[0] / r[0])
        early = Arrivals(r[1:] / speed, energy[1:], images[1:] / r[1:, None], np.array([[0, -1]]))
        return _echogram(np.eye(3), early, direct)

    at_mouth = directed_of(room(place + mouth, ear), room(ear, place + mouth), (0.0, 0.0, 0.0), speed)
    shifted = directed_of(room(place, ear), room(ear, place), (0.1, 0.0, 0.0), speed)
    assert at_mouth.direct is not None and shifted.direct is not None
    assert shifted.direct.delay == pytest.approx(at_mouth.direct.delay, rel=1e-12)
    np.testing.assert_allclose(shifted.direct.energy, at_mouth.direct.energy, rtol=1e-9)
    np.testing.assert_allclose(shifted.direct.direction, at_mouth.direct.direction, atol=1e-9)
    np.testing.assert_allclose(shifted.early.delay, at_mouth.early.delay, rtol=1e-9)
    np.testing.assert_allclose(shifted.early.energy, at_mouth.early.energy, rtol=1e-9)
    end = ss.Source(tuple(place), ss.Talker(offset=(0.1, 0.0, 0.0)), heading_deg=90.0)
    np.testing.assert_allclose(end.centre, place + mouth, atol=1e-12)
    with pytest.raises(ss.ConfigError, match=r"at most 0\.5 m"):
        ss.Talker(offset=(0.0, 0.0, 2.0))


def directed_of(
    echogram: ss.Echogram, reverse: ss.Echogram, offset: tuple[float, float, float], speed: float
) -> ss.Echogram:
    """For a talker who faces +Y."""
    return ss.directed(echogram, reverse, ss.Talker(heading_deg=90.0, offset=offset), None, speed)
