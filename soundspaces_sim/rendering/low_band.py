"""Waves below an edge, the echogram above it, as one response.

Discrete arrivals are in both, with the same amplitude and phase: their gains have to sum to one. Reverberation is
noise above and a field of its own below: independent, so that the squares of its gains have to sum to one. The
waves, which hold both, have one gain b; so arrivals get 1 - b and noise sqrt(1 - b²), and either sum is flat.
No gain is without its equal: both parts are responses to the same source (docs/theory.md, section 10).

b falls as a squared cosine from `_FROM` of the edge to `low_response.WHOLE` of it, without phase. Below, there is
nothing of order 2 and above: pressure and velocity are ambisonics of first order.
"""

from __future__ import annotations

import numpy as np
import scipy

from soundspaces_sim.echogram.low_response import WHOLE, LowResponse, seen

_FROM = 0.9  # of the edge, where the crossover begins
_RING_S = 0.25  # that a filter of the crossover rings, on either side
_ACN = [0, 2, 3, 1]  # W, Y, Z, X of pressure and velocity along x, y, z


def share(frequency: np.ndarray, edge: float) -> np.ndarray:
    """(k,) b: amplitude of the waves in the sum, 1 below the crossover, 0 above."""
    x = np.clip((frequency / edge - _FROM) / (WHOLE - _FROM), 0.0, 1.0)
    return np.asarray(np.cos(0.5 * np.pi * x) ** 2)


def above(signal: np.ndarray, edge: float, rate: int, arrivals: bool) -> np.ndarray:
    """(C, n) float32: what is kept of signals (C, n) at `rate` Hz: of discrete `arrivals`, or of reverberation."""
    n = signal.shape[1]
    size, gain = gain_above(n, rate, edge, arrivals)
    spectrum = scipy.fft.rfft(signal, size) * gain
    return np.asarray(scipy.fft.irfft(spectrum, size, overwrite_x=True)[:, :n], np.float32)


def gain_above(n: int, rate: int, edge: float, arrivals: bool) -> tuple[int, np.ndarray]:
    """(samples of the transform of n, (k,) float32 gains that `above` gives its frequencies)."""
    size = _size(n, rate)
    b = share(np.fft.rfftfreq(size, 1.0 / rate), edge)
    return size, (1.0 - b if arrivals else np.sqrt(1.0 - b**2)).astype(np.float32)


def below(low: LowResponse, shape: tuple[int, ...], rate: int) -> np.ndarray:
    """(C, n) float32, of this shape: ambisonic response of the waves with their gain; C is 4 or more."""
    out = np.zeros(shape, np.float32)
    out[: len(_ACN)] = _sampled(low, np.eye(len(_ACN))[None, _ACN], shape[1], rate)
    return out


def at_microphones(
    low: LowResponse,
    offsets: np.ndarray,
    amplitudes: list[np.ndarray],
    n: int,
    rate: int,
    speed_of_sound: float,
) -> np.ndarray:
    """(k, n) float32 of the waves at microphones `offsets` (k, 3) m beside the point, whose patterns have these
    `amplitudes` in the directions of `low_response.sphere`."""
    frequency = _frequencies(low, n, rate)
    rows = [
        seen(frequency, offset, pattern, speed_of_sound)[:, 0]
        for offset, pattern in zip(offsets, amplitudes, strict=True)
    ]
    return _sampled(low, np.stack(rows, axis=1), n, rate)


def combined(
    reverberation: np.ndarray, arrivals: np.ndarray, waves: np.ndarray, edge: float, rate: int
) -> np.ndarray:
    """(C, n) float32 of three parts (C, n): of the echogram, and of the waves with their gain."""
    high = above(reverberation, edge, rate, arrivals=False) + above(arrivals, edge, rate, arrivals=True)
    return high + waves


def _size(n: int, rate: int) -> int:
    """Of transforms, with room to ring."""
    return int(scipy.fft.next_fast_len(n + int(_RING_S * rate), real=True))


def _frequencies(low: LowResponse, n: int, rate: int) -> np.ndarray:
    """(k,) Hz, at which the waves have a share."""
    frequency = np.fft.rfftfreq(_size(n, rate), 1.0 / rate)
    return np.asarray(frequency[frequency < WHOLE * low.edge])


def _sampled(low: LowResponse, mixing: np.ndarray, n: int, rate: int) -> np.ndarray:
    """(C, n) float32 at `rate` of mixtures (k or 1, C, 4) of pressure and velocity, with the crossover's gain.

    The spectrum of the samples at their own rate is that of the response: no gain depends on the rates.
    """
    size, frequency = _size(n, rate), _frequencies(low, n, rate)
    turn = np.exp(-2j * np.pi * rate / size / low.rate)
    spectrum = scipy.signal.czt(low.signal.astype(float), len(frequency), turn)
    spectrum *= share(frequency, low.edge) * np.exp(2j * np.pi * frequency * low.lead / low.rate)
    mixed = np.einsum(
        "kci,ik->ck", np.broadcast_to(mixing, (len(frequency), *mixing.shape[1:])), spectrum
    )
    return np.asarray(scipy.fft.irfft(mixed, size)[:, :n], np.float32)
