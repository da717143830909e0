"""What an agent that learns is told of a step's sound: cues of hearing, few enough for a small network.

Per step and pair of ears: the generalised cross-correlation with phase transform (Knapp & Carter 1976) below and
above 2 kHz at lags of a head, and in twenty bands the level of both ears and the difference of their levels. These
are the interaural time and level differences, and the spectrum, of which loudness tells of distance.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft

LAGS = 27  # -13 to 13 samples at 16 kHz, as much as a head's delay at both sides
BANDS = 20
CUES = 2 * LAGS + 2 * BANDS
_SPLIT, _LOW, _HIGH = 2000.0, 100.0, 8000.0  # Hz
_LAG_S = 1.0 / 16000.0
_WEAK = 1e-3  # of the strongest bin's cross-spectrum: weaker bins have no phase
_LEAST_DB, _RANGE_DB = -90.0, 60.0


@lru_cache(maxsize=4)
def _plan(samples: int, rate: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """((2 F, 2 LAGS) inverse transform of a spectrum at the lags, real parts then imaginary, each half in its range
    of frequency; (F, 2) which bins are in either range; (F, BANDS) share of a bin in a band)."""
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    lag = (np.arange(LAGS) - LAGS // 2) * _LAG_S
    turn = 2.0 * np.pi * frequency[:, None] * lag
    within = np.stack(
        [(frequency >= _LOW) & (frequency < _SPLIT), (frequency >= _SPLIT) & (frequency < _HIGH)], axis=1
    )
    real = np.concatenate([np.cos(turn) * within[:, k : k + 1] for k in range(2)], axis=1)
    imaginary = np.concatenate([-np.sin(turn) * within[:, k : k + 1] for k in range(2)], axis=1)
    edges = np.geomspace(_LOW, min(_HIGH, 0.5 * rate), BANDS + 1)
    band = np.searchsorted(edges, frequency, "right") - 1
    of_band = (band[:, None] == np.arange(BANDS)) / (0.5 * samples**2)  # mean square, by Parseval
    return (
        np.concatenate([real, imaginary]).astype(np.float32),
        within.astype(np.float32),
        of_band.astype(np.float32),
    )


def ear_cues(ears: np.ndarray, rate: int) -> np.ndarray:
    """(CUES,) float32 of ears (2, n): correlations by lag below and above 2 kHz, the left ear's lead positive, 1
    for one wave from one direction; levels in bands, 60 dB for 1; differences of levels, left over right, 20 dB for
    1."""
    inverse, within, of_band = _plan(ears.shape[1], rate)
    left, right = scipy.fft.rfft(ears.astype(np.float32))
    cross = right * left.conj()
    size = np.abs(cross)
    strong = size > _WEAK * float(size.max())
    phase = np.where(strong, cross / np.maximum(size, 1e-30), 0.0).astype(np.complex64)
    used = np.maximum(strong.astype(np.float32) @ within, 1.0)
    correlation = np.concatenate([phase.real, phase.imag]) @ inverse
    power = np.stack([np.abs(left) ** 2, np.abs(right) ** 2]) @ of_band
    level = 10.0 * np.log10(np.maximum(power, 10.0 ** (0.1 * _LEAST_DB)))
    return np.concatenate(
        [
            correlation / np.repeat(used, LAGS),
            (level.mean(axis=0) - _LEAST_DB) / _RANGE_DB,
            (level[0] - level[1]) / 20.0,
        ]
    ).astype(np.float32)
