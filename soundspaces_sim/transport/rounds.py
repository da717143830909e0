"""Subpaths in rounds, until a pair's error bars are as small as the config asks.

Whoever asks for an error does not say how many subpaths that takes. A first round of few tells every pair's
variance, and so how many more the pair needs; it takes part in the smallest of the later rounds that has as many.
Their numbers are in steps of two, so a pair is in few of them. Which ones depends on the pair's own results alone,
so these are the same whatever is simulated beside it. A pair's tables are the mean over its rounds, batch by batch,
weighted by their subpaths, not by their error bars: these are large where energies came out large, and would draw
the mean down. So its error bars are those of one round of as many subpaths.
"""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.simulation_config import DEFAULT_WALKS, SimulationConfig
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.transport.tables import BATCHES

_FIRST = 192  # subpaths: 5 % in a shoebox of 150 m³; with 128 a second round is more often needed than worth it
_UNKNOWN_TIMES = 7  # as many more subpaths where the first are too few to know the error


def round_sizes(config: SimulationConfig) -> list[int]:
    """Subpaths per point of every round there may be, multiples of BATCHES; with neither a number nor an error in
    the config, those of a dataset."""
    walks = config.walks
    if config.target_error is None:
        return [_up(DEFAULT_WALKS if walks is None else walks)]
    if walks is not None:
        return [_up(walks)] * max(config.max_walks // _up(walks), 1)
    sizes = [min(_FIRST, _up(config.max_walks))]
    left, growing = max(config.max_walks - sizes[0], 0) // BATCHES * BATCHES, []
    size = sizes[0] // 2
    while BATCHES <= size < left:
        growing.append(_up(size))
        size *= 2
    # smaller ones once more, for pairs that still lack some and for which the largest would be too many
    return [*sizes, *growing, left, *growing[::-1]] if left else sizes


def _up(walks: int) -> int:
    return -(-walks // BATCHES) * BATCHES  # batches of equal size


def takes_part(error: np.ndarray, done: np.ndarray, number: int, config: SimulationConfig) -> np.ndarray:
    """Which pairs take part in a later round. `error`: largest relative error of each so far, infinite where it is
    not known; `done`: its subpaths so far."""
    sizes, target = round_sizes(config), config.target_error
    assert target is not None
    later = np.array(sizes[number:])
    times = np.where(np.isfinite(error), np.square(error / target) - 1.0, float(_UNKNOWN_TIMES))
    needed = times * done
    allowed = later <= (max(config.max_walks, sizes[0]) - done)[..., None]
    enough = allowed & (later >= needed[..., None])
    least, most = np.where(enough, later, np.inf).argmin(-1), np.where(allowed, later, 0).argmax(-1)
    best = np.where(enough.any(-1), least, most)
    return np.asarray(~(error <= target) & allowed[..., 0] & (best == 0))


def statement(echoes: Echograms, config: SimulationConfig) -> str:
    """What has become of the error that was asked for."""
    target = config.target_error
    if target is None:
        return ""
    error = echoes.relative_error.max(axis=(2, 3))
    missed = ~(error <= target)
    asked = f"asked for an error of {_percent(target)}"
    if not missed.any():
        return f"{asked}: all {error.size:,} pairs have it (largest {_percent(float(error.max()))})"
    known = error[missed & np.isfinite(error)]
    parts = [f"largest {_percent(float(known.max()))}"] if len(known) else []
    if len(known) < missed.sum():
        parts.append(f"{missed.sum() - len(known):,} not known")
    return (
        f"{asked}: {missed.sum():,} of {error.size:,} pairs have a larger one ({', '.join(parts)}) after up to "
        f"{config.max_walks:,} subpaths per point, the most that simulation.max_walks allows"
    )


def _percent(error: float) -> str:
    return f"{100.0 * error:.2g} %"
