"""Filter banks over the simulation's bands.

One set of crossovers serves two banks. `lowpass_gain(f, edge)` falls from 1 to 0 as a squared cosine in
log frequency, within a third of an octave about `edge`; the share of band b is the difference of two
neighbours. Shares sum to one, so

- discrete arrivals use them as amplitude gains (zero phase): equal bands give back a clean delta;
- noise uses their square roots: powers sum to one, so equal bands give white noise of unit variance.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

_HALF_WIDTH_OCTAVES = 1.0 / 6.0
_NOISE_LENGTH = 1 << 19
_SPAN_CYCLES = 12.0  # the lowpass at edge f rings for about this many cycles of f on either side
SINC_HALF = 32  # taps on either side of the fractional-delay sinc
_PHASES = 64


def lowpass_gain(frequency: np.ndarray, edge: float) -> np.ndarray:
    """Amplitude gain of the crossover at `edge` Hz; 1 well below, 0 well above."""
    octaves = np.log2(np.maximum(frequency, 1e-9) / edge) / (2.0 * _HALF_WIDTH_OCTAVES)
    return np.asarray(np.cos(0.5 * np.pi * np.clip(octaves + 0.5, 0.0, 1.0)) ** 2)


def crossovers(bands: tuple[float, ...], rate: float) -> list[float]:
    """Edges between neighbouring bands that a signal of this rate can carry, Hz."""
    return [e for e in bands[1:-1] if e < 0.5 * rate]


def band_shares(bands: tuple[float, ...], frequency: np.ndarray, rate: float) -> np.ndarray:
    """(B', n) share of each band at each frequency; B' bands begin below Nyquist. Sums to one."""
    gains = [lowpass_gain(frequency, e) for e in crossovers(bands, rate)]
    steps = [np.zeros_like(frequency, float), *gains, np.ones_like(frequency, float)]
    return np.diff(np.stack(steps), axis=0)


@lru_cache(maxsize=8)
def noise_table(bands: tuple[float, ...], rate: int) -> np.ndarray:
    """(B', n) float32: one long white noise, split into bands (periodic, so any offset is a start).

    Its spectrum has random phase and exactly flat magnitude: band variances are exact.
    """
    phase = np.random.default_rng(0x5EED).uniform(0.0, 2.0 * np.pi, _NOISE_LENGTH // 2 + 1)
    phase[[0, -1]] = 0.0
    spectrum = np.sqrt(_NOISE_LENGTH) * np.exp(1j * phase)
    gains = np.sqrt(band_shares(bands, np.fft.rfftfreq(_NOISE_LENGTH, 1.0 / rate), rate))
    table = np.fft.irfft(spectrum * gains, n=_NOISE_LENGTH, axis=1).astype(np.float32)
    table.setflags(write=False)
    return table


@lru_cache(maxsize=8)
def sinc_table() -> np.ndarray:
    """(phases + 1, 2 * SINC_HALF) windowed sinc: row k delays by k / phases of a sample."""
    n = np.arange(-SINC_HALF + 1, SINC_HALF + 1)[None, :]
    x = n - np.arange(_PHASES + 1)[:, None] / _PHASES
    window = np.i0(8.0 * np.sqrt(np.maximum(1.0 - (x / SINC_HALF) ** 2, 0.0))) / np.i0(8.0)
    return np.ascontiguousarray(np.sinc(x) * window)


@lru_cache(maxsize=8)
def lowpass_table(bands: tuple[float, ...], rate: int) -> tuple[np.ndarray, int]:
    """Impulse responses of the crossovers, oversampled: ((B' - 1, (2 h + 1) * 8 + 1), h).

    Entry (h * 8) is time zero and neighbours are an eighth of a sample apart; `h` taps on either side.
    """
    over = 8
    edges = crossovers(bands, rate)
    if not edges:
        return np.zeros((0, 1)), 0
    half = int(np.ceil(_SPAN_CYCLES * rate / edges[0]))
    n = 1 << int(np.ceil(np.log2(4 * half * over)))
    frequency = np.fft.rfftfreq(n, 1.0 / (rate * over))
    inside = frequency <= 0.5 * rate
    rows = []
    for edge in edges:
        response = np.fft.irfft(lowpass_gain(frequency, edge) * inside, n=n) * over
        centered = np.roll(response, (half + 1) * over)[: (2 * half + 3) * over]
        t = (np.arange(len(centered)) - (half + 1) * over) / ((half + 1) * over)
        rows.append(centered * np.cos(0.5 * np.pi * np.clip(t, -1.0, 1.0)) ** 2)
    return np.ascontiguousarray(rows), half
