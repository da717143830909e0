"""Room measures of waves below an edge (ISO 3382-1), from their pressure in bands.

Values are those of one response, in which arrivals and modes interfere; an echogram has the mean over phases.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import (
    LowResponse,
    RoomMeasures,
    band_energies,
    energy_measures,
    fractional_octaves,
)

LOW_MEASURES = ("t20", "t30", "edt", "c50", "c80", "d50", "ts")
_OVER = 4  # samples per sample: squares have twice the band
_LEEWAY = 1.02  # nominal edges of octaves
_LOWEST = 50.0  # Hz, of the octaves
_FADE_S = 0.05  # of a response's end: where it is cut, what goes on below a band would spread into it


def bands_below(edges: tuple[float, ...], edge: float) -> int:
    """How many of the bands between `edges` (K + 1,), Hz, lie whole below the `edge` of waves."""
    return int(np.sum(np.asarray(edges[1:]) <= _LEEWAY * edge))


def octaves_below(edge: float) -> tuple[float, ...]:
    """(K + 1,) Hz: edges of the octaves from 63 Hz on that lie whole below the `edge` of waves. Raises
    `ConfigError` if none does."""
    if not has_octave(edge):
        raise ConfigError(f"bands: no octave from 63 Hz on lies below the edge of waves, {edge:g} Hz")
    return _octaves(edge)


def has_octave(edge: float) -> bool:
    """Whether an octave from 63 Hz on lies whole below the `edge` of waves, Hz."""
    return len(_octaves(edge)) > 1


def _octaves(edge: float) -> tuple[float, ...]:
    edges, _ = fractional_octaves(1, _LOWEST, max(edge, 2.0 * _LOWEST))
    return tuple(edges[: bands_below(tuple(edges), edge) + 1].tolist())


def low_measures(low: LowResponse, edges: tuple[float, ...], onset_s: float | None) -> RoomMeasures:
    """Measures of waves in bands between `edges` (K + 1,), Hz, which lie below their edge.

    `onset_s`: s after the emission; None: where the pressure first comes within 20 dB of its peak (ISO 3382-1,
    A.3.4). The direct-to-reverberant ratio is NaN: 2.5 ms are less than a period. Raises `ConfigError` for bands
    above the edge.
    """
    _check_below(edges, low.edge)
    rate, lead = _OVER * low.rate, _OVER * low.lead
    left = (low.signal.shape[1] - np.arange(low.signal.shape[1])) / low.rate
    faded = low.signal[0] * np.sin(0.5 * np.pi * np.minimum(left / _FADE_S, 1.0)) ** 2
    pressure = scipy.signal.resample(faded, _OVER * len(faded))
    begin = None if onset_s is None else min(round(onset_s * rate) + lead, len(pressure) - 1)
    lower = (0.0, *edges) if edges[0] > 0.0 else edges  # the lowest band reaches to 0 Hz
    energy, onset = band_energies(pressure, rate, lower, begin)
    found = energy_measures(energy[len(lower) - len(edges) :], 1.0 / rate, onset / rate)
    reasons = (*found.reasons, "DRR: 2.5 ms are less than a period")
    return replace(found, drr=np.full_like(found.drr, np.nan), reasons=reasons)


def low_levels(low: LowResponse, edges: tuple[float, ...]) -> np.ndarray:
    """(K,) levels of waves in bands between `edges` (K + 1,), Hz, in dB re the direct sound at 1 m in the open.

    The mean of the squared transfer function over the band, at twice as many frequencies as the response tells
    apart. Raises `ConfigError` for bands above the edge of waves.
    """
    _check_below(edges, low.edge)
    per_hz = 2.0 * low.signal.shape[1] / low.rate
    power = []
    for first, last in pairwise(edges):
        count = int(np.ceil(per_hz * (last - first)))
        middle = first + (last - first) * (np.arange(count) + 0.5) / count
        power.append(4.0 * np.pi * np.square(np.abs(low.at(middle)[0])).mean())
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(power))


def _check_below(edges: tuple[float, ...], edge: float) -> None:
    if bands_below(edges, edge) < len(edges) - 1:
        raise ConfigError(
            f"bands: expected edges up to {edge:g} Hz, that of the waves, got {edges[-1]:g} Hz"
        )
