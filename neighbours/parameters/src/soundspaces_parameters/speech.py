"""Speech transmission index (IEC 60268-16:2020), and speech in open-plan offices (ISO 3382-3).

The modulation transfer of a band with energy E(t) is that of Schroeder (1981),

    m(F) = |∫ E(t) exp(-2 pi i F t) dt| / ∫ E(t) dt,

times what noise, masking by the octave below and the threshold of hearing leave of it. Levels are those of
speech at 1 m in the open from a source that is as loud all round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from soundspaces_parameters.response import Response
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import BIN_S

OCTAVES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)  # Hz
MODULATIONS = 0.63, 0.8, 1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0, 10.0, 12.5  # Hz
_WEIGHTS = np.array([0.085, 0.127, 0.230, 0.233, 0.309, 0.224, 0.173])  # alpha
_REDUNDANCY = np.array([0.085, 0.078, 0.065, 0.011, 0.047, 0.095])  # beta
_THRESHOLD = np.array([46.0, 27.0, 12.0, 6.5, 7.5, 8.0, 12.0])  # dB, absolute speech reception threshold
_SPECTRUM = np.array([-2.5, 0.5, 0.0, -6.0, -12.0, -18.0, -24.0])  # dB re the A-weighted level
OFFICE_SPEECH_DB = np.array([49.9, 54.3, 58.0, 52.0, 44.8, 38.8, 33.5])  # at 1 m, ISO 3382-3
A_WEIGHTING_DB = np.array([-16.1, -8.6, -3.2, 0.0, 1.2, 1.0, -1.1])  # IEC 61672-1
_LARGEST_DB = 200.0


@dataclass(frozen=True)
class Speech:
    """Speech and noise of a room. `level_db`: A-weighted level of speech at 1 m, dB, of the standard's
    spectrum; or seven levels, octaves from 125 Hz to 8 kHz. `noise_db`: seven levels of the background noise at
    the listener, dB; None: no noise. Raises `ConfigError`."""

    level_db: float | Sequence[float] = 60.0
    noise_db: Sequence[float] | None = None

    def __post_init__(self) -> None:
        _levels(self.level_db, "speech level")
        if self.noise_db is not None and np.ndim(self.noise_db) == 0:
            raise ConfigError(
                f"noise: expected seven levels in dB, octaves from 125 Hz to 8 kHz, got {self.noise_db!r}"
            )
        _levels(0.0 if self.noise_db is None else self.noise_db, "noise")

    @property
    def at_1_m(self) -> np.ndarray:
        """(7,) dB."""
        return _levels(self.level_db, "speech level")

    @property
    def noise(self) -> np.ndarray:
        """(7,) W/m² re 1e-12 W/m²."""
        return np.zeros(7) if self.noise_db is None else 10.0 ** (_levels(self.noise_db, "noise") / 10.0)


def _levels(given: float | Sequence[float], what: str) -> np.ndarray:
    try:
        values = np.asarray(given, float)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if values.shape not in ((), (7,)) or not (np.abs(values) <= _LARGEST_DB).all():
        raise ConfigError(
            f"{what}: expected one A-weighted level in dB or seven, octaves from 125 Hz to 8 kHz, got "
            f"{given!r:.80}"
        )
    return values if values.ndim else values + _SPECTRUM


def levels_at(response: Response, at_1_m: np.ndarray) -> np.ndarray:
    """(R, K) dB at the listener of a source with levels (K,) at 1 m in the open; -inf where nothing arrives."""
    with np.errstate(divide="ignore"):
        return np.asarray(at_1_m + 10.0 * np.log10(4.0 * np.pi * response.energy.sum(axis=-1)))


def modulation_transfer(energy: np.ndarray, bin_s: float) -> np.ndarray:
    """(…, 14) m(F) of energies (…, n), without noise. NaN where there is no energy.

    The centres of bins are used: within a bin of 1 ms even 12.5 Hz loses 0.03 % only."""
    turned = energy @ _turns(energy.shape[-1], bin_s)
    half = len(MODULATIONS)
    with np.errstate(invalid="ignore"):
        size = np.hypot(turned[..., :half], turned[..., half:])
        return np.asarray(size / energy.sum(axis=-1, keepdims=True))


@lru_cache(maxsize=16)
def _turns(bins: int, bin_s: float) -> np.ndarray:
    """(bins, 28) cosines of the modulations at the middles of bins, then sines."""
    angle = 2.0 * np.pi * np.outer((np.arange(bins) + 0.5) * bin_s, MODULATIONS)
    return np.concatenate([np.cos(angle), np.sin(angle)], axis=1)


def _masked(level_db: np.ndarray) -> np.ndarray:
    """Share of an octave's intensity that masks the next one, by its level in dB (annex A)."""
    slope = np.select(
        [level_db < 63.0, level_db < 67.0, level_db < 100.0],
        [0.5 * level_db - 65.0, 1.8 * level_db - 146.9, 0.5 * level_db - 59.8],
        -10.0,
    )
    return np.asarray(10.0 ** (slope / 10.0))


def heard(transfer: np.ndarray, speech_db: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(…, 7, 14) modulation transfer with noise, masking and threshold (A.2.4), from that without (…, 7, 14);
    `speech_db` (…, 7) at the listener, `noise` (7,) intensity."""
    speech = 10.0 ** (speech_db / 10.0)
    total = speech + noise
    with np.errstate(divide="ignore"):
        below = total[..., :-1] * _masked(10.0 * np.log10(total[..., :-1]))
    masking = np.concatenate([np.zeros_like(total[..., :1]), below], axis=-1)
    left = speech / (total + masking + 10.0 ** (_THRESHOLD / 10.0))
    return np.asarray(np.clip(transfer * left[..., None], 0.0, 1.0))


def transfer_indices(transfer: np.ndarray) -> np.ndarray:
    """(…) modulation transfer indices of bands, from their transfer (…, 14)."""
    with np.errstate(divide="ignore"):
        apparent = 10.0 * np.log10(transfer / (1.0 - transfer))
    return np.asarray(((np.clip(apparent, -15.0, 15.0) + 15.0) / 30.0).mean(axis=-1))


def index_of(indices: np.ndarray) -> np.ndarray:
    """(…) STI of modulation transfer indices (…, 7)."""
    shared = np.sqrt(indices[..., :-1] * indices[..., 1:])
    return np.minimum(indices @ _WEIGHTS - shared @ _REDUNDANCY, 1.0)


def _transfer(response: Response) -> np.ndarray:
    """(R, 7, 14) modulation transfer, without noise."""
    return modulation_transfer(response.energy, BIN_S)


def octave_indices(response: Response, speech: Speech) -> np.ndarray:
    """(R, 7) modulation transfer indices of a response in `OCTAVES`."""
    transfer = response.once(_transfer)
    return transfer_indices(heard(transfer, levels_at(response, speech.at_1_m), speech.noise))


def speech_transmission_index(response: Response, speech: Speech) -> np.ndarray:
    """(R,) STI of a response in `OCTAVES`."""
    return index_of(octave_indices(response, speech))


def a_weighted_level(response: Response, at_1_m: np.ndarray) -> np.ndarray:
    """(R,) dB at the listener, all `OCTAVES`, of a source with levels (7,) at 1 m."""
    octaves = levels_at(response, at_1_m) + A_WEIGHTING_DB
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10((10.0 ** (octaves / 10.0)).sum(axis=-1)))
