"""Random equalisation of reverberation below 200 Hz, where rays lack the modes of small rooms.

Speech recognition trained with geometrical responses gains from low frequencies that vary as those of measured
rooms do (Z. Tang, H.-Y. Meng and D. Manocha, "Low-frequency compensated synthetic impulse responses for improved
far-field speech recognition", ICASSP 2020). Here third octaves have gains of their own, independent and normal in
dB, which vanish at 200 Hz. Of one frequency of a diffuse field the level has a standard deviation of 5.6 dB
(Kuttruff, Room Acoustics, 3.4); where few modes lie in a third, that of a third is of the same order.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import oaconvolve

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import minimum_phase

EDGE = 200.0  # Hz: nothing changes above
_LOWEST = 25.0  # Hz: gains stay as they are below
_THIRDS = EDGE * 2.0 ** (-np.arange(1, 10) / 3.0)  # Hz, centres
_OVER = 4  # of the grid of frequencies, so that the cepstrum has room
_MOST_DB = 20.0


def check_deviation(deviation_db: float) -> float:
    """A standard deviation in dB, 0 to 20. Raises `ConfigError`."""
    if not 0.0 <= deviation_db <= _MOST_DB:
        raise ConfigError(f"low_equalisation_db: expected 0 to {_MOST_DB:g} dB, got {deviation_db}")
    return deviation_db


def low_filter(gains_db: np.ndarray, rate: int) -> np.ndarray:
    """(rate,) the minimum-phase response whose level is (9,) `gains_db` at the third octaves from 159 Hz down,
    linear over log frequency between them, and 0 dB from 200 Hz on."""
    frequency = np.fft.rfftfreq(_OVER * rate, 1.0 / rate)
    at = np.log2(np.maximum(frequency, _LOWEST))
    level = np.interp(at, np.log2([*_THIRDS[::-1], EDGE]), [*gains_db[::-1], 0.0])
    spectrum = np.exp(minimum_phase(level * np.log(10.0) / 20.0))
    return np.asarray(np.fft.irfft(spectrum)[:rate])


def equalised(rng: np.random.Generator, late: np.ndarray, deviation_db: float, rate: int) -> np.ndarray:
    """Responses (S, K, n) without their direct sound, with a random filter for each source: microphones of an array
    are much nearer to each other than a wavelength."""
    filters = [low_filter(deviation_db * rng.standard_normal(len(_THIRDS)), rate) for _ in late]
    full = oaconvolve(late, np.array(filters)[:, None], axes=2)
    return np.asarray(full[:, :, : late.shape[2]], np.float32)
