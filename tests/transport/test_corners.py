"""Sound past a corner of a screen, where two edges meet ."""

import numpy as np
import pytest
import trimesh
from scipy.special import fresnel

import soundspaces_sim as ss
from tests.marks import ci_slow, few
from tests.rooms import in_free_air
from tests.transport.exact_wedge import SPEED
from tests.transport.test_diffraction import CONFIG, SHAPE, against_waves, screen
from tests.transport.wave_twin import STEP

_AWAY = 2.0  # m, of source and listener from the screen


def _blocked(h: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Part of the pressure that an endless screen takes whose edge is `h` m below the straight path, (..., k): the
    Kirchhoff integral in the parabolic approximation."""
    u = np.sqrt(2.0 * k * (2.0 / _AWAY) / np.pi / 2.0) * np.asarray(h)[..., None]
    s, c = fresnel(u)
    return np.asarray(0.5 * (1.0 - (1.0 + 1.0j) * (c - 1.0j * s)))


def _levels(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(Ours, the integral) dB over a free field, (n, 2) in the lowest two bands: of straight paths that meet the
    screen's plane at places (n, 2) from its corner, m, outwards and upwards."""
    bands = np.array(CONFIG.bands[:3], float)
    bands[0] = 0.5 * bands[1]
    edges = np.stack([bands[:-1], bands[1:]])
    share = (np.arange(40) + 0.5) / 40.0
    k = 2.0 * np.pi / SPEED * (edges[0] * (edges[1] / edges[0]) ** share[:, None]).T
    ours, exact = np.empty((len(places), 2)), np.empty((len(places), 2))
    for i, (y, z) in enumerate(places):
        at = np.array([0.0, 40.0 + y, z])
        ends = at - [_AWAY, 0.03, 0.02], at + [_AWAY, 0.03, 0.02]
        e = ss.simulate(screen(), [ends[0]], [ends[1]], CONFIG)[0, 0]
        p = np.zeros(k.shape, complex)
        for a in e.arrivals:
            p += np.sqrt(4.0 * np.pi * a.energy[:2])[:, None] * np.exp(-1j * k * a.delay * SPEED)
        ours[i] = 10.0 * np.log10((np.abs(p) ** 2).mean(axis=1) * 4.0 * _AWAY**2)
        whole = 1.0 - _blocked(np.array(y), k) * _blocked(np.array(z), k)
        exact[i] = 10.0 * np.log10((np.abs(whole) ** 2).mean(axis=1))
    return ours, exact


@pytest.mark.parametrize("z", [-0.3, -0.8])
def test_what_a_corner_lets_past(z: float) -> None:
    """In the shadow of both edges of a screen's corner, against the same depth far from it: by how much the level is
    higher, in bands from 89 to 776 Hz, is that of the Kirchhoff integral within 0.7 dB. Nearer to the boundary of a
    shadow than 0.3 m that tells less, as it has nothing of what a rigid screen reflects."""
    across = np.arange(-0.6, -0.25, 0.1)
    ours, exact = _levels(np.array([(y, z) for y in across] + [(-20.0, z)]))
    gain, expected = ours[:-1] - ours[-1], exact[:-1] - exact[-1]
    assert expected.min() > 2.0
    assert np.abs(gain - expected).max() < 0.7, gain - expected


@pytest.mark.parametrize("z", few([-0.8, -0.3, 0.3], -0.3))
def test_levels_past_a_corner_have_no_steps(z: float) -> None:
    """Across the boundary of the shadow of the upright edge beside the upper one, 1 cm by 1 cm."""
    ours, _ = _levels(np.array([(y, z) for y in np.arange(-0.105, 0.11, 0.01)]))
    assert np.abs(np.diff(ours, axis=0)).max() < 0.3, np.abs(np.diff(ours, axis=0)).max(axis=0)


def test_sound_at_the_corner_itself() -> None:
    """In line with a corner of a screen, where detours by both edges are next to nothing: what both take still adds up,
    so levels are those 1 cm beside it (1.4 dB louder before 2026-11-26)."""
    at = -np.array([5e-4, 1e-3, 1e-2])  # rays start off the edges of a screen of 80 m by some 0.1 mm
    ours, _ = _levels(np.stack([at, at], axis=1))
    assert np.ptp(ours, axis=0).max() < 0.3, ours


def test_the_plane_of_a_face_in_the_light_of_the_edge_beside_it() -> None:
    """A straight path that passes an edge of a box of 3 m by 0.22 m, above the plane of the box's side: nothing changes
    as its end comes to that plane but by what is 30 dB weaker."""
    body = trimesh.creation.box(bounds=[[-3.0] * 3, [0.0] * 3])
    source, across = np.array([-0.4, -0.3, 1.5]), np.array([-3e-3, -3e-4, 3e-4, 3e-3])
    listeners = np.array([(x, 1.4, -1.0) for x in across])
    echoes = ss.simulate(in_free_air(body), [source], listeners, CONFIG)
    direct = [echoes[0, n].arrivals[0] for n in range(len(listeners))]
    distance = np.linalg.norm(listeners - source, axis=1)
    np.testing.assert_allclose([a.delay * SPEED for a in direct], distance, atol=1e-3)
    levels = 10.0 * np.log10(np.array([a.energy for a in direct]) * distance[:, None] ** 2)
    assert np.ptp(levels, axis=0).max() < 0.05


@ci_slow
def test_a_corner_against_the_wave_equation() -> None:
    """Thirds of an octave from 125 to 500 Hz at eight places behind a free screen, which see two sources past a corner of
    it, past its sides, or not at all: a rigid finite-difference solution within 0.6 dB in the root mean square (1.4 where
    each edge has its own part alone), and 2 dB at most."""
    open_ = np.ones(SHAPE[1:], bool)
    open_[30:70, :60] = False
    rectangles = [(29.5 * STEP, 69.5 * STEP, -20.0, 59.5 * STEP)]
    across = [(72, 55), (76, 60), (80, 62), (84, 66), (72, 66), (66, 62), (78, 70), (74, 58)]
    places = np.array([(72, y, z) for y, z in across])
    off = [
        np.subtract(*against_waves(open_, rectangles, source, places))
        for source in ((28, 60, 50), (30, 64, 62))
    ]
    assert np.sqrt(np.mean(np.square(off))) < 0.6
    assert np.abs(off).max() < 2.0
