"""Second-order ambisonics: echogram to pressure.

Conventions: ACN channel order, SN3D normalisation (AmbiX); X front = +x of the scene, Y left, Z up, in
world axes; channel 0 is the omnidirectional pressure. A direct sound of energy E has amplitude sqrt(E).

Reverberation is white noise under the envelope sqrt(E_b(t)), cut to band b afterwards. A plane wave
spreads its energy E over the 2 n + 1 channels of order n so that they sum to E. Where a time bin holds
several arrivals the moments S_nm average towards zero and miss part of it; the rest is diffuse and gets
noise of its own:

    a_nm(t) = sqrt(E) * (S_nm / E) * noise_0 + rest_nm

The moments of order 2 determine the covariance of the channels of order 1 (a product of two directions
is of order 2), so that is kept exactly. Of order 2 only the sum is known: each of its channels gets
sqrt(E (1 - sum_m (S_2m / E)^2) / 5) * noise_2m.

Low bands are made at a low rate: the noise of a band needs no more samples than the band has room for,
and the cut to the band, in the frequency domain, brings it to the full rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.fft

from soundspaces_sim.core.config import check_rate
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.axes import CHANNELS, spherical_harmonics
from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.core.numerics.threads import core_count, renderer_count
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.filters import arrival_filters, band_shares, white_noise
from soundspaces_sim.rendering.air import through_air, without_air
from soundspaces_sim.rendering.harmonics import harmonics_sn3d
from soundspaces_sim.rendering.low_band import below, combined
from soundspaces_sim.rendering.synthesis import make_scratch, modulate, place

_COARSE = 64  # lowest rate, as a part of the full one
_PAD_S = 0.1  # room for the band filters to ring, so that nothing comes back around


def ambisonic_rir(echogram: Echogram, rate: int = 44100, seed: int = 0) -> np.ndarray:
    """(9, n) float32 room impulse response at `rate` Hz, world axes, ACN/SN3D.

    The noise is a function of `seed` alone. n covers the echogram's duration and its last arrival.
    Raises `ConfigError` for a rate outside 8 to 192 kHz.
    """
    out = _reverberation(without_air(echogram), response_length(echogram, rate), rate, seed)
    return with_arrivals(through_air(out, echogram.air, rate), echogram, rate)


def ambisonic_rirs(
    echograms: Sequence[Echogram],
    rate: int = 44100,
    seeds: Sequence[int] = (),
    workers: int | None = None,
) -> list[np.ndarray]:
    """`ambisonic_rir` of many echograms, the same samples, in `workers` threads (one per core, at most
    four).

    `seeds`: one per echogram; by default 0, 1, 2 and so on.
    """
    seeds = seeds or range(len(echograms))
    if len(seeds) != len(echograms):
        raise ConfigError(f"seeds: expected one per echogram ({len(echograms)}), got {len(seeds)}")
    with ThreadPoolExecutor(workers or renderer_count(core_count())) as pool:
        return list(pool.map(lambda e, s: ambisonic_rir(e, rate, s), echograms, seeds))


def pair_seed(seed: int, source: int, listener: int) -> int:
    """Seed of the noise of a dataset's pair: a function of the dataset's seed and the points alone."""
    return int(combine(np.uint64(combine(np.uint64(seed), source)), listener))


def response_length(echogram: Echogram, rate: int) -> int:
    """Samples of an echogram's response. Raises `ConfigError` for a rate that cannot be rendered."""
    check_rate(rate)
    end = max([float(echogram.time_edges[-1])] + [a.delay + 0.01 for a in echogram.arrivals])
    return math.ceil(end * rate)


def transform_size(n: int, rate: int) -> int:
    """Samples of the transform of a response of n samples: a multiple of `_COARSE`, with room to ring."""
    return _COARSE * int(scipy.fft.next_fast_len(math.ceil((n + _PAD_S * rate) / _COARSE), real=True))


class BandPlan(NamedTuple):
    """How one band is made: every `step`-th sample, then bins `first` to `last` times `gain`."""

    step: int
    first: int
    last: int
    gain: np.ndarray


@lru_cache(maxsize=32)
def band_plans(bands: tuple[float, ...], rate: int, n: int) -> tuple[int, tuple[BandPlan, ...]]:
    """(samples of the transform, a plan per band) for a response of n samples."""
    size = transform_size(n, rate)
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    plans = []
    for share in band_shares(bands, frequency, rate):
        inside = np.flatnonzero(share > 1e-12)
        first, last = (int(inside[0]), int(inside[-1]) + 1) if len(inside) else (0, 0)
        step = 1
        while step < _COARSE and last * 2 * step < size // 2:
            step *= 2
        plans.append(BandPlan(step, first, last, np.sqrt(share[first:last]).astype(np.float32)))
    return size, tuple(plans)


def _reverberation(echogram: Echogram, n: int, rate: int, seed: int) -> np.ndarray:
    size, plans = band_plans(echogram.bands, int(rate), n)
    parts = [_band_spectrum(echogram, b, plan, size, rate, seed) for b, plan in enumerate(plans)]
    spectrum = np.zeros((CHANNELS, size // 2 + 1), np.complex64) if plans[-1].step > 1 else parts.pop()
    for plan, part in zip(plans, parts, strict=False):
        spectrum[:, plan.first : plan.last] += part[:, plan.first : plan.last]
    return np.ascontiguousarray(scipy.fft.irfft(spectrum, size, overwrite_x=True)[:, :n], np.float32)


def _band_spectrum(
    echogram: Echogram, b: int, plan: BandPlan, size: int, rate: int, seed: int
) -> np.ndarray:
    """(9, size / step / 2 + 1) spectrum of band b's noise; zero outside the band."""
    noise = white_noise()
    start = int(combine(np.uint64(combine(np.uint64(seed % 2**64), 1)), b) % np.uint64(len(noise)))
    lane = len(noise) // CHANNELS  # channels read the same noise far apart
    samples = np.empty((CHANNELS, size // plan.step), np.float32)
    energy = np.ascontiguousarray(echogram.energy[:, :, b])
    modulate(samples, energy, echogram.time_edges, plan.step / rate, noise, start, lane, make_scratch())
    spectrum = np.asarray(scipy.fft.rfft(samples, overwrite_x=True))
    spectrum[:, plan.first : plan.last] *= plan.gain
    spectrum[:, : plan.first], spectrum[:, plan.last :] = 0.0, 0.0
    return spectrum


def with_arrivals(reverberation: np.ndarray, echogram: Echogram, rate: int) -> np.ndarray:
    """(C, n) float32: the whole response of which `reverberation` (C, n) is all but discrete arrivals and waves. It
    is used up."""
    low = echogram.low
    if low is None:
        add_arrivals(reverberation, echogram, rate)
        return reverberation
    discrete = np.zeros_like(reverberation)
    add_arrivals(discrete, echogram, rate)
    waves = below(low, reverberation.shape, rate)
    return combined(reverberation, discrete, waves, low.edge, rate)


def add_arrivals(out: np.ndarray, echogram: Echogram, rate: int) -> None:
    """Add the discrete arrivals to a (channels, n) float32 response of order 2 or another."""
    arrivals = echogram.arrivals
    if not arrivals:
        return
    responses, starts = arrival_filters(
        np.array([a.energy for a in arrivals]),
        np.array([a.delay for a in arrivals]),
        echogram.bands,
        int(rate),
        echogram.air,
    )
    directions = np.array([a.direction for a in arrivals])
    if len(out) == CHANNELS:
        harmonics = spherical_harmonics(directions)
        harmonics[~directions.any(axis=1)] = np.eye(CHANNELS)[0]  # no direction: omnidirectional
    else:
        harmonics = harmonics_sn3d(directions, math.isqrt(len(out)) - 1)
    place(out, responses, starts, harmonics.astype(np.float32))
