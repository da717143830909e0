"""Dry speech and what microphones hear of it. The speech is synthetic: syllables by a source and three formants.

`nav.synthetic_sounds` makes the syllables. Rhythm, pauses, levels and pitch vary as drawn; words, prosody and
talkers' timbres of real speech are missing, so scores are not those of recorded speech.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import oaconvolve

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import synthesise
from soundspaces_tasks.setting import RATE

FRAME, HOP = 512, 256  # samples of a spectrogram's frame and between frames
_VOICES = 5  # variants of the syllables
_PAUSE_S = (0.05, 0.5)
_LEVELS_DB = 4.0  # standard deviation between groups of syllables
_NOISE_DB = (20.0, 40.0)  # speech above white noise
_SHORT_S = 0.03  # of a fade at the edges of a group


def dry_speech(seconds: float, rng: np.random.Generator) -> np.ndarray:
    """(n,) float64 at `RATE`, RMS 1: groups of three syllables with pauses between, that start at a random time."""
    need = int(seconds * RATE)
    fade = np.minimum(1.0, np.arange(RATE) / (_SHORT_S * RATE))
    groups: list[np.ndarray] = []
    while sum(map(len, groups)) < need + RATE:
        voice, seed = int(rng.integers(_VOICES)), int(rng.integers(2**31))
        group = synthesise("syllable", voice, RATE, seed) * fade * fade[::-1]
        level = 10.0 ** (rng.normal(0.0, _LEVELS_DB) / 20.0)
        groups += [
            level * group / np.sqrt(np.mean(group**2)),
            np.zeros(int(rng.uniform(*_PAUSE_S) * RATE)),
        ]
    start = int(rng.integers(RATE))
    speech = np.concatenate(groups)[start : start + need]
    return np.asarray(speech / np.sqrt(np.mean(speech**2)))


def heard(dry: np.ndarray, response: np.ndarray, rng: np.random.Generator | None = None) -> np.ndarray:
    """(channels, n) of a dry signal (n,) through a response (channels, m), the first channel with RMS 1; with `rng`
    white noise of a drawn level is added, each channel's own."""
    wet = oaconvolve(response.astype(float), dry[None], axes=1)[:, : len(dry)]
    level = float(np.sqrt(np.mean(wet[0] ** 2)))
    if not (np.isfinite(level) and level > 0.0):
        raise ConfigError(
            f"response: expected finite values that are not all zero, got a level of {level}"
        )
    wet = wet / level
    if rng is not None:
        wet = wet + 10.0 ** (-rng.uniform(*_NOISE_DB) / 20.0) * rng.standard_normal(wet.shape)
    return np.asarray(wet)


def spectra(signal: np.ndarray) -> np.ndarray:
    """(…, frames, FRAME / 2 + 1) complex short-time spectra of (…, n), by square roots of Hann windows."""
    parts = np.lib.stride_tricks.sliding_window_view(signal, FRAME, axis=-1)[..., ::HOP, :]
    return np.fft.rfft(parts * _window(), axis=-1)


def signal_of(short: np.ndarray, length: int) -> np.ndarray:
    """(length,) whose `spectra` (frames, bins) are `short`: overlap and add. The first and last `HOP` samples,
    which one frame alone covers, are attenuated by the window."""
    parts = np.fft.irfft(short, FRAME, axis=-1) * _window()
    out = np.zeros(length)
    for k, part in enumerate(parts):
        out[k * HOP : k * HOP + FRAME] += part
    return out


def _window() -> np.ndarray:
    return np.sqrt(0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(FRAME) / FRAME))


def mel_bands(count: int) -> np.ndarray:
    """(count, FRAME / 2 + 1) triangles over frequency, even in mel: 2595 log10(1 + f / 700), O'Shaughnessy."""
    frequency = np.fft.rfftfreq(FRAME, 1.0 / RATE)
    highest = 2595.0 * np.log10(1.0 + 0.5 * RATE / 700.0)
    edges = 700.0 * (
        10.0 ** (np.linspace(2595.0 * np.log10(1.0 + 60.0 / 700.0), highest, count + 2) / 2595.0) - 1.0
    )
    rise = (frequency - edges[:-2, None]) / np.diff(edges)[:-1, None]
    fall = (edges[2:, None] - frequency) / np.diff(edges)[1:, None]
    return np.maximum(np.minimum(rise, fall), 0.0)


def log_energies(power: np.ndarray, bands: np.ndarray) -> np.ndarray:
    """(…, frames, bands) dB of a power spectrogram in bands, not below 80 dB under the largest."""
    energy = power @ bands.T
    return np.asarray(10.0 * np.log10(np.maximum(energy, 1e-8 * energy.max())))
