"""Ends that move: pitch, level and direction of what arrives alone, cross-fades of the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import hilbert
from scipy.signal.windows import tukey
from soundspaces_renderers.moving import Known, _play, as_way, render_moving

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.echogram import Arrival, Arrivals
from soundspaces_sim.echogram.filters import sinc_table
from soundspaces_sim.rendering.ambisonics import ambisonic_rir

C, RATE = 343.0, 16000
NONE = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))


def _free(points: np.ndarray, s: int, l: int) -> ss.Echogram:
    """Nothing but direct sound."""
    offset = points[s] - points[l]
    r = float(np.linalg.norm(offset))
    direct = Arrival(
        r / C, np.full(4, 1.0 / (4.0 * np.pi * max(r, 0.05) ** 2)), offset / r if r else offset
    )
    table = np.zeros((50, 9, 4), np.float32)
    return ss.Echogram(DEFAULT_BANDS, np.arange(51) * 0.002, table, direct, NONE, np.zeros((2, 4)), True)


def _over_ground(points: np.ndarray, s: int, l: int) -> ss.Echogram:
    """Direct sound off, and the floor z = 0 a mirror."""
    image = points[s] * [1.0, 1.0, -1.0]
    offset = image - points[l]
    r = float(np.linalg.norm(offset))
    floor = Arrivals(
        np.array([r / C]), np.full((1, 4), 1.0 / (4.0 * np.pi * r**2)), offset[None] / r,
        np.array([[0, -1]]),
    )  # fmt: skip
    return replace(_free(points, s, l), direct=None, early=floor)


def _known(
    points: np.ndarray, echogram: Callable[[np.ndarray, int, int], ss.Echogram], reach: float = 1.5
) -> Known:
    def respond(echoes: ss.Echogram, s: int, l: int) -> np.ndarray:
        return ambisonic_rir(echoes, RATE, 1000 * s + l)

    return Known(points, lambda s, l: echogram(points, s, l), respond, 0.1, RATE, C, reach)


def _row_of_points() -> np.ndarray:
    points = np.zeros((21, 3))
    points[:, 0] = np.arange(21.0) - 10.0
    points[:, 2] = 1.5
    return np.concatenate([points, [[0.0, 2.0, 1.5]]])


def _tone(seconds: float, f0: float = 1000.0) -> np.ndarray:
    n = round(seconds * RATE)
    tone = np.sin(2.0 * np.pi * f0 * np.arange(n) / RATE)
    return np.asarray(tone * tukey(n, 0.2), np.float32)  # fades, so that the measurement does not ring


def _pitch(signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(amplitude, frequency in Hz) at every sample."""
    whole = hilbert(signal.astype(float))
    phase = np.unwrap(np.angle(whole))
    return np.abs(whole), np.gradient(phase) * RATE / (2.0 * np.pi)


@pytest.mark.parametrize("moves", ["source", "listener"])
def test_a_siren_that_passes(moves: str) -> None:
    """Pitch, level and direction of a tone from a source at 20 m/s that passes a listener at 2 m, and of one
    at rest that a listener passes, against the formulas of Doppler (1842), at every sample.

    Source: f = f0 / (1 + v_r / c), v_r its radial speed at the instant of emission; listener: f0 (1 - v_r / c).
    """
    points, speed = _row_of_points(), 20.0
    way = as_way([[0.0, -10.0, 0.0, 1.5], [1.0, 10.0, 0.0, 1.5]], moves, C)
    rest = as_way([[0.0, 0.0, 2.0, 1.5]], "rest", C)
    ends = (way, rest) if moves == "source" else (rest, way)
    out = render_moving(_tone(1.0), *ends, _known(points, _free))

    # in closed form: at the instant tau the moving end is at x = -10 + v tau, its distance sqrt(x^2 + 4)
    tau = np.linspace(0.15, 0.85, 5000)
    x = -10.0 + speed * tau
    r = np.sqrt(x**2 + 4.0)
    radial = speed * x / r
    if moves == "source":
        heard, pitch, side = tau + r / C, 1000.0 / (1.0 + radial / C), x / r
    else:
        heard, pitch, side = tau, 1000.0 * (1.0 - radial / C), -x / r
    at = np.arange(round(heard[0] * RATE) + 1, round(heard[-1] * RATE))
    amplitude, frequency = _pitch(out[0])
    wanted = np.interp(at / RATE, heard, pitch)
    assert wanted.max() > 1050.0 and wanted.min() < 950.0
    np.testing.assert_allclose(frequency[at], wanted, atol=0.02)
    level = np.interp(at / RATE, heard, np.sqrt(1.0 / (4.0 * np.pi)) / r)
    np.testing.assert_allclose(amplitude[at] / level, 1.0, atol=2e-4)
    for first in range(
        at[0], at[-1] - 160, 1600
    ):  # the front channel over 10 ms: the cosine of its direction
        window = slice(first, first + 160)
        ratio = (out[3][window] * out[0][window]).sum() / (out[0][window] ** 2).sum()
        assert ratio == pytest.approx(np.interp((first + 80) / RATE, heard, side), abs=0.002)


def test_a_mirror_image_moves_as_its_source_does() -> None:
    """The floor's reflection alone: pitch and level are those of the image, and its path's neighbours in turn
    agree so well that nothing beats."""
    points = _row_of_points()
    way = as_way([[0.0, -8.0, 0.0, 1.5], [1.0, 8.0, 0.0, 1.5]], "source", C)
    out = render_moving(
        _tone(1.0), way, as_way([[0.0, 0.0, 2.0, 1.5]], "listener", C), _known(points, _over_ground)
    )
    tau = np.linspace(0.15, 0.85, 5000)
    x = -8.0 + 16.0 * tau
    r = np.sqrt(x**2 + 4.0 + 9.0)
    heard = tau + r / C
    at = np.arange(round(heard[0] * RATE) + 1, round(heard[-1] * RATE))
    amplitude, frequency = _pitch(out[0])
    wanted = np.interp(at / RATE, heard, 1000.0 / (1.0 + 16.0 * x / r / C))
    np.testing.assert_allclose(frequency[at], wanted, atol=0.02)
    level = np.interp(at / RATE, heard, np.sqrt(1.0 / (4.0 * np.pi)) / r)
    np.testing.assert_allclose(amplitude[at] / level, 1.0, atol=2e-4)


def test_at_rest_it_is_the_response() -> None:
    """An end that does not move: convolution with the ordinary response of its point."""
    points = _row_of_points()
    rng = np.random.default_rng(0)

    def room(points: np.ndarray, s: int, l: int) -> ss.Echogram:
        table = np.zeros((50, 9, 4), np.float32)
        table[5:, 0] = 1e-3 * np.exp(-np.arange(45.0) / 10.0)[:, None]
        return replace(_free(points, s, l), energy=table, early=_over_ground(points, s, l).early)

    dry = rng.normal(size=4000).astype(np.float32)
    here, there = (as_way([[0.0, *points[k]]], "end", C) for k in (4, 21))
    out = render_moving(dry, here, there, _known(points, room))
    rir = ambisonic_rir(room(points, 4, 21), RATE, 4021)
    wanted = np.stack([np.convolve(dry, row)[: out.shape[1]] for row in rir.astype(float)])
    n = min(wanted.shape[1], out.shape[1], 4000)
    error = np.sqrt(((out[:, :n] - wanted[:, :n]) ** 2).mean(axis=1) / (wanted[:, :n] ** 2).mean(axis=1))
    assert np.all(error[[0, 1, 3]] < 0.005), error


def test_reverberation_keeps_its_power_between_points() -> None:
    """Equal diffuse fields at all points, a source that passes them: the level does not dip between two."""
    points = _row_of_points()

    def diffuse(points: np.ndarray, s: int, l: int) -> ss.Echogram:
        table = np.zeros((50, 9, 4), np.float32)
        table[:, 0] = 1e-3
        return replace(_free(points, s, l), energy=table, direct=None)

    dry = np.random.default_rng(1).normal(size=RATE).astype(np.float32)
    way = as_way([[0.0, -5.0, 0.0, 1.5], [1.0, 5.0, 0.0, 1.5]], "source", C)
    rest = as_way([[0.0, 0.0, 2.0, 1.5]], "rest", C)
    for ends in ((way, rest), (rest, way)):
        out = np.mean([
            render_moving(np.roll(dry, 997 * k), *ends, _known(points, diffuse))[0].astype(float) ** 2
            for k in range(4)
        ], axis=0)  # fmt: skip
        parts = out[2400:15600].reshape(-1, 400).mean(axis=1)  # 25 ms each; a point passes every 100 ms
        around = parts[: len(parts) // 4 * 4].reshape(-1, 4).mean(axis=0)
        assert np.ptp(10.0 * np.log10(around)) < 0.5, around


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([[0.0, 1.0, 2.0]], "shape"),
        ([[0.0, 0.0, 0.0, 1.5], [0.0, 1.0, 0.0, 1.5]], "rising times"),
        ([[0.0, 0.0, 0.0, np.nan]], "finite"),
        ([[0.0, 0.0, 0.0, 1.5], [0.01, 2.0, 0.0, 1.5]], "at most 103 m/s, got 200 m/s"),
    ],
)
def test_ways_are_checked(rows: list[list[float]], message: str) -> None:
    with pytest.raises(ss.PointError, match=message):
        as_way(rows, "sources", C)


def test_a_way_that_leaves_the_points_is_an_error() -> None:
    points = _row_of_points()
    way = as_way([[0.0, 0.0, 0.0, 1.5], [1.0, 0.0, 6.0, 1.5]], "sources", C)
    with pytest.raises(ss.PointError, match=r"sources: at .* m from the nearest point"):
        render_moving(_tone(1.0), way, way, _known(points, _free))


def test_played_sound_is_that_of_the_moving_ear() -> None:
    """A tone well below the table's cutoff, read at fractional positions, is the tone at those times."""
    rate, tone = 8000, 0.11  # cycles per sample
    table = sinc_table((0.0, 4000.0), rate)
    sound = np.sin(2.0 * np.pi * tone * np.arange(400)).astype(np.float32)
    position = 60.0 + 1.003 * np.arange(200) + 0.37
    gains = np.stack([np.ones(200), np.linspace(0.0, 1.0, 200)]).astype(np.float32)
    out = np.zeros((2, 260), np.float32)
    _play(out, sound, 20, position, gains, table)
    np.testing.assert_allclose(out[:, 20:220], gains * np.sin(2.0 * np.pi * tone * position), atol=2e-3)
    assert not out[:, :20].any() and not out[:, 220:].any()
