"""Formulas that pyroomacoustics has beside its rooms: absorption of a time, time of a response, plane arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from soundspaces_sim.rlr.errors import RlrError
from soundspaces_sim.rlr.pyroom_scene import C


def inverse_sabine(rt60: float, room_dim: Sequence[float], c: float | None = None) -> tuple[float, int]:
    """The absorption of all walls that gives a shoebox a reverberation time by Sabine's formula, and the order of
    image sources that reaches as far. Raises ValueError for no such absorption, as pyroomacoustics does."""
    size, speed = np.array(room_dim, float), c or C
    pairs = list(combinations(range(len(size)), 2))
    surface = 2.0 * sum(size[i] * size[j] for i, j in pairs)
    absorption = 24.0 * math.log(10.0) / speed * float(size.prod()) / (surface * rt60)
    if not 0.0 < absorption <= 1.0:
        raise ValueError(f"inverse_sabine: a room of {list(room_dim)} m cannot have {rt60} s")
    least = min(size[i] * size[j] / math.hypot(size[i], size[j]) for i, j in pairs)
    return absorption, math.ceil(speed * rt60 / least - 1)


def measure_rt60(
    h: np.ndarray,
    fs: float = 1.0,
    decay_db: float = 60.0,
    energy_thres: float = 1.0,
    plot: bool = False,
    rt60_tgt: float | None = None,
) -> float:
    """Reverberation time of a response (n,), s: Schroeder's integral from 5 dB below its level to `decay_db` below
    that, or as far as it gets, extrapolated to 60 dB. NaN of silence. `energy_thres`: the share of the energy that
    counts, from the beginning on. `rt60_tgt` belongs to plots, which there are none of. Raises `RlrError`.
    """
    del rt60_tgt
    if plot:
        raise RlrError("measure_rt60: there are no plots here; soundspaces_sim.viz has them")
    samples = np.asarray(h, float)
    if not (np.isfinite(samples).all() and 0.0 < fs < math.inf and 0.0 < decay_db < math.inf):
        raise RlrError("measure_rt60: expected finite samples, and fs and decay_db above 0")
    if not 0.0 < energy_thres <= 1.0:
        raise RlrError(f"measure_rt60: energy_thres: expected a share above 0, got {energy_thres!r}")
    power = np.cumsum(samples[::-1] ** 2)[::-1]
    power = power - (1.0 - energy_thres) * power[:1]
    power = power[power > 0.0]
    if not len(power):
        return math.nan
    level = 10.0 * np.log10(power / power[0])
    begin = int((level < -5.0).argmax())
    reached = min(decay_db, -5.0 - float(level.min()))
    end = int((level <= -5.0 - reached).argmax())
    return 60.0 / reached * (end - begin) / fs if reached > 0.0 and end > begin else math.nan


def linear_2D_array(center: Any, M: int, phi: float, d: float) -> np.ndarray:  # noqa: N802, N803
    """(2, M) places on a line at an angle `phi` rad, `d` m apart."""
    along = d * (np.arange(M) - 0.5 * (M - 1))
    return np.asarray(center, float)[:, None] + np.outer([math.cos(phi), math.sin(phi)], along)


def circular_2D_array(center: Any, M: int, phi0: float, radius: float) -> np.ndarray:  # noqa: N802, N803
    """(2, M) places on a circle, the first at an angle `phi0` rad."""
    angle = phi0 + 2.0 * math.pi * np.arange(M) / M
    return np.asarray(center, float)[:, None] + radius * np.array([np.cos(angle), np.sin(angle)])
