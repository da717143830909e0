"""Reflections where their mirror ends, and reflections round edges, against exact wedges and the wave
equation."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.special import fresnel

import soundspaces_sim as ss
from tests.marks import ci_slow
from tests.rooms import edges_alone, table
from tests.transport.exact_wedge import SPEED, band_energies, band_wave_numbers, diffracted
from tests.transport.test_diffraction import CONFIG, THIRDS
from tests.transport.wave_twin import STEP, relative_levels

RIGID = table(0.0, 0.0)


def quads(*corners: np.ndarray, pieces: int = 1, materials: ss.MaterialTable = RIGID) -> ss.Scene:
    """Flat quadrilaterals (4, 3), each of `pieces` by `pieces` parts."""
    vertices: list[np.ndarray] = []
    faces: list[list[int]] = []
    u = np.linspace(0.0, 1.0, pieces + 1)
    for c in corners:
        a = c[0] + u[:, None, None] * (c[1] - c[0])  # the sides from 0 to 1 and from 3 to 2
        b = c[3] + u[:, None, None] * (c[2] - c[3])
        start = len(vertices) * (pieces + 1) ** 2
        vertices.append((a + u[None, :, None] * (b - a)).reshape(-1, 3))
        for i in range(pieces):
            for j in range(pieces):
                k = start + i * (pieces + 1) + j
                faces += [[k, k + 1, k + pieces + 2], [k, k + pieces + 2, k + pieces + 1]]
    return ss.Scene(
        np.concatenate(vertices), np.array(faces), np.zeros(len(faces), int), materials, name="quads"
    )


def floor(x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    """(4, 3) corners at z = 0."""
    return np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])


def wall(z0: float, z1: float, half: float = 40.0) -> np.ndarray:
    """(4, 3) corners at x = 0."""
    return np.array([[0.0, -half, z0], [0.0, half, z0], [0.0, half, z1], [0.0, -half, z1]])


def pressure(arrivals: list[ss.Arrival], k: np.ndarray) -> np.ndarray:
    """(4, m) complex amplitudes of arrivals at wave numbers (4, m), free field e^(-jkr)/r."""
    out = np.zeros(k.shape, complex)
    for a in arrivals:
        out += np.sqrt(4.0 * np.pi * a.energy)[:, None] * np.exp(-1j * k * SPEED * a.delay)
    return out


def kirchhoff(strips: list[tuple[float, float]], across: float, up: float, k: np.ndarray) -> np.ndarray:
    """(4,) energy that strips along y at z = 0, between these places along x, reflect over that of an endless plane,
    between the ends (-across, 0, up) and (across, 0, up): Kirchhoff's |sum of F(u) - F(v)|² / 2 with
    u = x cos θ √(2 (d + d') / (λ d d')), the mean over wave numbers (4, m)."""
    leg, total = np.hypot(across, up), np.zeros(k.shape, complex)
    for strip in strips:
        for place, sign in zip(strip, (-1.0, 1.0), strict=True):
            s, c = fresnel(place * up / leg * np.sqrt(2.0 * k / (np.pi * leg)))
            total += sign * (c - 1j * s)
    return 0.5 * band_energies(total)


@ci_slow
def test_a_reflection_slides_off_the_end_of_its_mirror() -> None:
    """A half-plane, the reflection's boundary at 120 degrees: the whole field, arrivals added as pressures, within
    0.5 dB of the exact one for 15 degrees either way, and above 176 Hz for 30."""
    angles = np.deg2rad(np.array([a for a in range(90, 151) if a != 120], float))
    ts = np.pi / 3.0
    source = 2.0 * np.array([-np.cos(ts), 0.0, np.sin(ts)])
    places = 2.0 * np.stack([-np.cos(angles), 0.0 * angles, np.sin(angles)], axis=1)
    echoes = ss.simulate(quads(floor(-40.0, 0.0, -40.0, 40.0)), [source], places, CONFIG)
    k = band_wave_numbers(81)
    for i, tr in enumerate(angles):
        direct = np.sqrt(8.0 - 8.0 * np.cos(tr - ts))
        exact = np.stack([diffracted(2.0, 2.0, ts, 2.0, tr, 0.0, row) for row in k])
        exact += np.exp(-1j * k * direct) / direct
        if ts + tr < np.pi:
            mirror = np.sqrt(8.0 - 8.0 * np.cos(ts + tr))
            exact += np.exp(-1j * k * mirror) / mirror
        off = 10.0 * np.log10(band_energies(pressure(echoes[0, i].arrivals, k)) / band_energies(exact))
        heard = slice(0 if abs(tr - np.deg2rad(120.0)) < np.deg2rad(15.1) else 1, None)
        assert np.abs(off[heard]).max() < 0.5, (np.rad2deg(tr), off)


def test_a_mirror_small_against_the_wave_reflects_little() -> None:
    """0.6 m square, 3 m away: a tenth and less in the lowest band, more the higher, half and more in the
    highest."""
    ends = np.array([[-1.0, 0.05, 3.0]]), np.array([[1.1, 0.0, 3.0]])
    e = ss.simulate(quads(floor(-0.3, 0.3, -0.3, 0.3)), *ends, CONFIG)[0, 0]
    (mirror,) = [a for a in e.early if a.planes]
    share = mirror.energy * 4.0 * np.pi * (mirror.delay * SPEED) ** 2
    assert share[0] < 0.1 and (np.diff(share[:3]) > 0.0).all() and share[3] > 0.5, share


@pytest.mark.parametrize("pieces", [1, 4])
def test_a_mirror_that_goes_on_has_no_rim(pieces: int) -> None:
    """A floor in two quads, and one of many pieces: the reflection is that of the floor in one, to the bit."""
    ends = np.array([[-1.0, 0.0, 1.5]]), np.array([[0.9, 0.3, 1.2]])
    whole = quads(floor(-20.0, 20.0, -20.0, 20.0))
    parts = quads(floor(-20.0, 0.0, -20.0, 20.0), floor(0.0, 20.0, -20.0, 20.0), pieces=pieces)
    one, many = (ss.simulate(s, *ends, CONFIG)[0, 0] for s in (whole, parts))
    assert [a.kind for a in one.early] == [a.kind for a in many.early] == ["mirrors"]
    np.testing.assert_allclose(many.early[0].energy, one.early[0].energy, rtol=1e-9)
    length = one.early[0].delay * SPEED
    np.testing.assert_allclose(one.early[0].energy, 1.0 / (4.0 * np.pi * length**2), rtol=1e-6)


FLIP = np.array([1.0, 1.0, -1.0])  # to the image in the floor


def _by_edge(height: float, away: float, a: np.ndarray, b: np.ndarray, k: np.ndarray) -> np.ndarray:
    """(4, m) exact, from a at x < 0 to b by the edge at a height of a screen that goes on upwards from there (`away`
    1) or downwards (-1)."""
    up_a, up_b = away * (a[2] - height), away * (b[2] - height)
    ts, tr = np.arctan2(-a[0], up_a), 2.0 * np.pi - np.arctan2(b[0], up_b)
    rs, rr = np.hypot(a[0], up_a), np.hypot(b[0], up_b)
    return np.stack([diffracted(2.0, rs, ts, rr, tr, b[1] - a[1], row) for row in k])


def test_a_reflection_bends_over_a_screen() -> None:
    """A floor, and a screen on it between the ends: arrivals, added as pressures, against the exact wedge with both
    ends and their images."""
    p, q = np.array([-2.0, 0.0, 0.7]), np.array([2.0, 0.5, 0.9])
    scene = quads(floor(-40.0, 40.0, -40.0, 40.0), wall(0.0, 1.5))
    e = ss.simulate(scene, [p], [q], CONFIG)[0, 0]
    k = band_wave_numbers(81)
    exact = np.sum([_by_edge(1.5, -1.0, a, b, k) for a in (p, p * FLIP) for b in (q, q * FLIP)], axis=0)
    off = 10.0 * np.log10(band_energies(pressure(e.arrivals, k)) / band_energies(exact))
    assert np.abs(off).max() < 0.5, off


@ci_slow
def test_a_reflection_slides_into_the_shadow_of_an_edge() -> None:
    """A screen hangs above a floor and hides the ends from each other; the reflection under it rises past its edge:
    arrivals, added as pressures, against the exact wedge with both ends and their images."""
    heights = np.arange(4.0, 7.01, 0.1)
    p = np.array([-2.0, 0.0, 2.2])
    places = np.stack([0.0 * heights + 2.0, 0.0 * heights, heights], axis=1)
    scene = quads(floor(-40.0, 40.0, -40.0, 40.0), wall(1.5, 60.0))
    echoes, k = ss.simulate(scene, [p], places, CONFIG), band_wave_numbers(81)
    found, sides = [], set()
    for i, q in enumerate(places):
        passing = 0.5 * (q[2] - 2.2) - 1.5
        if abs(passing) < 0.02:
            continue
        exact = np.sum(
            [_by_edge(1.5, 1.0, a, b, k) for a in (p, p * FLIP) for b in (q, q * FLIP)], axis=0
        )
        if passing < 0.0:
            length = np.hypot(4.0, q[2] + 2.2)
            exact = exact + np.exp(-1j * k * length) / length
        sides.add(passing < 0.0)
        sound = pressure(echoes[0, i].arrivals, k)
        found.append(10.0 * np.log10(band_energies(sound) / band_energies(exact)))
    assert np.abs(found).max() < 0.5, np.abs(found).max(axis=0)
    assert sides == {True, False}


SHAPE, AT, UNTIL = (150, 150, 150), 80, 0.0185
PLACES = [
    (55, 80, 70), (60, 60, 80), (50, 90, 65), (48, 70, 90), (65, 95, 80), (55, 55, 60), (60, 100, 70), (50, 75, 100)
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("cells", [(55, 95, 55, 95), (65, 85, 60, 80), (50, 100, 70, 80)])
def test_finite_panels_against_the_wave_equation(cells: tuple[int, int, int, int]) -> None:
    """2.8 m and 1.4 m square, 3.5 by 0.7 m: direct and reflected sound, added as pressures, are within 1.5 dB
    of a rigid finite-difference solution in every third of an octave from 125 to 500 Hz, in the mean over
    listeners; and nearer in the mean square than a panel that reflects all or nothing."""
    a, b, c, d = cells
    h, source = STEP, (52, 75, 65)
    open_ = np.ones(SHAPE[1:], bool)
    open_[a:b, c:d] = False
    edges = np.append(THIRDS, THIRDS[-1] * 10.0**0.1) * 10.0**-0.05
    frequency = np.array([np.geomspace(f, g, 19)[1::2] for f, g in pairwise(edges)])
    waves = relative_levels(SHAPE, AT, open_, source, np.array(PLACES), UNTIL, frequency)
    x, (y0, y1, z0, z1) = (AT - 0.5) * h, (np.array(cells) - 0.5) * h
    panel = quads(np.array([[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]]))
    p, q = np.array(source) * h, np.array(PLACES) * h
    level = {}
    for name in ("ours", "all or nothing"):
        config = edges_alone(diffraction=name == "ours", bands=tuple(edges))
        echoes = ss.simulate(panel, [p], q, config)
        k = 2.0 * np.pi * frequency / SPEED
        free = ((q - p) ** 2).sum(axis=1)
        level[name] = np.array(
            [
                10.0 * np.log10((np.abs(pressure(echoes[0, i].arrivals, k)) ** 2).mean(axis=1) * free[i])
                for i in range(len(q))
            ]
        )
    off = level["ours"] - waves
    assert np.abs(off.mean(axis=0)).max() < 1.5, np.round(off, 1)
    assert (off**2).mean() < ((level["all or nothing"] - waves) ** 2).mean()
