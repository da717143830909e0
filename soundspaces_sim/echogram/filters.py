"""Filters over the simulation's bands, and the noise they shape.

Reverberation is noise that is cut into bands *after* its envelope, so that any envelope stays in its
band. `band_shares` are powers that sum to one below the highest edge. A crossover is a squared cosine,
linear in frequency, and 5 % as wide as the narrower of its two bands: what lies beyond a band's edges is
at most 0.9 % of its energy (-20.4 dB), whatever the bands are.

Discrete arrivals are filtered without noise by minimum-phase responses (`arrival_filters`): nothing
rings before an arrival, and equal bands give back a clean delta.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft

from soundspaces_sim.core.numerics.air import Air

_HALF_WIDTH = 0.025  # of a crossover, in widths of the narrower band beside it
_NOISE_LENGTH = 1 << 19
_STEP_OCTAVES = 1.0 / 6.0  # over which an arrival's gain goes from one band's to the next
FLOOR = 1e-3  # least amplitude of an arrival's band beside its strongest
_NOTHING = 1e-300  # energy, in place of what underflows
_SPAN_S = 0.06  # of an arrival's filter
_PHASES = 64


def _half_width(bands: tuple[float, ...], edge: int) -> float:
    """Of the crossover at an edge, Hz."""
    width = np.diff(np.array([0.0, *bands[1:]]))
    return float(_HALF_WIDTH * width[max(edge - 1, 0) : edge + 1].min())


def _rise(frequency: np.ndarray, middle: float, half: float) -> np.ndarray:
    """Squared sine from 0 to 1 about `middle`."""
    x = np.clip((frequency - middle) / (2.0 * half) + 0.5, 0.0, 1.0)
    return np.asarray(np.sin(0.5 * np.pi * x) ** 2)


def band_shares(bands: tuple[float, ...], frequency: np.ndarray, rate: float) -> np.ndarray:
    """(B', n) share of the power at each frequency that belongs to each band.

    B' bands begin below Nyquist. The lowest extends to 0 Hz; above the highest edge, nothing was
    simulated and the shares are zero. A band that Nyquist cuts extends to it.
    """
    below = [np.zeros_like(frequency, float)]
    for i, edge in enumerate(bands[1:], 1):
        if edge >= 0.5 * rate:
            below.append(np.ones_like(frequency, float))
            break
        below.append(1.0 - _rise(frequency, edge, _half_width(bands, i)))
    return np.maximum(np.diff(np.stack(below), axis=0), 0.0)


def band_windows(bands: tuple[float, ...], frequency: np.ndarray, rate: float) -> np.ndarray:
    """(B', n) power gains that keep to the inside of each band, clear of the crossovers of `band_shares`.

    For measuring: nothing of a neighbouring band is seen, however much slower it decays.
    """
    out = []
    for b in range(len(bands) - 1):
        if b > 0 and bands[b] >= 0.5 * rate:
            break
        gain = np.ones_like(frequency, float)
        if b > 0:
            half = _half_width(bands, b)
            gain *= _rise(frequency, bands[b] + 2.0 * half, half)
        if bands[b + 1] < 0.5 * rate:
            half = _half_width(bands, b + 1)
            gain *= 1.0 - _rise(frequency, bands[b + 1] - 2.0 * half, half)
        out.append(gain)
    return np.stack(out)


@lru_cache(maxsize=1)
def white_noise() -> np.ndarray:
    """(2^19,) float32 white noise of unit variance, periodic: any offset is a start.

    Its spectrum has random phases and exactly equal magnitudes.
    """
    phase = np.random.default_rng(0x5EED).uniform(0.0, 2.0 * np.pi, _NOISE_LENGTH // 2 + 1)
    phase[[0, -1]] = 0.0
    spectrum = np.sqrt(_NOISE_LENGTH) * np.exp(1j * phase)
    noise = np.fft.irfft(spectrum, _NOISE_LENGTH).astype(np.float32)
    noise.setflags(write=False)
    return noise


@lru_cache(maxsize=8)
def sinc_table(bands: tuple[float, ...], rate: int) -> np.ndarray:
    """(phases + 1, 2 h) windowed sinc; row k delays by h - 1 + k / phases samples.

    It reaches 1 ms to either side (32 samples at most) and ends at Nyquist or the highest edge.
    """
    half = min(32, int(0.001 * rate))
    cut = min(1.0, bands[-1] / (0.5 * rate))
    x = np.arange(-half + 1, half + 1)[None, :] - np.arange(_PHASES + 1)[:, None] / _PHASES
    window = np.i0(8.0 * np.sqrt(np.maximum(1.0 - (x / half) ** 2, 0.0))) / np.i0(8.0)
    return np.ascontiguousarray(cut * np.sinc(cut * x) * window)


def minimum_phase(log_magnitude: np.ndarray) -> np.ndarray:
    """(n / 2 + 1,) complex logarithm of the minimum-phase spectrum of this log-magnitude, in nepers
    (Oppenheim & Schafer: folded cepstrum)."""
    cepstrum = np.fft.irfft(log_magnitude)
    half = len(cepstrum) // 2
    cepstrum[1:half] *= 2.0
    cepstrum[half + 1 :] = 0.0
    return np.asarray(np.fft.rfft(cepstrum))


@lru_cache(maxsize=8)
def log_steps(bands: tuple[float, ...], rate: int) -> tuple[np.ndarray, int]:
    """((B' - 1, n / 2 + 1) complex, n): what a rise of 1 neper at each inner edge adds to the logarithm
    of a minimum-phase spectrum of n points."""
    n = int(scipy.fft.next_fast_len(int(_SPAN_S * rate), real=True))
    n += n % 2
    over = 32  # a finer grid, so that the cepstrum has room
    frequency = np.fft.rfftfreq(n * over, 1.0 / rate)
    rows = []
    for edge in (e for e in bands[1:-1] if e < 0.5 * rate):
        octaves = np.log2(np.maximum(frequency, 1e-9) / edge) / _STEP_OCTAVES
        step = np.sin(0.5 * np.pi * np.clip(octaves + 0.5, 0.0, 1.0)) ** 2
        rows.append(minimum_phase(step)[::over])
    return np.array(rows, np.complex64).reshape(len(rows), n // 2 + 1), n


@lru_cache(maxsize=64)
def left_after(air: Air, bands: tuple[float, ...], metres: int) -> np.ndarray:
    """(metres + 1, B) logarithm of what air leaves of the bands after every metre."""
    return np.log(np.maximum(air.transmission(bands, np.arange(metres + 1.0)), _NOTHING))


def air_left(air: Air, bands: tuple[float, ...], travelled: np.ndarray) -> np.ndarray:
    """(n, B) share of the energy of bands that air leaves of sound that has travelled for (n,) s."""
    lengths = travelled * air.speed_of_sound
    metres = 1 << int(np.ceil(lengths.max(initial=0.0)) + 1).bit_length()  # a few tables serve all
    table = left_after(air, bands, metres)
    at = np.arange(metres + 1.0)
    return np.exp(np.stack([np.interp(lengths, at, column) for column in table.T], axis=1))


@lru_cache(maxsize=8)
def air_spectrum(air: Air, rate: int, n: int) -> np.ndarray:
    """(n / 2 + 1,) logarithm of the minimum-phase spectrum of a metre of air."""
    over = 32
    frequency = np.fft.rfftfreq(n * over, 1.0 / rate)
    return minimum_phase(-0.5 * air.attenuation(frequency))[::over].astype(np.complex64)


def arrival_filters(
    energy: np.ndarray,
    delay: np.ndarray,
    bands: tuple[float, ...],
    rate: int,
    air: Air | None = None,
    travelled: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Responses of arrivals with band energies (A, B) at delays (A,) in s.

    Returns ((A, n) float32, (A,) sample at which each begins). The magnitude is sqrt(energy) inside a
    band and goes over to the next one's, in dB, within a sixth of an octave. With `air`, which the energies
    include, it falls within bands as ISO 9613-1 has it after a path of `travelled` (A,) s, by default the delays.
    """
    steps, n = log_steps(bands, rate)
    travelled = delay if travelled is None else travelled
    if air is not None:
        left = air_left(air, bands, travelled)
        energy = np.divide(energy, left, out=np.zeros(energy.shape), where=left > 0.0)
    gains = np.sqrt(energy[:, : len(steps) + 1].astype(float))
    peak = gains.max(axis=1, keepdims=True)
    level = np.log(np.maximum(gains, np.maximum(FLOOR * peak, 1e-30)))
    rises = np.diff(level, axis=1).astype(np.float32)
    # einsum, not @: BLAS would wake threads for a sum of three terms.
    log = level[:, :1].astype(np.float32) + np.einsum("ab,bf->af", rises, steps)
    if air is not None:
        lengths = (travelled * air.speed_of_sound).astype(np.float32)
        log += lengths[:, None] * air_spectrum(air, rate, n)
    spectrum = np.exp(log)

    table = sinc_table(bands, rate)
    position = delay * rate
    whole = np.floor(position)
    row = (position - whole) * _PHASES
    k = np.minimum(row.astype(np.int64), _PHASES - 1)
    mix = (row - k)[:, None]
    taps = ((1.0 - mix) * table[k] + mix * table[k + 1]).astype(np.float32)
    response = scipy.fft.irfft(scipy.fft.rfft(taps, n) * spectrum, n)
    fade = n // 8
    response[:, -fade:] *= np.cos(0.5 * np.pi * np.arange(1, fade + 1, dtype=np.float32) / fade) ** 2
    return response, whole.astype(np.int64) - table.shape[1] // 2 + 1
