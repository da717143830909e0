"""Waves in rooms against exact solutions: levels, frequencies and decays of modes, layers, branches, free field."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import soundspaces_waves as sw
from scipy.spatial.transform import Rotation
from soundspaces_parameters.of_waves import low_measures, octaves_below
from soundspaces_waves.branches import fit_branch, random_incidence

import soundspaces_sim as ss
from soundspaces_sim.echogram.filters import band_windows
from soundspaces_sim.echogram.low_response import band_gain
from tests.marks import ci_slow
from tests.rooms import box, table
from tests.transport.exact_box import pressure

SIZE = (4.1, 3.3, 2.55)
THIRDS = (31.5, 40.0, 50.0, 63.0, 80.0, 100.0, 125.0, 160.0)
DRY = ss.SimulationConfig(air_absorption=False)


@cache
def _heard(absorption: float, askew: bool) -> tuple[sw.LowResponses, np.ndarray, np.ndarray]:
    """Responses at twelve seats; the source and the seats in the room's own axes. `askew`: it is turned about two."""
    room = ss.shoebox(SIZE, absorption=absorption)
    turn = Rotation.from_euler("xyz", (0.4, 0.25, 0.65)).as_matrix() if askew else np.eye(3)
    stands = ss.Scene(room.vertices @ turn.T, room.faces, room.face_material, room.materials)
    seats = np.random.default_rng(3).uniform(0.08, 0.92, (12, 3)) * SIZE
    source = np.array([0.27, 0.31, 0.42]) * SIZE
    return sw.simulate_low(stands, turn @ source, seats @ turn.T, 2.4, DRY), source, seats


@cache
def _seats(
    absorption: float, askew: bool = False, every_bin: int = 2
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(k,) Hz, (12, k) transfer functions by the lattice, and exact ones."""
    low, source, seats = _heard(absorption, askew)
    every = [low.transfer(0, l) for l in range(len(seats))]
    kept = slice(12, None, every_bin)
    frequency = every[0][0][kept]
    beta = 1.0 / fit_branch(np.array([125.0]), np.array([absorption])).resistance
    exact = np.array([pressure(SIZE, beta, frequency, source, seat) for seat in seats])
    return frequency, np.array([h[0, kept] for _, h in every]), exact


def test_levels_of_an_absorbing_box_are_exact_per_third() -> None:
    """Twelve seats; the aim is .5 dB rms."""
    assert max(_level_errors(*_seats(0.15))) < 0.25


def _level_errors(frequency: np.ndarray, found: np.ndarray, exact: np.ndarray) -> list[float]:
    """dB rms over seats, of thirds."""
    errors = []
    for middle in THIRDS:
        band = (frequency >= middle * 2 ** (-1 / 6)) & (frequency < min(middle * 2 ** (1 / 6), 176.0))
        energy = [(np.abs(h[:, band]) ** 2).sum(axis=1) for h in (found, exact)]
        errors.append(float(np.sqrt(np.mean((10.0 * np.log10(energy[0] / energy[1])) ** 2))))
    return errors


def test_phases_of_an_absorbing_box_are_exact() -> None:
    frequency, found, exact = _seats(0.15)
    for last, most in ((80.0, 0.02), (176.0, 0.05)):
        band = frequency < last
        assert np.linalg.norm((found - exact)[:, band]) < most * np.linalg.norm(exact[:, band])


@ci_slow
def test_measures_of_an_absorbing_box_are_those_of_the_exact_response() -> None:
    """Octaves of 63 and 125 Hz at twelve seats: the exact spectrum as a sum of sines, filtered, squared, summed backwards
    and fitted in the plainest way. Within 2 %, .2 dB and .015 rms."""
    (low, source, seats), (frequency, _, exact) = _heard(0.15, False), _seats(0.15, every_bin=1)
    edges, rate = octaves_below(low.edge), 4000.0
    before = 600  # samples in which filters ring
    t = (np.arange(4600) - before) / rate
    gain = np.sqrt(band_windows((0.0, *edges), frequency, rate))[1:] * band_gain(frequency, low.edge)
    waves = np.exp(2j * np.pi * np.outer(frequency, t))
    off = []
    for l, seat in enumerate(seats):
        onset = float(np.linalg.norm(seat - source)) / 343.0
        found = low_measures(low[0, l], edges, onset)
        first = before + round(onset * rate)
        for band in range(2):
            energy = ((exact[l] * gain[band]) @ waves).real ** 2
            energy = np.append(energy[: first + 1].sum(), energy[first + 1 :])
            level = 10.0 * np.log10(energy[::-1].cumsum()[::-1] / energy.sum())
            use = (level <= -5.0) & (level >= -25.0)
            t20 = -60.0 / np.polyfit(t[: len(level)][use], level[use], 1)[0]
            early = energy[: round(0.08 * rate)].sum()
            c80 = 10.0 * np.log10(early / (energy.sum() - early))
            d50 = energy[: round(0.05 * rate)].sum() / energy.sum()
            off.append((found.t20[band] / t20 - 1.0, found.c80[band] - c80, found.d50[band] - d50))
    assert np.all(np.sqrt(np.mean(np.square(off), axis=0)) < (0.02, 0.2, 0.015))


def _poles(frequency: np.ndarray, transfer: np.ndarray, count: int) -> np.ndarray:
    """Complex frequencies, Hz, of `count` modes: one denominator for all (n, m) transfer functions (Levy 1959)."""
    x = frequency - frequency.mean()
    seats = len(transfer)
    powers = np.vander(x, count + 2)
    left = np.concatenate([np.stack([-h * x**i for i in range(count)], 1) for h in transfer])
    right = np.kron(np.eye(seats), powers)
    unknown = np.linalg.lstsq(
        np.hstack([left, right]), np.concatenate([h * x**count for h in transfer]), rcond=None
    )[0]
    return np.asarray(np.sort_complex(np.roots([1.0, *unknown[:count][::-1]])) + frequency.mean())


@pytest.mark.parametrize(("low", "high", "count"), [(36.0, 47.0, 1), (47.0, 58.0, 1), (62.0, 73.0, 2)])
def test_modes_of_an_absorbing_box(low: float, high: float, count: int) -> None:
    """Frequencies within .25 %, decays within 2 %; both read in the same way off the exact solution."""
    frequency, found, exact = _seats(0.15)
    band = (frequency > low) & (frequency < high)
    a, b = (_poles(frequency[band], h[:, band], count) for h in (found, exact))
    assert np.all(b.imag > 0.1)
    np.testing.assert_allclose(a.real, b.real, rtol=2.5e-3)
    np.testing.assert_allclose(a.imag, b.imag, rtol=0.02)


@ci_slow
@pytest.mark.parametrize(("low", "high"), [(36.0, 47.0), (47.0, 58.0)])
def test_decays_of_an_absorbing_box_that_stands_askew(low: float, high: float) -> None:
    """All walls are stairs: their area decides. Within 2 %, frequencies as those of rigid walls."""
    frequency, found, exact = _seats(0.15, askew=True)
    band = (frequency > low) & (frequency < high)
    a, b = (_poles(frequency[band], h[:, band], 1) for h in (found, exact))
    np.testing.assert_allclose(a.real, b.real, rtol=0.015)
    np.testing.assert_allclose(a.imag, b.imag, rtol=0.02)


@ci_slow
def test_levels_and_modes_of_boxes_that_absorb_more_or_less() -> None:
    """.03 and .4 of random incidence: levels per third within .5 dB rms over twelve seats, the first mode's decay within
    2 %."""
    for absorption in (0.03, 0.4):
        frequency, found, exact = _seats(absorption, every_bin=1)  # narrow modes
        assert max(_level_errors(frequency, found, exact)) < 0.5, absorption
        band = (frequency > 36.0) & (frequency < 47.0)
        a, b = (_poles(frequency[band], h[:, band], 1) for h in (found, exact))
        np.testing.assert_allclose(a.real, b.real, rtol=2.5e-3)
        np.testing.assert_allclose(a.imag, b.imag, rtol=0.02)


def _tube(absorption: float) -> ss.Scene:
    """Rigid, 4.3 m, with a wall at one end that absorbs."""
    values = np.array([[0.0], [absorption]])
    materials = ss.MaterialTable(
        ("rigid", "end"), np.array([125.0]), values, np.zeros((2, 1)), np.zeros((2, 1))
    )
    return box((0.5, 0.45, 4.3), materials, [0, 0, 0, 0, 0, 1])


def _at(tube: ss.Scene, **settings: float) -> tuple[np.ndarray, np.ndarray]:
    low = sw.simulate_low(tube, [0.2, 0.2, 0.9], [0.3, 0.25, 3.1], 2.0, DRY, **settings)
    frequency, h = low.transfer(0, 0)
    kept = frequency > 20.0
    return frequency[kept], h[0, kept]


@pytest.mark.parametrize("reactance", [-1.0, 0.7])
def test_a_branch_with_mass_or_stiffness_ends_a_tube(reactance: float) -> None:
    """A wall of complex impedance at one end, against the closed form; the other phase is another response."""
    frequency, found = _at(_tube(0.5), reactance=reactance)
    middle, given = np.minimum(np.array([125.0]), 176.0 / np.sqrt(2.0)), np.array([0.5])
    branch = fit_branch(middle, given, reactance)
    assert abs(random_incidence(branch.impedance(middle))[0] - 0.5) < 1e-6
    ends = (0.0, 1.0 / branch.impedance(frequency))
    args = (0.5, 0.45, 4.3), 0.0, frequency, np.array([0.2, 0.2, 0.9]), np.array([0.3, 0.25, 3.1])
    exact = pressure(*args, ends=ends)
    assert np.linalg.norm(found - exact) < 0.06 * np.linalg.norm(exact)
    real = 1.0 / fit_branch(middle, given).resistance
    other = pressure(*args, ends=(0.0, real))
    assert np.linalg.norm(found - other) > 0.2 * np.linalg.norm(exact)


def test_a_wall_that_absorbs_all_ends_a_tube() -> None:
    """The most a locally reacting wall absorbs at random incidence is .951; the misfit is stated."""
    frequency, found = _at(_tube(0.999))
    branch = fit_branch(np.array([125.0]), np.array([0.999]))
    assert branch.resistance == pytest.approx(1.567, abs=1e-3)
    assert branch.misfit == pytest.approx(0.999 - 0.951, abs=1e-3)
    source, listener = np.array([0.2, 0.2, 0.9]), np.array([0.3, 0.25, 3.1])
    exact = pressure((0.5, 0.45, 4.3), 0.0, frequency, source, listener, ends=(0.0, 1.0 / 1.567))
    assert np.linalg.norm(found - exact) < 0.03 * np.linalg.norm(exact)


def test_a_layer_that_hangs_free_across_a_tube() -> None:
    """What one half hears of a source less what the other does is what half the tube hears whose end has the
    admittance 2 / r of the layer."""
    absorption = 0.3  # of a pass
    materials = ss.MaterialTable(
        ("rigid", "cloth (free-hanging)"), np.array([125.0]), np.array([[0.0], [absorption]]), np.zeros((2, 1)),
        np.array([[0.0], [1.0 - absorption]]),
    )  # fmt: skip
    half = 2.4
    tube = box((0.5, 0.45, 2 * half), materials)
    sheet = np.array([[0, 0, half], [0.5, 0, half], [0.5, 0.45, half], [0, 0.45, half]])
    scene = ss.Scene(
        np.concatenate([tube.vertices, sheet]),
        np.concatenate([tube.faces, len(tube.vertices) + np.array([[0, 1, 2], [0, 2, 3]])]),
        np.append(tube.face_material, [1, 1]),
        materials,
    )
    source, near = np.array([0.2, 0.2, 0.8]), np.array([0.3, 0.2, 1.7])
    low = sw.simulate_low(scene, source, np.array([near, [0.3, 0.2, 2 * half - 1.7]]), 2.0, DRY)
    frequency = low.transfer(0, 0)[0]
    kept = frequency > 20.0
    found = low.transfer(0, 0)[1][0, kept] - low.transfer(0, 1)[1][0, kept]
    ends = (0.0, 2.0 / (2.0 * _zeta(absorption)))
    exact = pressure((0.5, 0.45, half), 0.0, frequency[kept], source, near, ends=ends)
    assert np.linalg.norm(found - exact) < 0.04 * np.linalg.norm(exact)


def _zeta(absorption: float) -> float:
    """Of the mean of 2 zeta c / (1 + zeta c)² at random incidence (T13), by brute force."""
    zeta, c = np.linspace(1e-3, 1.56, 1000), (np.arange(2000) + 0.5) / 2000
    means = [(2 * z * c / (1 + z * c) ** 2 * 2 * c).mean() for z in zeta]
    return float(np.interp(absorption, means, zeta))


def _open_air(half: float) -> ss.Scene:
    """Nothing but two small triangles, at the corners of a cube."""
    corner = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0.0]])
    far = 2 * half - corner
    return ss.Scene(
        np.concatenate([corner, far]) - half,
        np.array([[0, 1, 2], [3, 4, 5]]),
        np.zeros(2, int),
        table(0.5, 0.0),
    )


def test_free_field_level_and_direction() -> None:
    """p = exp(-i k r) / (sqrt(4 pi) r), and -rho c u = p (1 + 1 / (i k r)) towards the source; the cube's sides are
    open, and what they send back of an oblique wave is small."""
    source, listener = np.array([0.3, -0.2, 0.1]), np.array([1.7, 1.1, -0.6])
    low = sw.simulate_low(_open_air(4.5), source, listener, 0.12, DRY)
    frequency, found = low.transfer(0, 0)
    band = (frequency > 60.0) & (frequency < 170.0)
    r = np.linalg.norm(source - listener)
    k = 2.0 * np.pi * frequency[band] / 343.0
    exact = np.exp(-1j * k * r) / (np.sqrt(4.0 * np.pi) * r)
    level = 10.0 * np.log10((np.abs(found[0, band]) ** 2).sum() / (np.abs(exact) ** 2).sum())
    assert abs(level) < 0.3
    towards = (source - listener) / r
    velocity = exact * (1.0 + 1.0 / (1j * k * r)) * towards[:, None]
    assert np.linalg.norm(found[1:, band] - velocity) < 0.12 * np.linalg.norm(velocity)


def test_pairs_are_reciprocal_and_sources_do_not_know_of_one_another() -> None:
    """Any lanes, any threads: the same bits."""
    room = ss.shoebox((3.2, 2.7, 2.4), absorption=0.3, transmission=0.05)
    points = np.random.default_rng(1).uniform(0.1, 0.9, (9, 3)) * (3.2, 2.7, 2.4)
    low = sw.simulate_low(room, points, points, 0.2)
    alone = sw.simulate_low(room, points[4], points[:5], 0.2)
    np.testing.assert_array_equal(low.pressure[4, :5], alone.pressure[0])
    np.testing.assert_array_equal(low.velocity[4, :5], alone.velocity[0])
    error = np.abs(low.pressure - low.pressure.transpose(1, 0, 2)).max()
    assert error < 1e-5 * np.abs(low.pressure).max()
