"""Room measures after ISO 3382-1:2009, from energy decays.

Conventions: energies per time bin, last axis time; times in s, levels in dB. The onset (the direct
sound's time) starts the early windows. A measure whose decay range is too short is NaN, and
`RoomMeasures.reasons` says why.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.bands import DEFAULT_BANDS
from soundspaces_sim.echogram import Echogram
from soundspaces_sim.errors import ConfigError
from soundspaces_sim.filters import band_shares

_HEADROOM_DB = 10.0  # the decay must reach this far below the evaluated range (ISO 3382-1, 5.3.3)
_BIN_S = 0.001
_ONSET_DB = -20.0  # of the peak: where a response starts (ISO 3382-1, annex A.3.4)


@dataclass(frozen=True)
class RoomMeasures:
    """Each (bands,), except `reasons`: what is NaN and why."""

    t20: np.ndarray
    t30: np.ndarray
    edt: np.ndarray
    c50: np.ndarray
    c80: np.ndarray
    d50: np.ndarray
    ts: np.ndarray
    drr: np.ndarray
    reasons: tuple[str, ...]


def decay_curve(energy: np.ndarray) -> np.ndarray:
    """(…, n) backward-integrated energy in dB re the total (Schroeder 1965), at each bin's start."""
    remaining = np.cumsum(energy[..., ::-1], axis=-1)[..., ::-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(10.0 * np.log10(remaining / remaining[..., :1]))


def reverberation_time(
    energy: np.ndarray, bin_s: float, upper_db: float, lower_db: float
) -> tuple[float, str]:
    """Time for 60 dB, from a line through the decay curve between two levels; (NaN, why) if short.

    EDT: (0, -10); T20: (-5, -25); T30: (-5, -35).
    """
    if not energy.any():
        return float("nan"), "no energy"
    curve = decay_curve(energy)
    reached = float(curve[np.isfinite(curve)].min())
    if reached > lower_db - _HEADROOM_DB:
        return float(
            "nan"
        ), f"the decay reaches {reached:.1f} dB, needed {lower_db - _HEADROOM_DB:.0f} dB"
    use = (curve <= upper_db) & (curve >= lower_db)
    if use.sum() < 3:
        return float("nan"), "fewer than three bins in the evaluated range"
    t = np.arange(len(energy))[use] * bin_s
    slope = np.polyfit(t, curve[use], 1)[0]
    if slope >= 0.0:
        return float("nan"), "the energy does not decay"
    return float(-60.0 / slope), ""


def energy_measures(energy: np.ndarray, bin_s: float, onset_s: float) -> RoomMeasures:
    """Measures of (bands, n) energies; `onset_s` is the direct sound's time."""
    bands = len(energy)
    start = int(onset_s / bin_s + 1e-9)
    after = energy[:, start:]
    reasons: list[str] = []
    times = np.full((3, bands), np.nan)
    for i, (name, upper, lower) in enumerate(
        (("T20", -5.0, -25.0), ("T30", -5.0, -35.0), ("EDT", 0.0, -10.0))
    ):
        for b in range(bands):
            times[i, b], reason = reverberation_time(after[b], bin_s, upper, lower)
            if reason:
                reasons.append(f"{name}, band {b}: {reason}")
    total = after.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        early50 = _up_to(after, bin_s, 0.05)
        early80 = _up_to(after, bin_s, 0.08)
        middle = (np.arange(after.shape[1]) + 0.5) * bin_s
        direct = _up_to(after, bin_s, 0.0025)
        return RoomMeasures(
            times[0], times[1], times[2],
            10.0 * np.log10(early50 / (total - early50)), 10.0 * np.log10(early80 / (total - early80)),
            early50 / total, (after @ middle) / total, 10.0 * np.log10(direct / (total - direct)),
            tuple(reasons),
        )  # fmt: skip


def _up_to(energy: np.ndarray, bin_s: float, time: float) -> np.ndarray:
    whole = int(time / bin_s + 1e-9)
    part = energy[:, whole] * (time / bin_s - whole) if whole < energy.shape[1] else 0.0
    return np.asarray(energy[:, :whole].sum(axis=1) + part)


def room_measures(echogram: Echogram) -> RoomMeasures:
    """Measures of an echogram, per band; the onset is its first arrival."""
    energy = echogram.histogram(_BIN_S)
    lit = np.flatnonzero(energy.any(axis=0))
    first = float(lit[0]) * _BIN_S if len(lit) else 0.0
    if echogram.direct is not None:
        first = echogram.direct.delay
    return energy_measures(energy, _BIN_S, first)


def waveform_measures(
    ir: ArrayLike, rate: float, bands: tuple[float, ...] = DEFAULT_BANDS
) -> RoomMeasures:
    """Measures of an omnidirectional pressure response (n,) at `rate` Hz, per band.

    `bands`: edges in Hz; those that begin above Nyquist are left out. The onset is where the response
    first comes within 20 dB of its peak. Bands are cut without phase, with squared gains that add up to
    one, so that the energies of the bands add up to that of the response.
    """
    response = np.asarray(ir, float)
    if response.ndim != 1 or len(response) < 2 or not np.isfinite(response).all():
        raise ConfigError(f"ir: expected finite values of shape (n,), got {response.shape}")
    n = 2 * len(response)  # room for the filters to ring
    frequency = np.fft.rfftfreq(n, 1.0 / rate)
    gains = np.sqrt(band_shares(bands, frequency, rate))
    energy = np.fft.irfft(np.fft.rfft(response, n) * gains, n, axis=1)[:, : len(response)] ** 2
    peak = np.abs(response).max()
    onset = int(np.argmax(np.abs(response) >= 10.0 ** (_ONSET_DB / 20.0) * peak))
    # Filters without phase ring before the onset as well: that is energy of the direct sound.
    energy[:, onset] += energy[:, :onset].sum(axis=1)
    return energy_measures(energy, 1.0 / rate, onset / rate)
