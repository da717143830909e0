"""How far room measures of one measured response lie from those of energies: arrivals interfere.

An echogram adds energies of arrivals, which is their mean over phases. One response in a band of width B has
phases: arrivals a and b that are apart by t add to its energy 2 sqrt(E_a E_b) γ(t) cos φ, |γ|² = sinc²(B t), of
mean square 2 E_a E_b |γ|² over φ. Of diffuse sound of intensity I that is a variance of I² dt / B. So the variance
of a measure y is, to first order, with I smoothed over 1 / B and I_a that of one arrival,

    var(y) = ∫ (∂y/∂E(t))² (I² - Σ_a I_a²) dt / B

as a single arrival interferes with nothing. For exponential decays this is what ISO 3382-2 says of T20 and T30.
Where the line of T20, T30 or EDT ends is taken as fixed: beside strong early arrivals EDT scatters up to half as
much again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from soundspaces_sim import ConfigError, Echogram
from soundspaces_sim.parts import (
    BIN_S,
    RANGES,
    decay_curve,
    first_loud,
)

_PER_NEPER = 10.0 / np.log(10.0)
_EARLY = {"c50": 0.05, "c80": 0.08, "d50": 0.05}
_LEVELS = {name.lower(): (upper, lower) for name, upper, lower in RANGES}


def interference_spread(
    echogram: Echogram, names: Sequence[str] = ("t30", "edt", "c80", "d50")
) -> np.ndarray:
    """(measures, b) standard deviations of room measures of single responses about those of the echogram, of
    ``t20``, ``t30``, ``edt``, ``c50``, ``c80``, ``d50``; NaN where there is no such measure. Raises
    `ConfigError`."""
    unknown = [name for name in names if name not in (*_EARLY, *_LEVELS)]
    if unknown:
        raise ConfigError(f"interference: expected {', '.join((*_LEVELS, *_EARLY))}, got {unknown[0]!r}")
    energy = echogram.histogram(BIN_S)
    start = int(first_loud(energy))
    if echogram.direct is not None:
        start = int(echogram.direct.delay / BIN_S + 1e-9)
    widths = np.diff(echogram.bands)
    out = np.full((len(names), len(widths)), np.nan)
    for b, width in enumerate(widths):
        variance = _variances(echogram, energy[b], b, width)
        for k, name in enumerate(names):
            slope = _derivative(name, energy[b, start:])
            slope = np.concatenate([np.repeat(slope[:1], start), slope])  # filters ring before the onset
            out[k, b] = np.sqrt(np.sum(slope**2 * variance))
    return out


def _variances(echogram: Echogram, energy: np.ndarray, b: int, width: float) -> np.ndarray:
    """(n,) of the energy (n,) of bins of one band."""
    sigma = 1.0 / (2.0 * np.sqrt(np.pi) * width * BIN_S)  # its square convolved has area 1 and height B

    def smooth(of: np.ndarray) -> np.ndarray:
        return np.asarray(gaussian_filter1d(of, sigma, mode="constant"))

    whole = smooth(energy) ** 2
    for arrival in echogram.arrivals:
        at = min(int(arrival.delay / BIN_S), len(energy) - 1)
        alone = np.zeros(len(energy))
        alone[at] = arrival.energy[b]
        whole -= smooth(alone) ** 2
    return np.asarray(np.maximum(whole, 0.0) / (width * BIN_S))


def _derivative(name: str, energy: np.ndarray) -> np.ndarray:
    """(n,) of a measure by the energies (n,) of bins from the onset on."""
    whole = energy.sum()
    if not whole > 0.0:
        return np.full(len(energy), np.nan)
    if name in _EARLY:
        early = np.arange(len(energy)) * BIN_S < _EARLY[name] - 1e-9
        share = energy[early].sum() / whole
        with np.errstate(divide="ignore", invalid="ignore"):
            by_share = np.where(early, 1.0 - share, -share) / whole
            return by_share if name == "d50" else _PER_NEPER * by_share / (share * (1.0 - share))
    upper, lower = _LEVELS[name]
    curve, left = decay_curve(energy), energy[::-1].cumsum()[::-1]
    use = (curve <= upper) & (curve >= lower)
    if use.sum() < 3:
        return np.full(len(energy), np.nan)
    time = np.where(use, (np.arange(len(energy)) - np.flatnonzero(use).mean()) * BIN_S, 0.0)
    weight = time / (time**2).sum()
    slope = float(weight @ np.where(use, curve, 0.0))
    by_bin = np.cumsum(np.divide(weight, left, out=np.zeros_like(left), where=left > 0.0))
    return np.asarray(60.0 / slope**2 * _PER_NEPER * by_bin)
