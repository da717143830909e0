"""A renderer without a staircase: spectra that are smooth over frequency, tails without holes.

Four bands of flat noise make steps of many decibels at their edges, the same ones at all times. Here the
level of the noise is interpolated over the logarithm of frequency, linearly in dB between the bands'
centres and constant beyond them, at every time bin with node levels such that the mean over each band is
the echogram's. The noise is made in overlapping steps of half an octave, each at the rate that its width
needs and moved to its place in the frequency domain. Tails go on as in `continued`. All else (channels,
conventions, arrivals) is as in `ambisonics`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.fft

from soundspaces_sim import Echogram
from soundspaces_sim.parts import (
    SECOND_ORDER_CHANNELS as CHANNELS,
    band_shares,
    center_frequencies,
    combine_keys as combine,
    make_scratch,
    modulate_noise as modulate,
    response_length,
    response_through_air as through_air,
    response_without_air as without_air,
    transform_size,
    white_noise,
    with_arrivals,
)

_PER_OCTAVE = 2
_FLOOR = 1e-9  # of the strongest band of a time bin
_CLOSE = 1e-4  # of a band's energy: where the search for node levels ends
_MOST_STEPS = 40
LANES = 1000  # streams of noise apart from those of `ambisonics`


class _Steps(NamedTuple):
    """K overlapping steps in frequency, for B bands."""

    center: np.ndarray  # (K,) Hz
    from_bands: np.ndarray  # (K, B) weights of the bands' nodes in a step's level
    mean: np.ndarray  # (B, K) share of each step in the mean over a band


def _hats(center: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """(K, n) power of the steps, squared cosines over log frequency that sum to one everywhere."""
    x = np.log(np.maximum(frequency, 1e-9))
    place = np.interp(x, np.log(center), np.arange(len(center)))
    away = np.abs(place[None] - np.arange(len(center))[:, None])
    return np.asarray(np.cos(0.5 * np.pi * np.minimum(away, 1.0)) ** 2)


@lru_cache(maxsize=8)
def _steps(bands: tuple[float, ...]) -> _Steps:
    node = np.log2(center_frequencies(bands))
    count = int(np.ceil((node[-1] - node[0]) * _PER_OCTAVE)) + 1
    center = np.linspace(node[0], node[-1], count)
    from_bands = np.stack([np.interp(center, node, row) for row in np.eye(len(node))], axis=1)
    mean = np.empty((len(node), count))
    for b in range(len(node)):
        inside = bands[b] + (np.arange(4096) + 0.5) * ((bands[b + 1] - bands[b]) / 4096)
        mean[b] = _hats(2.0**center, inside).mean(axis=1)
    return _Steps(2.0**center, from_bands, mean)


def step_energies(energy: np.ndarray, bands: tuple[float, ...]) -> np.ndarray:
    """(t, K) energies of the steps such that their means over the bands are `energy` (t, B), to a floor of
    90 dB under the strongest: Newton's method for the logarithms of the node levels."""
    steps = _steps(bands)
    out = np.zeros((len(energy), len(steps.center)))
    rows = np.flatnonzero(energy.max(axis=1) > 0.0)
    wanted = energy[rows].astype(float)
    wanted = np.log(np.maximum(wanted, _FLOOR * wanted.max(axis=1, keepdims=True)))
    level, count = wanted.copy(), len(steps.mean)
    # d mean_b / d node_c = sum_k mean_bk one_k from_bands_kc
    share = np.einsum("bk,kc->kbc", steps.mean, steps.from_bands).reshape(-1, count * count)
    for _ in range(_MOST_STEPS):
        one = np.exp(level @ steps.from_bands.T)
        means = one @ steps.mean.T
        error = wanted - np.log(means)
        open_ = np.flatnonzero(np.abs(error).max(axis=1) > _CLOSE)
        if len(open_) == 0:
            break
        slope = (one[open_] @ share).reshape(-1, count, count) / means[open_][:, :, None]
        move = np.linalg.solve(slope, error[open_][:, :, None])[:, :, 0]
        level[open_] += np.clip(move, -4.0, 4.0)
    out[rows] = np.exp(level @ steps.from_bands.T)
    return out


def smooth_rir(echogram: Echogram, rate: int = 44100, seed: int = 0) -> np.ndarray:
    """(9, n) float32 room impulse response at `rate` Hz, world axes, ACN/SN3D.

    Arguments and errors as `ambisonics.ambisonic_rir`.
    """
    n = response_length(echogram, rate)
    size = transform_size(n, rate)
    bands = echogram.bands
    table = continued(without_air(echogram).energy, echogram.time_edges)
    made = energies(table, bands)
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    spectrum = np.zeros((CHANNELS, len(frequency)), np.complex64)
    for k, (first, last, step, gain) in enumerate(step_plans(bands, int(rate), size)):
        spectrum[:, first:last] += gain * _noise(
            made[k], echogram.time_edges, size // step, step / rate, seed, k, last - first
        )
    out = np.ascontiguousarray(scipy.fft.irfft(spectrum, size, overwrite_x=True)[:, :n], np.float32)
    return with_arrivals(through_air(out, echogram.air, rate), echogram, rate)


def energies(table: np.ndarray, bands: tuple[float, ...]) -> np.ndarray:
    """(K, t, 9) float32 energies and moments of the steps, of those of the bands (t, 9, B) without holes."""
    out = _ratios(table, bands)
    out *= step_energies(table[:, 0], bands)[:, None]
    return np.ascontiguousarray(out.transpose(2, 0, 1), np.float32)


def _ratios(table: np.ndarray, bands: tuple[float, ...]) -> np.ndarray:
    """(t, 9, K) moments over energy of each step: between those of the bands beside it that have any."""
    total = table[:, :1]
    ratio = np.divide(table, total, out=np.zeros_like(table), where=total > 0.0)
    weight = (total[:, 0] > 0.0)[:, None, :] * _steps(bands).from_bands[None]  # (t, K, B)
    whole = weight.sum(axis=2, keepdims=True)
    # a step between two bands without energy is 90 dB down: diffuse
    weight = np.divide(weight, whole, out=np.zeros_like(weight), where=whole > 0.0)
    out = np.matmul(ratio, weight.transpose(0, 2, 1))
    out[:, 0] = 1.0
    return np.asarray(out)


@lru_cache(maxsize=32)
def step_plans(
    bands: tuple[float, ...], rate: int, size: int
) -> tuple[tuple[int, int, int, np.ndarray], ...]:
    """For each step: first and last bin of its place, every how many samples it is made, its gains."""
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    # shares end where the bands do, and at Nyquist
    shares = _hats(_steps(bands).center, frequency) * band_shares(bands, frequency, rate).sum(axis=0)
    plans = []
    for share in shares:
        inside = np.flatnonzero(share > 1e-12)
        first, last = (int(inside[0]), int(inside[-1]) + 1) if len(inside) else (0, 0)
        step = 1
        while step < 64 and (last - first) * 2 * step < size // 2:
            step *= 2
        plans.append((first, last, step, np.sqrt(share[first:last]).astype(np.float32)))
    return tuple(plans)


def _noise(
    energy: np.ndarray, edges: np.ndarray, samples: int, dt: float, seed: int, k: int, bins: int
) -> np.ndarray:
    """(9, bins) lowest bins of the spectrum of noise that carries `energy` (t, 9)."""
    noise = white_noise()
    stream = combine(np.uint64(combine(np.uint64(seed % 2**64), LANES)), k)
    start, lane = int(stream % np.uint64(len(noise))), len(noise) // CHANNELS
    made = np.empty((CHANNELS, samples), np.float32)
    modulate(made, energy, edges, dt, noise, start, lane, make_scratch())
    return np.asarray(scipy.fft.rfft(made, overwrite_x=True)[:, :bins])


# Continuation of the tail of an echogram over empty bins.
#
# Late in a decay few simulated paths are left, and bins with energy stand between empty ones, which would be
# rendered as isolated bursts of noise. From a band's first empty bin on, once all but a thousandth of its energy
# has arrived, energy and moments of a few filled bins and the gaps between them are spread along the band's own
# decay, the last of them to the end of the time grid. The energy of every such group stays as it is.

_LATE = 1e-3  # share of a band's energy that may be spread
_FIT = (0.3, 1e-3)  # shares left between which the decay is fitted, about -5 to -30 dB
_FILLED = 4  # bins with energy in a group


def continued(energy: np.ndarray, time_edges: np.ndarray) -> np.ndarray:
    """(bins, 9, b) energies and moments without holes in their tails; `time_edges` (bins + 1,) s."""
    out = energy.copy()
    for band in range(energy.shape[2]):
        _continue(out[:, :, band], np.asarray(time_edges, float))
    return out


def _continue(energy: np.ndarray, edges: np.ndarray) -> None:
    """In place, one band (bins, 9)."""
    total = energy[:, 0].astype(float)
    left = total[::-1].cumsum()[::-1]  # from each bin on
    if not left[0] > 0.0:
        return
    left /= left[0]
    filled = total > 0.0
    start = np.flatnonzero((left < _LATE) & ~filled)
    rate = _decay(left, edges)
    if len(start) == 0 or rate is None or not filled[start[0] :].any():
        return
    first = int(start[0])
    before: np.ndarray = np.cumsum(filled[first:]) - filled[first:]
    group = before // _FILLED
    last = int(group[filled[first:]].max())
    if last > 0 and filled[first:][group == last].sum() < _FILLED:
        last -= 1
    group = np.minimum(group, last)
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    low, high = edges[first:-1], edges[first + 1 :]
    origin = low[starts][group]
    weight = np.exp(-rate * (low - origin)) - np.exp(-rate * (high - origin))
    weight /= np.add.reduceat(weight, starts)[group]
    sums = np.add.reduceat(energy[first:].astype(float), starts, axis=0)
    energy[first:] = weight[:, None] * sums[group]


def _decay(left: np.ndarray, edges: np.ndarray) -> float | None:
    """Rate in 1/s at which the share that is left falls, or None if fewer than three bins are left to fit."""
    use = (left <= _FIT[0]) & (left >= _FIT[1])
    if use.sum() < 3:
        return None
    slope = float(np.polyfit(edges[:-1][use], np.log(left[use]), 1)[0])
    return -slope if slope < 0.0 else None
