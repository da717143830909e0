"""The wavelet transform "à trous" of binned energies, and shrinkage of its details by the noise in them.

A scale is the one before convolved with the B3 spline of nodes 2^j bins apart (Starck & Murtagh 1994). Details
are the difference of two scales, both relative to the decay f at that scale. Their shrinkage is firm (Gao & Bruce
1997): all of the details stay where noise makes little of their energy, none where it makes most of it, a share
in between. Energies are pooled over the bins around, and over a few near ones, which a single echo fills.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part

_RETAIN, _REMOVE = 0.15, 0.6  # share of noise up to which details stay, and from which on they go
_AROUND = 6  # bins on either side over which a share is pooled, for each bin of the scale
_NEAR = 1  # … of a single echo, which would be lost among them


class ScaleBins(NamedTuple):
    """Bins at one scale: E energy, D noise, f decay, h_j the scale's kernel."""

    energy: np.ndarray  # (bins, 9 b) h_j ∗ E, channels times bands
    noise: np.ndarray  # (bins, b) h_j ∗ D
    decay: np.ndarray  # (bins, b) h_j ∗ f
    retained: np.ndarray  # (bins, b) share of the details at this scale that stays


class RunningSums(NamedTuple):
    """Scratch for n bins."""

    detail: np.ndarray  # (n + 1,) of squared details
    noise: np.ndarray  # (n + 1,) of the noise in them


@part(forceinline=True)
def _mirrored(i: int, n: int) -> int:
    """Number of a bin among `n` whose ends are mirrors."""
    while i < 0 or i >= n:
        i = -1 - i if i < 0 else 2 * n - 1 - i
    return i


@part
def convolve_spline(source: np.ndarray, target: np.ndarray, n: int, step: int) -> None:
    """Convolve `n` rows with the B3 spline (1, 4, 6, 4, 1) / 16, of nodes `step` apart."""
    for t in range(n):
        before, after = _mirrored(t - step, n), _mirrored(t + step, n)
        first, last = _mirrored(t - 2 * step, n), _mirrored(t + 2 * step, n)
        for k in range(source.shape[1]):
            target[t, k] = (
                0.375 * source[t, k]
                + 0.25 * (source[before, k] + source[after, k])
                + 0.0625 * (source[first, k] + source[last, k])
            )


@part(forceinline=True)
def _firm_shrinkage(noise: float, energy: float) -> float:
    """The share of details that stays, by their energy and the noise in it."""
    if energy <= 0.0:
        return 1.0
    return min(max((_REMOVE - noise / energy) / (_REMOVE - _RETAIN), 0.0), 1.0)


@part
def shrink(
    running: RunningSums, fine: ScaleBins, coarse: ScaleBins, n: int, step: int, noisy: float, b: int
) -> None:
    """How much of the details between `fine` and `coarse` stays in band `b`: to `coarse.retained`.

    `noisy`: part of the difference's energy that is noise.
    """
    details, noises = running.detail, running.noise
    details[0], noises[0] = 0.0, 0.0
    for t in range(n):
        f, g = fine.decay[t, b], coarse.decay[t, b]
        detail = fine.energy[t, b] / f - coarse.energy[t, b] / g
        noise = fine.noise[t, b] / f - coarse.noise[t, b] / g
        details[t + 1] = details[t] + detail * detail
        noises[t + 1] = noises[t] + noisy * noise * noise
    for t in range(n):
        start, end = max(t - 2 * _AROUND * step, 0), min(t + 2 * _AROUND * step + 1, n)
        noise = noises[end] - noises[start]
        retained = _firm_shrinkage(noise, details[end] - details[start])
        mean = noise / (end - start)
        start, end = max(t - 2 * _NEAR * step, 0), min(t + 2 * _NEAR * step + 1, n)
        noise = max(noises[end] - noises[start], mean * (end - start))
        retained = max(retained, _firm_shrinkage(noise, details[end] - details[start]))
        coarse.retained[t, b] = max(retained, fine.retained[t, b])


@part
def add_retained(
    fine: ScaleBins,
    coarse: ScaleBins,
    decay: np.ndarray,
    low: int,
    n: int,
    weight: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add f S_j, times the share of it that is retained at the next scale and not at this one, to the `n` bins of
    `out` (T, 9 b) from `low` on. `decay` (T, b): f. `weight` (b,) is scratch."""
    bands = decay.shape[1]
    for t in range(n):
        some = False
        for b in range(bands):
            more = coarse.retained[t, b] - fine.retained[t, b]
            weight[b] = more * decay[low + t, b] / fine.decay[t, b]
            some |= more > 0.0
        if some:
            for c in range(out.shape[1] // bands):
                for b in range(bands):
                    out[low + t, c * bands + b] += weight[b] * fine.energy[t, c * bands + b]
