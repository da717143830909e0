"""Scenes whose echograms are known in closed form."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.axes import spherical_harmonics
from soundspaces_sim.echogram.measures import room_measures
from soundspaces_sim.transport.paths import detector
from tests.marks import CI_SLOW, ci_slow, few
from tests.rooms import box, plain, plane, sphere, table
from tests.stats import assert_mean, repeat


def test_free_field_level_delay_and_direction() -> None:
    """Direct sound: fluence 1/(4 pi r^2) at r/c, from the direction of the source."""
    scene = plane(0.1, table(0.5, 0.5))  # too small and too far to matter
    source, listener = np.array([1.0, -2.0, 3.0]), np.array([4.0, 1.5, 2.0])
    e = ss.simulate(scene, [source], [listener], plain(walks=8, connections={"subpaths": 0}))[0, 0]
    r = np.linalg.norm(source - listener)
    assert e.direct is not None
    np.testing.assert_allclose(e.direct.energy, 1.0 / (4.0 * np.pi * r**2), rtol=1e-12)
    assert e.direct.delay == pytest.approx(r / 343.0, rel=1e-12)
    np.testing.assert_allclose(e.direct.direction, (source - listener) / r, atol=1e-12)


def test_direct_sound_through_walls() -> None:
    """Each wall on the way multiplies the energy by its transmission, per band."""
    tau = np.array([[0.5, 0.25, 0.1, 0.0]])
    scene = plane(5.0, table([[0.1] * 4], [[0.5] * 4], tau))
    e = ss.simulate(
        scene, [[0.3, 0.2, 1.0]], [[0.1, 0.4, -1.0]], plain(walks=8, connections={"subpaths": 0})
    )[0, 0]
    assert e.direct is not None and not e.visible
    free = 1.0 / (4.0 * np.pi * (0.04 + 0.04 + 4.0))
    np.testing.assert_allclose(e.direct.energy, tau[0] * free, rtol=1e-9)


@pytest.mark.parametrize("distance", few([0.0, 1.0, 3.0], 1.0))
def test_lambert_plane_against_mirror(distance: float) -> None:
    """A Lambert plane returns 2 cos(theta) times the energy of a mirror (ends at one height).

    Derivation: integral of cos_1 cos_2 / (pi r_1^2 r_2^2) / (4 pi) over the plane; with equal heights it
    is 2 cos(theta) / (4 pi d^2), d the mirror path and theta its angle of incidence. Co-located: 2.
    """
    h = 1.0
    scene = plane(200.0, table(0.0, 1.0))
    mirror = distance**2 + 4.0 * h**2
    cos = 2.0 * h / np.sqrt(mirror)
    expected = 2.0 * cos / (4.0 * np.pi * mirror)

    config = plain(walks=4000, specular={"ratio": 1}, connections={"subpaths": 512, "window": 1.0})

    def run(seed: int) -> np.ndarray:
        e = ss.simulate(scene, [[0.0, 0.0, h]], [[distance, 0.0, h]], config, seed)[0, 0]
        return np.asarray(e.energy[:, 0].sum(axis=0)[:1])

    assert_mean(repeat(run, 32), expected, f"plane at distance {distance}")


@ci_slow
def test_lambert_plane_directions() -> None:
    """What a Lambert plane sends back comes from where it is lit: moments of the arrival direction, order 2.

    Expected: the integral of cos_1 cos_2 / (r_1^2 r_2^2) Y(direction of the place) over the plane, over the same
    without Y. With source and listener in one place above it: mean cos 4/5, of its square 2/3.
    """
    h, d = 1.0, 1.5
    radius, phi = np.meshgrid(
        np.geomspace(1e-3, 200.0, 3001), (np.arange(360) + 0.5) * np.pi / 180.0, indexing="ij"
    )
    x, y = radius * np.cos(phi) + d / 2, radius * np.sin(phi)
    place = np.stack([x - d, y, np.full_like(x, -h)], axis=-1)  # seen from the listener
    r1, r2 = np.sqrt(x**2 + y**2 + h**2), np.linalg.norm(place, axis=-1)
    weight = (h / r1) * (h / r2) / (r1**2 * r2**2) * radius**2  # dA = r dr dphi = r^2 dlog r dphi
    moments = np.einsum("ij,ijc->c", weight, spherical_harmonics(place / r2[..., None])) / weight.sum()
    scene, config = (
        plane(200.0, table(0.0, 1.0)),
        plain(walks=4000, specular={"ratio": 1}, connections={"subpaths": 64}, radiance_transfer=False),
    )

    def run(distance: float, seed: int) -> np.ndarray:
        e = (
            ss.simulate(scene, [[0.0, 0.0, h]], [[distance, 0.0, h]], config, seed)[0, 0]
            .energy[:, :, 0]
            .sum(axis=0)
        )
        return np.asarray(e[1:] / e[0])

    above = [0.0, -0.8, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0]
    assert_mean(repeat(lambda s: run(0.0, s), 16), above, "in one place", relative=0.03, scale=1.0)
    assert_mean(repeat(lambda s: run(d, s), 16), moments[1:], "1.5 m apart", relative=0.03, scale=1.0)


def _sphere_profile(radius: float, absorption: float, listener: float, edges: np.ndarray) -> np.ndarray:
    """Reverberant fluence per time bin, source at the centre, listener at a distance from it.

    A Lambert sphere's successive chords are independent with density l / (2 R^2); the wall is lit
    uniformly, so the last leg is the distance from the listener to the wall in a uniform direction.
    """
    step = 0.002
    l = np.arange(0.0, edges[-1] * 343.0, step)
    share = np.clip((2.0 * radius - l) / step + 0.5, 0.0, 1.0)  # of a step that chords reach
    chord = share * l / (2.0 * radius**2) * step
    mu = np.linspace(-1.0, 1.0, 20001)
    last = -listener * mu + np.sqrt(radius**2 - listener**2 * (1.0 - mu**2))
    density = np.histogram(radius + last, np.append(l, l[-1] + step) - 0.5 * step)[0] / len(mu)
    n = len(l)
    total, k = np.zeros(n), 1
    spectrum = np.fft.rfft(chord, 2 * n)
    while (1.0 - absorption) ** k > 1e-8 and k < 400:
        total += (1.0 - absorption) ** k * density
        density = np.fft.irfft(np.fft.rfft(density, 2 * n) * spectrum, 2 * n)[:n]
        k += 1
    return np.histogram(l / 343.0, edges, weights=total)[0] / (np.pi * radius**2)


@ci_slow
@pytest.mark.parametrize(
    ("offset", "absorption"),
    [
        (0.8, 0.7),
        *(pytest.param(*case, marks=CI_SLOW) for case in ((0.0, 0.3), (0.0, 0.7), (0.8, 0.3))),
        *(pytest.param(o, a, marks=pytest.mark.slow) for a in (0.1, 0.5, 0.9) for o in (0.0, 0.8)),
    ],
)  # fmt: skip
def test_lambert_sphere_total(offset: float, absorption: float) -> None:
    """Reverberant fluence (1 - a)/a / (pi R^2), anywhere, for a source at the centre."""
    radius = 2.0
    scene = sphere(radius, table(absorption, 1.0), 4)
    expected = (1.0 - absorption) / absorption / (np.pi * radius**2)
    config = plain(
        walks=2000,
        specular={"ratio": 1},
        connections={"subpaths": 256},
        decay_range_db=100.0,
        max_bounces=1000,
    )

    def run(seed: int) -> np.ndarray:
        e = ss.simulate(scene, [[0.0, 0.0, 0.0]], [[offset, 0.0, 0.2]], config, seed)[0, 0]
        return np.asarray(e.energy[:, 0].sum(axis=0)[:1])

    assert_mean(repeat(run, 12), expected, f"sphere {absorption}")


@ci_slow
def test_reverberation_time_of_a_live_sphere() -> None:
    """Hundreds of reflections: chords l of a Lambert sphere are independent, with density l / (2 R^2) up to 2
    R, so energy falls as exp(-x t), where (1 - a) E[exp(x l / c)] = 1."""
    radius, absorption = 1.5, 0.03

    def excess(x: float) -> float:
        k = x / 343.0
        mean = quad(lambda l: np.exp(k * l) * l / (2.0 * radius**2), 0.0, 2.0 * radius)[0]
        return float((1.0 - absorption) * mean - 1.0)

    expected = 6.0 * np.log(10.0) / brentq(excess, 1e-3, 50.0)
    assert expected * 343.0 / (4.0 * radius / 3.0) > 400.0  # bounces on the way to -60 dB
    scene = sphere(radius, table(absorption, 1.0), 4)
    config = plain(walks=64, specular={"ratio": 1}, connections={"subpaths": 16})

    def run(seed: int) -> np.ndarray:
        e = ss.simulate(scene, [[0.0, 0.0, 0.0]], [[0.7, 0.0, 0.2]], config, seed)[0, 0]
        return np.asarray(room_measures(e).t30[:1])

    # the sphere of triangles is a little smaller than a sphere: 4 V / S of the mesh against 4 R / 3
    corners = scene.corners
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    free_path = 4.0 * abs(volume) / scene.areas.sum()
    assert_mean(repeat(run, 6), expected * free_path / (4.0 * radius / 3.0), "T30", relative=0.01)


@ci_slow
def test_lambert_sphere_time_profile() -> None:
    """Energy per 10 ms against the chord-length distribution, listener off the centre."""
    scene = sphere(2.0, table(0.3, 1.0), 4)
    edges = np.arange(0.0, 0.1001, 0.01)
    expected = _sphere_profile(2.0, 0.3, 0.8, edges)
    whole = _sphere_profile(2.0, 0.3, 0.8, np.array([0.0, 0.3]))
    assert whole.sum() == pytest.approx(0.7 / 0.3 / (np.pi * 4.0), rel=1e-3)
    config = plain(walks=3000, specular={"ratio": 1}, connections={"subpaths": 256}, duration=0.11)

    def run(seed: int) -> np.ndarray:
        e = ss.simulate(scene, [[0.0, 0.0, 0.0]], [[0.8, 0.0, 0.0]], config, seed)[0, 0]
        assert e.direct is not None
        h = e.histogram(0.01)[0, :10]
        h[0] -= e.direct.energy[0]
        return h

    samples = repeat(run, 16)
    lit = expected > 1e-3 * expected.max()
    assert_mean(samples[:, lit], expected[lit], "sphere profile", relative=0.05)


@pytest.mark.parametrize(
    ("absorption", "scattering"),
    few([(0.1, 1.0), (0.2, 1.0), (0.2, 0.3), (0.4, 1.0)], (0.2, 0.3)),
)
def test_reverberation_time_of_a_diffuse_room(absorption: float, scattering: float) -> None:
    """Kuttruff's correction of Eyring's formula for the spread of path lengths (variance .4 in shoeboxes).

    T = 24 ln 10 V / (c S a'), a' = -ln(1 - a) (1 + 0.4 / 2 ln(1 - a)); Room Acoustics, ch. 5.
    """
    volume, area = 6.0 * 5.0 * 2.7, 2.0 * (30.0 + 16.2 + 13.5)
    exponent = -np.log(1.0 - absorption)
    expected = 24.0 * np.log(10.0) * volume / (343.0 * area * exponent * (1.0 - 0.2 * exponent))
    scene = box((6.0, 5.0, 2.7), table(absorption, scattering))
    e = ss.simulate(scene, [1.5, 2.0, 1.2], [4.3, 3.1, 1.6], plain(walks=2000))[0, 0]
    np.testing.assert_allclose(room_measures(e).t30, expected, rtol=0.04)


def _image_sources(
    size: Sequence[float],
    source: Sequence[float],
    listener: Sequence[float],
    absorption: float,
    end: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Delays, energies, orders and directions of all images of a shoebox (Allen & Berkley 1979)."""
    axes = []
    for length, s, r in zip(size, source, listener, strict=True):
        n = np.arange(-int(343.0 * end / (2 * length)) - 2, int(343.0 * end / (2 * length)) + 3)
        even = np.stack([s + 2 * n * length - r, np.abs(2 * n)])
        odd = np.stack([-s + 2 * n * length - r, np.abs(2 * n - 1)])
        axes.append(np.concatenate([even, odd], axis=1))
    dx, dy, dz = np.meshgrid(*(a[0] for a in axes), indexing="ij")
    ox, oy, oz = np.meshgrid(*(a[1] for a in axes), indexing="ij")
    r2, order = (dx**2 + dy**2 + dz**2).ravel(), (ox + oy + oz).ravel()
    direction = np.stack([dx.ravel(), dy.ravel(), dz.ravel()], axis=1) / np.sqrt(r2)[:, None]
    return np.sqrt(r2) / 343.0, (1.0 - absorption) ** order / (4.0 * np.pi * r2), order, direction


Place = tuple[float, float, float]
SIZE, SOURCE, LISTENER = (6.0, 5.0, 2.7), (1.5, 2.0, 1.2), (4.3, 3.1, 1.6)


@ci_slow
def test_mirror_shoebox_energy_against_image_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    """All-mirror walls: energy per 10 ms against the image-source sum, to 250 ms."""
    delay, energy, *_ = _image_sources(SIZE, SOURCE, LISTENER, 0.2, 0.3)
    edges = np.arange(0.0, 0.2501, 0.01)
    expected = np.histogram(delay, edges, weights=energy)[0]
    scene = box(SIZE, table(0.2, 0.0))
    # Arrivals within a detector's blur of an edge may fall on its other side: a narrow detector.
    monkeypatch.setattr(detector, "GROWTH", detector.Growth(0.1, 0.01, 0.25))
    config = plain(walks=1000, specular={"ratio": 16}, duration=0.26)

    def run(seed: int) -> np.ndarray:
        return ss.simulate(scene, [SOURCE], [LISTENER], config, seed)[0, 0].histogram(0.01)[0, :25]

    samples = repeat(run, 12)
    assert_mean(samples[:, 3:], expected[3:], "image sources", relative=0.05)
    np.testing.assert_allclose(samples[0, :1], expected[:1], rtol=1e-9)  # direct sound alone


@pytest.mark.parametrize(
    ("source", "listener"),
    [
        (SOURCE, LISTENER),
        (SOURCE, SOURCE),  # all reflections by two walls meet the edge between them
        ((1.0, 1.5, 0.8), (2.0, 3.0, 1.6)),  # three of them do
        ((4.8, 3.8, 0.3), (3.6, 2.6, 2.2)),
        ((1.9, 2.1, 1.3), (1.9, 2.1, 0.4)),
    ],
)
def test_mirror_shoebox_arrivals_are_exact(source: Place, listener: Place) -> None:
    """Deterministic mirrors: every image of order 1 and 2, and there and back between two walls, delay and energy to
    rounding; once also where a path meets an edge between two walls."""
    with np.errstate(invalid="ignore", divide="ignore"):  # direct sound from a place to itself
        delay, energy, order, direction = _image_sources(SIZE, source, listener, 0.2, 0.3)
    offset = 343.0 * delay[:, None] * direction - np.subtract(source, listener)
    along_one = (np.abs(offset) > 1e-9).sum(axis=1) == 1
    chosen = ((order >= 1) & (order <= 2)) | ((order == 3) & along_one)
    scene = box(SIZE, table(0.2, 0.0))
    early = ss.simulate(scene, [source], [listener], plain(walks=8))[0, 0].early
    assert len(early) == chosen.sum() == 30
    wanted, got = (
        np.column_stack([t, e, d])[np.lexsort((*d.T.round(6), t.round(12)))]
        for t, e, d in (
            (delay[chosen], energy[chosen], direction[chosen]),
            (early.delay, early.energy[:, 0], early.direction),
        )
    )
    np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9)


@ci_slow
def test_mirror_shoebox_arrivals_to_order_six(monkeypatch: pytest.MonkeyPatch) -> None:
    """Isolated images of order 3 to 6 appear in the histogram, within the detectors' blur of 0.05 ms."""
    delay, energy, order, _ = _image_sources(SIZE, SOURCE, LISTENER, 0.1, 0.3)
    scene = box(SIZE, table(0.1, 0.0))
    monkeypatch.setattr(detector, "GROWTH", detector.Growth(0.25, 0.0, 0.25))
    config = plain(
        walks=800,
        specular={"ratio": 64},
        duration=0.12,
        time_grid=((0.0, 0.00005),),
    )
    samples = repeat(
        lambda seed: ss.simulate(scene, [SOURCE], [LISTENER], config, seed)[0, 0].histogram(0.00005)[0],
        8,
    )
    half = 0.00005
    gap = np.array([np.abs(np.delete(delay, i) - delay[i]).min() for i in range(len(delay))])
    isolated = np.flatnonzero((order >= 3) & (order <= 6) & (gap > 3 * half) & (delay < 0.11))
    assert {int(o) for o in order[isolated]} >= {3, 4, 5, 6}
    got = np.stack(
        [samples[:, int((delay[i] - half) / 0.00005) : int((delay[i] + half) / 0.00005) + 1].sum(axis=1)
         for i in isolated], axis=1,
    )  # fmt: skip
    assert_mean(got, energy[isolated], "isolated images", relative=0.2)
