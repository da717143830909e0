"""Dry sounds to listen with, made by formula: syllables, a hand clap, plucked strings.

They stand in for recordings, which a package cannot carry; `listen` takes recordings of your own.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

# Formants F1 to F3 in Hz of vowels of a male voice (Peterson & Barney 1952).
_VOWELS = {
    "a": (730, 1090, 2440),
    "e": (530, 1840, 2480),
    "i": (270, 2290, 3010),
    "o": (570, 840, 2410),
    "u": (300, 870, 2240),
}
_BANDWIDTHS = (80.0, 100.0, 140.0)


def hand_clap(rate: int, seconds: float = 1.0) -> np.ndarray:
    """(n,) float32: one clap, a noise burst of 4 ms about 1 to 4 kHz (after Repp 1987)."""
    rng = np.random.default_rng(1)
    t = np.arange(int(seconds * rate)) / rate
    burst = rng.standard_normal(len(t)) * np.exp(-t / 0.004) * (1.0 - np.exp(-t / 0.0003))
    return _normal(
        sosfilt(butter(2, [800.0, min(4500.0, 0.45 * rate)], "band", fs=rate, output="sos"), burst)
    )


def music(rate: int) -> np.ndarray:
    """(n,) float32: a broken chord of plucked strings (Karplus & Strong 1983), 3.6 s."""
    rng = np.random.default_rng(2)
    out = np.zeros(int(3.6 * rate))
    for k, semitones in enumerate((0, 7, 12, 16, 19, 24, 19, 16, 12, 7)):
        period = round(rate / (130.81 * 2.0 ** (semitones / 12.0)))
        pluck = np.zeros(int(1.4 * rate))
        pluck[:period] = rng.uniform(-1.0, 1.0, period)
        feedback = np.zeros(period + 2)
        feedback[0], feedback[period], feedback[period + 1] = 1.0, -0.498, -0.498
        start = int(0.24 * k * rate)
        string = lfilter([1.0], feedback, pluck)[: len(out) - start]
        out[start : start + len(string)] += string
    return _normal(out)


def syllables(rate: int) -> np.ndarray:
    """(n,) float32: sa-se-si-so-su, a source and three formants (Fant 1960), 3.2 s."""
    rng = np.random.default_rng(3)
    out = np.zeros(int(3.2 * rate))
    for k, formants in enumerate(_VOWELS.values()):
        hiss = rng.standard_normal(int(0.09 * rate)) * np.hanning(int(0.09 * rate))
        hiss = sosfilt(butter(4, min(4000.0, 0.4 * rate), "high", fs=rate, output="sos"), hiss)
        n = int(0.38 * rate)
        pitch = 118.0 - 6.0 * k + 12.0 * np.sin(np.pi * np.arange(n) / n)
        phase = np.cumsum(pitch / rate)
        voice = np.diff(np.floor(phase), prepend=0.0)  # one pulse per period
        for f, width in zip(formants, _BANDWIDTHS, strict=True):
            radius = np.exp(-np.pi * width / rate)
            a = [1.0, -2.0 * radius * np.cos(2.0 * np.pi * f / rate), radius**2]
            voice = lfilter([sum(a)], a, voice)
        voice *= np.minimum(1.0, 8.0 * np.sin(np.pi * np.arange(n) / n))
        start = int(0.6 * k * rate)
        out[start : start + len(hiss)] += 0.15 * hiss / np.abs(hiss).max()
        start += int(0.07 * rate)
        out[start : start + n] += voice / np.abs(voice).max()
    return _normal(out)


def _normal(signal: np.ndarray) -> np.ndarray:
    return np.asarray(0.5 * signal / np.abs(signal).max(), np.float32)
