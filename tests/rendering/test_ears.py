"""Whose ears: a rigid sphere for near sources, displaced heads, equalisation."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.echogram import Arrival, Arrivals
from soundspaces_sim.rendering.decoder import equalised_spectra
from soundspaces_sim.rendering.ears import HEAD_RADIUS, ear_rirs, near_field_gains, sphere_response
from soundspaces_sim.rendering.hrtf import load_hrtf

C, RATE = 343.0, 44100
NONE = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))
AHEAD = np.zeros((1, 3))


def _from(direction: list[float], distance: float) -> ss.Echogram:
    table = np.zeros((20, 9, 4), np.float32)
    table[4:, 0] = 1e-4
    direct = Arrival(distance / C, np.full(4, 1.0 / (4.0 * np.pi * distance**2)), np.array(direction))
    return ss.Echogram(DEFAULT_BANDS, np.arange(21) * 0.002, table, direct, NONE, np.zeros((2, 4)), True)


render = partial(ss.ambisonic_rir, rate=RATE, seed=3)


@pytest.mark.parametrize("rho", [1.25, 2.0, 8.0])
@pytest.mark.parametrize("cosine", [1.0, 0.3, 0.0, -1.0])
def test_sphere_at_rest(rho: float, cosine: float) -> None:
    """At 0 Hz the sum has a closed form, from the generating function of the Legendre polynomials: with
    t = 1 / rho and R = sqrt(1 - 2 t x + t^2), H = rho (2 t / R - ln((R + t - x) / (1 - x)))."""
    t, x = 1.0 / rho, min(cosine, 1.0 - 1e-9)
    r = np.sqrt(1.0 - 2.0 * t * x + t * t)
    wanted = rho * (2.0 * t / r - np.log((r + t - x) / (1.0 - x)))
    got = sphere_response(np.array([0.0]), rho * HEAD_RADIUS, x)[0]
    assert abs(got) == pytest.approx(wanted, rel=1e-4)


def test_sphere_far_away() -> None:
    """A plane wave: pressure doubles on the near side of a large sphere; a small one is not there; and the
    interaural delay at low frequency is 3 a sin(theta) / c (Kuhn 1977)."""
    low, high = sphere_response(np.array([20.0, 20000.0]), 20.0, 1.0)
    assert abs(low) == pytest.approx(1.0, abs=0.01) and abs(high) == pytest.approx(2.0, abs=0.05)
    frequency = np.array([100.0])
    for sine in (0.3, 1.0):
        left, right = (sphere_response(frequency, 20.0, side)[0] for side in (sine, -sine))
        delay = np.angle(left * right.conjugate()) / (2.0 * np.pi * 100.0)
        assert abs(delay) == pytest.approx(3.0 * HEAD_RADIUS * sine / C, rel=0.02)


def test_near_sources_are_louder_at_the_near_ear() -> None:
    """At 12 cm to the left the level difference grows by more than 10 dB at low frequencies, where far sources
    have none (Brungart & Rabinowitz 1999: 20 dB and more at 500 Hz); at the reference nothing changes."""
    frequency = np.array([100.0, 500.0])
    gains = near_field_gains(frequency, 0.12, 1.4, np.array([0.0, 1.0, 0.0]))
    assert np.all(20.0 * np.log10(gains[0] / gains[1]) > 10.0)
    np.testing.assert_allclose(near_field_gains(frequency, 1.4, 1.4, np.array([0.6, 0.8, 0.0])), 1.0)
    front = near_field_gains(frequency, 0.2, 1.4, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(front[0], front[1])


def test_near_field_changes_the_direct_sound_alone() -> None:
    """20 cm to the left: each ear's direct sound by the sphere's gain, to 0.3 dB; reverberation the same samples
    as without; 1.2 m away all is the same."""
    near, far = _from([0.0, 1.0, 0.0], 0.2), _from([0.0, 1.0, 0.0], 1.2)
    plain, ears = ss.Ears(near_field=False), ss.Ears()
    a, b = (ear_rirs(near, render, RATE, AHEAD, e, C)[0] for e in (plain, ears))
    quiet = ear_rirs(replace(near, direct=None), render, RATE, AHEAD, plain, C)[0]
    before, after = (np.abs(np.fft.rfft((x - quiet).astype(float), 8192)) for x in (a, b))
    frequency = np.fft.rfftfreq(8192, 1.0 / RATE)
    use = (frequency > 200.0) & (frequency < 8000.0)
    wanted = near_field_gains(frequency[use], 0.2, load_hrtf().distance, np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(
        20.0 * np.log10(after[:, use] / before[:, use]), 20.0 * np.log10(wanted), atol=0.3
    )
    c, d = (ear_rirs(far, render, RATE, AHEAD, e, C) for e in (plain, ears))
    np.testing.assert_array_equal(c, d)


def test_a_head_off_its_point() -> None:
    """0.2 m forward, heading left, of a source 1 m to the left: the direct sound is 0.8 m away."""
    turn = np.array([[90.0, 0.0, 0.0]])
    moved = ear_rirs(
        _from([0.0, 1.0, 0.0], 1.0),
        render,
        RATE,
        turn,
        ss.Ears(offset=(0.2, 0.0, 0.0), near_field=False),
        C,
    )
    there = ear_rirs(_from([0.0, 1.0, 0.0], 0.8), render, RATE, turn, ss.Ears(near_field=False), C)
    n = min(moved.shape[2], there.shape[2])
    np.testing.assert_allclose(moved[..., :n], there[..., :n], atol=1e-6)


def test_equalisation() -> None:
    """Power over all directions: flat with diffuse-field equalisation; the set's own colour without, so that the
    two differ by one filter for all directions and ears."""
    hrtf = load_hrtf()
    frequency = np.fft.rfftfreq(2048, 1.0 / hrtf.rate)
    flat, own = (equalised_spectra(hrtf, e) for e in ("diffuse-field", "none"))
    use = (frequency > 400.0) & (frequency < 12000.0)
    ratio = np.abs(own[:, :, use]) / np.abs(flat[:, :, use])
    assert np.ptp(ratio, axis=(0, 1)).max() < 1e-6 * ratio.max()
    colour = 20.0 * np.log10(ratio[0, 0])
    assert colour.max() > 6.0 and abs(colour[0]) < 3.0  # KEMAR's ear canal resonates at 3 kHz
    front = _from([1.0, 0.0, 0.0], 2.0)
    a, b = (
        ear_rirs(front, render, RATE, AHEAD, ss.Ears(equalisation=e), C)
        for e in ("diffuse-field", "none")
    )
    assert not np.array_equal(a, b)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"equalisation": "free"}, "equalisation: expected diffuse-field or none, got 'free'"),
        ({"decoder": "best"}, "decoder: expected aligned or magls"),
        ({"offset": (0.0, 0.0, 0.6)}, "offset: expected .* at most 0.5 m"),
        ({"offset": (0.0, 0.0)}, "offset: expected"),
    ],
)
def test_bad_ears(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        ss.Ears(**settings)  # type: ignore[arg-type]
