"""The seed paper's way from energy to pressure, step by step, flaws included (docs/responses.md).

SoundSpaces (Chen et al. 2020, "Acoustic simulation technique"): square roots of the energy histogram are
envelopes of band-passed white noise, summed over bands to one monaural response; ambisonics are that
response times the spherical-harmonic coefficients of each time sample; early reflections of order up to
two, clustered by plane, are added with frequency-dependent filtering. `pipelines/paper.toml` has the
histogram at the audio rate. What the paper leaves open (filters, normalisation) is as in `ambisonics`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft

from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.filters import band_shares, white_noise
from soundspaces_sim.rendering.ambisonics import response_length, with_arrivals


@lru_cache(maxsize=4)
def band_noise(bands: tuple[float, ...], rate: int) -> np.ndarray:
    """(B', n) float32: one white noise, cut into bands."""
    noise = white_noise()
    gains = np.sqrt(band_shares(bands, np.fft.rfftfreq(len(noise), 1.0 / rate), rate))
    return np.asarray(scipy.fft.irfft(scipy.fft.rfft(noise) * gains, len(noise)), np.float32)


def paper_rir(echogram: Echogram, rate: int = 44100, seed: int = 0) -> np.ndarray:
    """(9, n) float32 room impulse response as the seed paper makes it; ACN/SN3D, world axes.

    Arguments and errors as `ambisonics.ambisonic_rir`.
    """
    n = response_length(echogram, rate)
    noise = band_noise(echogram.bands, int(rate))
    energy = _per_sample(echogram, n, rate)[:, :, : len(noise)]
    start = int(combine(np.uint64(seed % 2**64), 1) % np.uint64(noise.shape[1]))
    mono = (np.sqrt(energy[:, 0]) * np.take(noise, start + np.arange(n), axis=1, mode="wrap").T).sum(
        axis=1
    )
    total = energy.sum(axis=2)  # (n, 9)
    coefficients = np.divide(total, total[:, :1], out=np.zeros_like(total), where=total[:, :1] > 0.0)
    out = np.ascontiguousarray((mono[:, None] * coefficients).T, np.float32)
    return with_arrivals(out, echogram, rate)


def _per_sample(echogram: Echogram, n: int, rate: int) -> np.ndarray:
    """(n, 9, B): the histogram at the audio rate; energy of a wider bin is spread over its samples."""
    bins = echogram.energy.reshape(len(echogram.energy), -1).astype(float)
    cumulative = np.concatenate([np.zeros((1, bins.shape[1])), np.cumsum(bins, axis=0)])
    edges = (np.arange(n + 1) - 0.5) / rate
    out = np.stack([np.interp(edges, echogram.time_edges, column) for column in cumulative.T], axis=1)
    return np.diff(out, axis=0).reshape(n, *echogram.energy.shape[1:])
