"""Frequency bands: edges, representative frequencies, and per-band values of a spectrum.

Conventions: `edges` are B + 1 increasing frequencies in Hz; band b is [edges[b], edges[b + 1]].
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from soundspaces_sim.core.errors import ConfigError

#: The four bands of SoundSpaces (Chen et al. 2020, "Audio Simulation Details").
DEFAULT_BANDS = (0.0, 176.0, 775.0, 3409.0, 20000.0)
MOST_BANDS, HIGHEST = 64, 1e6  # Hz
PER_OCTAVE = {"octaves": 1, "thirds": 3}
LOWEST, HIGHEST_OCTAVE = 50.0, 16000.0  # Hz, of octaves and thirds by name
_NOMINAL = (1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0, 10.0)


def check_edges(edges: Sequence[float]) -> tuple[float, ...]:
    """Edges as a tuple of floats; `ConfigError` unless there are two to `MOST_BANDS` + 1, increasing from >= 0,
    and at most `HIGHEST`."""
    try:
        values = tuple(float(e) for e in edges)
    except (TypeError, ValueError):
        values = ()
    increasing = all(a < b for a, b in pairwise(values))
    if len(values) < 2 or not np.all(np.isfinite(values)) or values[0] < 0.0 or not increasing:
        raise ConfigError(
            f"bands: expected two or more increasing edges in Hz from 0 up, got {edges!r}; "
            f"the default is {DEFAULT_BANDS}"
        )
    if len(values) > MOST_BANDS + 1 or values[-1] > HIGHEST:
        raise ConfigError(
            f"bands: expected at most {MOST_BANDS} bands up to {HIGHEST:g} Hz, got {len(values) - 1} up to "
            f"{values[-1]:g} Hz"
        )
    return values


def named_edges(asked: str) -> tuple[float, ...]:
    """Edges of ``paper`` (`DEFAULT_BANDS`), ``octaves`` (63 Hz to 16 kHz), ``thirds`` (50 Hz to 16 kHz), or of
    numbers with commas between them, Hz. Raises `ConfigError`."""
    if asked == "paper":
        return DEFAULT_BANDS
    if asked in PER_OCTAVE:
        return check_edges(fractional_octaves(PER_OCTAVE[asked], LOWEST, HIGHEST_OCTAVE)[0].tolist())
    try:
        return check_edges([float(edge) for edge in asked.split(",")])
    except ValueError:
        raise ConfigError(
            f"bands: expected paper, {', '.join(PER_OCTAVE)}, or edges in Hz with commas between them, "
            f"got {asked!r}"
        ) from None


def log_edges(edges: Sequence[float]) -> np.ndarray:
    """(B + 1,) edges with a positive lowest one, for work on a logarithmic axis.

    A band that starts at 0 Hz is taken to be as wide, in octaves, as its neighbour (an octave if it has
    none): below that a room holds no reverberant energy to speak of.
    """
    values = np.array(edges, float)
    if values[0] == 0.0:
        ratio = values[2] / values[1] if len(values) > 2 else 2.0
        values[0] = values[1] / ratio
    return values


def center_frequencies(edges: Sequence[float]) -> np.ndarray:
    """(B,) geometric mean of each band, Hz."""
    values = log_edges(edges)
    return np.sqrt(values[:-1] * values[1:])


def fractional_octaves(per_octave: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """((K + 1,), (K,)): edges and midband frequencies of the bands of IEC 61260-1 (`per_octave` 1 or 3) whose
    midband frequencies lie from `low` to `high`, Hz; exact ones, 1000 Hz times powers of 10^0.3."""
    step = 10.0 ** (0.3 / per_octave)
    first, last = (np.log(f / 1000.0) / np.log(step) for f in (low, high))
    k = np.arange(np.ceil(first - 0.1), np.floor(last + 0.1) + 1.0)
    return 1000.0 * step ** (np.append(k, k[-1] + 1.0) - 0.5), 1000.0 * step**k


def nominal(frequency_hz: float) -> float:
    """The nominal frequency (IEC 61260-1, annex E: 31.5, 40, 50, 63 …) nearest to one in Hz."""
    decade = 10.0 ** np.floor(np.log10(frequency_hz))
    return float(min((x * decade for x in _NOMINAL), key=lambda x: abs(np.log(x / frequency_hz))))


def band_means(frequency_hz: np.ndarray, values: np.ndarray, edges: Sequence[float]) -> np.ndarray:
    """(…, B) means over bands of values given at frequencies ((k,), (…, k)).

    A published coefficient is the mean over its octave (or third), so the spectrum is a staircase that
    changes half way (geometrically) between given frequencies, and extends flat at both ends. The mean
    is taken over log frequency. Octave bands of an octave table therefore get exactly its values.
    """
    steps = np.sqrt(frequency_hz[:-1] * frequency_hz[1:])
    lower = np.concatenate([[0.0], steps])
    upper = np.concatenate([steps, [np.inf]])
    grid = log_edges(edges)
    low = np.maximum(grid[:-1, None], lower[None, :])
    high = np.minimum(grid[1:, None], upper[None, :])
    weight = np.log(np.maximum(high / np.maximum(low, 1e-9), 1.0))
    weight /= weight.sum(axis=1, keepdims=True)
    return values @ weight.T
