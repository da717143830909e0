"""Decay compensation: energies are multiplied by exp(d l) of their path length l before they are summed.

Energies in a room fall by many orders of magnitude within an echogram. With a decay rate d (1/m) per band that is
common to all of them, compensated energies are nearly constant over length: sums in single precision lose nothing
to rounding, and bins may be wide. After convolution the factor exp(-d (l1 + l2)) is that of the whole path, so it
is undone on the result. Air is treated apart: what it leaves of a band is no product over the parts of a path.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows

_STEP = 3.0  # m, resolution of the fit
RANGE = 60.0  # nepers (260 dB) below the greatest energy: what is weaker is dropped. e^60 fits single precision
_RISE = 9.0  # nepers by which compensated energies may exceed the first ones: more would drown those in rounding
_CHUNK = 16384  # energies of a call, which stay in a cache


class Decay(NamedTuple):
    """By which energies are compensated, per band."""

    rate: np.ndarray  # (b,) 1/m
    reach: np.ndarray  # (b,) m, longer paths carry nothing


def compensate_decay(
    length: np.ndarray, decay: np.ndarray, reach: np.ndarray, energy: np.ndarray
) -> None:
    """Multiply `energy` (E, b) in place by exp(decay length), and by 0 beyond `reach`.

    `length` (E,) m; `decay` (b,) 1/m; `reach` (b,) m.
    """
    over_rows(_compensate, len(length), length, decay, reach, energy, chunk=_CHUNK)


@kernel
def _compensate(
    first: int, last: int, length: np.ndarray, decay: np.ndarray, reach: np.ndarray, energy: np.ndarray
) -> None:
    """`compensate_decay` for the rows `first` to `last`."""
    for e in range(first, last):
        for b in range(len(decay)):
            if energy[e, b] > 0.0 and length[e] <= reach[b]:
                energy[e, b] *= math.exp(decay[b] * length[e])
            else:
                energy[e, b] = 0.0


def rise(length: np.ndarray, energy: np.ndarray, decay: np.ndarray) -> float:
    """By how many nepers the greatest of compensated energies (E, b), summed over steps of length, is above those
    of all steps, in the mean over energies without the compensation by `decay` (b,) 1/m; in the band where most."""
    step, most = (length / _STEP).astype(np.int64), 0.0
    for band in range(energy.shape[1]):
        sums = np.bincount(step, energy[:, band]) if len(step) else np.zeros(0)
        at = np.flatnonzero(sums > 0.0)
        if len(at):
            level = np.log(sums[at])
            of_energy = np.exp((exponent := level - decay[band] * _STEP * at) - exponent.max())
            most = max(most, float(np.average(level.max() - level, weights=of_energy)))
    return most


def fit_decay(length: np.ndarray, energy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(b,) decay of energies (E, b) against `length` (E,), 1/m, and (b,) reach, m.

    The decay is the slope of a straight line through the logarithms of the energies' sums over steps of length, as
    far as these exceed exp(-RANGE) of the greatest: up to the reach. It is less where compensated sums would rise
    by more than `_RISE` (a decay with two slopes), and decay reach <= RANGE, so that exp(decay length) is finite
    in single precision however much bands differ.
    """
    step = (length / _STEP).astype(np.int64)
    decay, reach = np.zeros(energy.shape[1]), np.zeros(energy.shape[1])
    for band in range(len(decay)):
        sums = np.bincount(step, energy[:, band]) if len(step) else np.zeros(0)
        at = np.flatnonzero(sums > math.exp(-RANGE) * sums.max(initial=0.0))
        if len(at) == 0:
            continue
        reach[band] = (at[-1] + 1) * _STEP
        if len(at) > 1:
            level = np.log(sums[at] / sums.max())
            slope = np.polynomial.polynomial.polyfit(at * _STEP, level, 1)[1]
            later = at > 0
            most = ((_RISE - level[later]) / (at[later] * _STEP)).min()
            decay[band] = min(max(-slope, 0.0), most, RANGE / reach[band])
    return decay, reach
