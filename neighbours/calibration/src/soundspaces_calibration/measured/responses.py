"""Room measures of measured impulse responses, whose decays end in noise.

Responses are cut where the decay meets the noise (Lundeby, Vigran, Bietz & Vorländer 1995), and what would follow
is added, as an exponential decay of the slope before (ISO 3382-1:2009, 5.3.3). A time whose noise is not 10 dB
below its range is not measured.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from soundspaces_calibration.measured.collect import Collection
from soundspaces_calibration.measured.room import MEASURED, octave_edges, octaves_between
from soundspaces_sim import DatasetError
from soundspaces_sim.parts import (
    RANGES,
    band_energies,
    decay_curve,
    energy_measures,
    read_sound,
)

_OCTAVES = (125.0, 4000.0)  # of what is evaluated, ISO 3382-1
_HEADROOM_DB = 10.0
_LAST = 0.1  # of a response: noise, at first
_FIRST_S = 0.02  # intervals over which energy is averaged, at first
_PER_10_DB = 5  # intervals per 10 dB of decay, then
_TURNS = 5
_ABOVE_DB, _RANGE_DB, _BEYOND_DB = (
    6.0,
    15.0,
    8.0,
)  # of the late slope, re noise; of noise, re the crossing
_TAIL_DB = 60.0  # of decay that is added after the end
_SHORTEST_S, _HIGHEST_RATE = 0.08, 768_000.0


def read_wav(path: Path, channel: float, where: str) -> tuple[np.ndarray, float]:
    """(samples (n,), rate in Hz) of one channel, from 1 on (NaN: the only one). Raises `DatasetError`."""
    try:
        samples, rate = read_sound(path, DatasetError)
    except DatasetError as error:
        raise DatasetError(f"{where}: {error}") from error
    count = samples.shape[1]
    if math.isnan(channel):
        if count != 1:
            raise DatasetError(
                f"{where}: {path} has {count} channels; say which in a column `channel`, from 1 on"
            )
        channel = 1.0
    if not (1 <= channel <= count and channel == int(channel)):
        raise DatasetError(f"{where}: expected a channel from 1 to {count}, got {channel:g}")
    return samples[:, int(channel) - 1], float(rate)


def add_response(
    out: Collection, pair: tuple[int, int], response: np.ndarray, rate: float, where: str
) -> None:
    """Add what a response (n,) at `rate` Hz tells. Raises `DatasetError`."""
    if not (np.isfinite(response).all() and np.abs(response).max(initial=0.0) > 0.0):
        raise DatasetError(f"{where}: this response is silent, or not finite")
    if not 2.0 * octave_edges(_OCTAVES[:1])[1] < rate <= _HIGHEST_RATE:
        raise DatasetError(
            f"{where}: expected a rate that holds the octave of 125 Hz, up to {_HIGHEST_RATE:g} Hz, got {rate:g} Hz"
        )
    after = (len(response) - int(np.abs(response).argmax())) / rate
    if not after >= _SHORTEST_S:
        raise DatasetError(
            f"{where}: this response ends {1e3 * after:.0f} ms after its peak; expected {1e3 * _SHORTEST_S:.0f} ms "
            "or more, which C80 needs"
        )
    octaves = octaves_between(*_OCTAVES)
    octaves = tuple(f for f in octaves if octave_edges((f,))[1] <= 0.5 * rate)
    found = response_measures(response, rate, octave_edges(octaves))
    for k, octave in enumerate(octaves):
        out.add(pair, octave, found[:, k], np.full(len(MEASURED), np.nan), where)


def response_measures(response: np.ndarray, rate: float, edges: tuple[float, ...]) -> np.ndarray:
    """(measures, K) of `MEASURED` in bands between `edges` (K + 1,) Hz; NaN where noise hides a measure."""
    bands = (0.5 * edges[0], *edges)  # what is below the lowest one is cut off as well
    energy, onset = band_energies(response, rate, bands)
    out = np.full((len(MEASURED), len(edges) - 1), np.nan)
    for b in range(out.shape[1]):
        decay, reached = without_noise(energy[b + 1, onset:], rate)
        found = energy_measures(decay[None], 1.0 / rate, 0.0)
        for k, name in enumerate(MEASURED):
            lower = {n.lower(): low for n, _, low in RANGES}.get(name, -_HEADROOM_DB)
            if reached <= lower - _HEADROOM_DB:
                out[k, b] = getattr(found, name)[0]
    return out


def without_noise(energy: np.ndarray, rate: float) -> tuple[np.ndarray, float]:
    """Energies (n,) from the onset on without the noise in which they end, continued by `_TAIL_DB`; and the level
    of the backward-integrated decay where noise was met, dB re the total: 0 where no decay is found."""
    crossing, slope, noise = _crossing(energy, 1.0 / rate)
    if not (slope < 0.0 and crossing * rate >= 8.0):
        return energy, 0.0
    cut = min(int(crossing * rate), len(energy))
    clean = energy[:cut] - noise
    fall = slope * np.log(10.0) / 10.0 / rate  # nepers per sample
    before = min(max(round(-_RANGE_DB / slope * rate), 1), cut)
    course = np.exp(fall * (np.arange(before) - before))
    end = max(clean[cut - before :].sum() / course.sum(), 0.0)  # what decays there, at the crossing
    tail = end * np.exp(fall * np.arange(round(-_TAIL_DB / slope * rate)))
    whole = np.concatenate([clean, tail])
    with np.errstate(invalid="ignore"):
        reached = float(decay_curve(whole)[cut])
    return whole, reached if np.isfinite(reached) else 0.0


def _crossing(energy: np.ndarray, step: float) -> tuple[float, float, float]:
    """(s, dB/s, energy of a sample): where the decay of energies (n,) meets their noise, how it falls there (0: not
    at all), and the noise."""
    total = len(energy) * step
    noise = float(energy[int((1.0 - _LAST) * len(energy)) :].mean())
    width = _FIRST_S
    crossing, slope = total, 0.0
    for turn in range(_TURNS + 1):
        time, level = _averages(energy, step, width)
        floor = 10.0 * np.log10(noise) if noise > 0.0 else -np.inf
        if turn:
            above = (crossing - time) * -slope  # dB above the noise
            use = (above >= _ABOVE_DB) & (above <= _ABOVE_DB + _RANGE_DB) & np.isfinite(level)
        else:
            peak = int(np.argmax(level))
            under = np.flatnonzero(level[peak:] < floor + _ABOVE_DB)
            last = peak + (under[0] if len(under) else len(level))
            use = (np.arange(len(level)) >= peak) & (np.arange(len(level)) < last) & np.isfinite(level)
        if use.sum() < 3:
            break
        fitted, offset = np.polyfit(time[use], level[use], 1)
        if not fitted < 0.0:
            return total, 0.0, noise
        slope = float(fitted)
        crossing = min((floor - offset) / slope if np.isfinite(floor) else total, total)
        width = min(-10.0 / slope / _PER_10_DB, 0.1 * total)
        first = min(crossing - _BEYOND_DB / slope, (1.0 - _LAST) * total)
        noise = float(energy[int(first / step) :].mean())
    return crossing, slope, noise


def _averages(energy: np.ndarray, step: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """(s, dB) middles and levels of intervals of about `width`."""
    each = max(round(width / step), 1)
    count = len(energy) // each
    means = energy[: count * each].reshape(count, each).mean(axis=1)
    with np.errstate(divide="ignore"):
        return (np.arange(count) + 0.5) * each * step, 10.0 * np.log10(means)
