"""Decay curves as the task `prediction` has them: in dB for 1 J emitted, in bins of 1 ms from the direct
sound's time on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.parts import BIN_S, decay_curve, energy_measures

REFERENCES = 8
SLOWEST_DB_S = 6.0  # of a predicted curve: a T60 of 10 s
LENGTH = 2048  # bins of a curve
FLOOR_DB = -60.0  # of a curve re its start
#: s after the onset, of a curve as networks have it
KNOTS_S = np.array(
    [0.0, 0.003, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.17, 0.24, 0.34, 0.48, 0.68, 0.96, 1.36]
)


class Examples(NamedTuple):
    """Of n targets of all homes with K references: decay curves (n, LENGTH) and (n, K, LENGTH) in dB, distances
    (n, 1 + 2 K) in m (source to listener; of each reference; from its source to the target's), labels (n, 3) of
    T30, C50 and EDT with their standard errors, and the row of each one's home."""

    curve: np.ndarray
    references: np.ndarray
    distances: np.ndarray
    labels: np.ndarray
    errors: np.ndarray
    home: np.ndarray


def curve_of(energy: np.ndarray) -> np.ndarray:
    """(LENGTH,) backward-integrated energy in dB of (n,) energies from the onset on; never below its start by more
    than `FLOOR_DB`."""
    fixed = np.zeros(LENGTH)
    count = min(LENGTH, len(energy))
    fixed[:count] = energy[:count]
    whole = 10.0 * np.log10(fixed.sum())
    curve = np.maximum(np.nan_to_num(decay_curve(fixed), neginf=FLOOR_DB), FLOOR_DB)
    return np.asarray(whole + curve)


def measures_of(curve: np.ndarray) -> np.ndarray:
    """(3,) T30 in s, C50 in dB and EDT in s of a decay curve (LENGTH,) in dB."""
    remaining = 10.0 ** ((curve - curve[0]) / 10.0)
    last = 10.0 ** (FLOOR_DB / 10.0)
    energy = np.maximum(-np.diff(np.append(np.maximum(remaining - last, 0.0), 0.0)), 0.0)
    found = energy_measures(energy[None], BIN_S, 0.0)
    c50 = np.clip(found.c50[0], FLOOR_DB, -FLOOR_DB)  # a curve resolves no more
    return np.array([found.t30[0], c50, found.edt[0]])


def at_knots(curves: np.ndarray) -> np.ndarray:
    """(…, knots) values of curves (…, LENGTH) at `KNOTS_S`."""
    return np.asarray(curves[..., np.minimum((KNOTS_S / BIN_S).astype(int), LENGTH - 1)])


def from_knots(knots: np.ndarray) -> np.ndarray:
    """(n, LENGTH) curves from (n, knots) values: linear between, on as the last two fall, and never slower than
    `SLOWEST_DB_S`."""
    time = np.arange(LENGTH) * BIN_S
    least = SLOWEST_DB_S * KNOTS_S
    falling = np.minimum.accumulate(knots + least, axis=1) - least
    slope = np.diff(falling[:, -2:], axis=1) / (KNOTS_S[-1] - KNOTS_S[-2])
    inside = np.stack([np.interp(time, KNOTS_S, row) for row in falling])
    curve = inside + slope * np.maximum(time - KNOTS_S[-1], 0.0)
    return np.maximum(curve, curve[:, :1] + FLOOR_DB)
