"""Kernels that turn energy into pressure: noise with given energies and directions, plane waves, filtered arrivals.

Conventions: ambisonic channels in ACN order, SN3D (`ambisonics` derives the formulas); times in s; `out` float32.
Noise is read from a periodic table of white noise whose length is a power of two (`filters.white_noise`).
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part

_LEAST_VARIANCE = 1e-6  # of a channel's own noise, relative: below it, what rounding leaves of nothing


class NoiseGains(NamedTuple):
    """Amplitudes of a sample's noises, for nine channels."""

    shared: np.ndarray  # (9,) of the noise that all channels share: sqrt(E) S_nm / E
    # (3, 3) lower triangular, of own noises of Y, Z, X: a Cholesky factor of their covariance
    first: np.ndarray
    second: np.ndarray  # (1,) of the own noise of each channel of order 2


class ModulationScratch(NamedTuple):
    """What `modulate` works in."""

    moments: np.ndarray  # (9,)
    gains: NoiseGains


def make_scratch() -> ModulationScratch:
    """For `modulate`."""
    shared, first, second = (np.zeros(shape, np.float32) for shape in (9, (3, 3), 1))
    return ModulationScratch(np.empty(9), NoiseGains(shared, first, second))


@kernel
def modulate(
    out: np.ndarray,
    energy: np.ndarray,
    edges: np.ndarray,
    dt: float,
    noise: np.ndarray,
    start: int,
    lane: int,
    scratch: ModulationScratch,
) -> None:
    """Fill `out` (9, n), samples `dt` s apart, with noise that carries the energy and moments of one band.

    `energy` (bins, 9) between `edges` (bins + 1,), s, is spread evenly over each bin. Channel c reads `noise` from
    `start` + c * `lane` on.
    """
    n = out.shape[1]
    bins = energy.shape[0]
    e, gain = scratch.moments, scratch.gains
    k, t = 0, 0
    while t < n:
        low, high = max((t - 0.5) * dt, edges[0]), (t + 0.5) * dt
        while k < bins and edges[k + 1] <= low:
            k += 1
        end = t + 1
        if k < bins and high <= edges[k + 1] and low < high:  # within one bin
            share = (high - low) / (edges[k + 1] - edges[k])
            for c in range(9):
                e[c] = share * energy[k, c]
            if t > 0:  # of the first sample only a half lies behind the first edge
                while end < n and (end + 0.5) * dt <= edges[k + 1]:
                    end += 1
        else:
            e[:] = 0.0
            j = k
            while j < bins and edges[j] < high:
                share = (min(high, edges[j + 1]) - max(low, edges[j])) / (edges[j + 1] - edges[j])
                for c in range(9):
                    e[c] += share * energy[j, c]
                j += 1
        _set_gains(e, gain)
        _fill_alike(out, t, end, noise, start, lane, gain)
        t = end


@part
def _fill_alike(
    out: np.ndarray, t: int, end: int, noise: np.ndarray, start: int, lane: int, gain: NoiseGains
) -> None:
    """Samples `t` to `end` of `modulate`, which have the same gains: channel by channel, in stretches in which no
    channel passes the end of the table. Unsigned indices let the compiler use vectors."""
    mask = len(noise) - 1
    shared, first, second = gain.shared, gain.first, gain.second[0]
    while t < end:
        length = end - t
        for c in range(9):
            length = min(length, len(noise) - ((start + t + c * lane) & mask))
        i, to, some = start + t, np.uintp(t), np.uintp(length)
        w, y = np.uintp(i & mask), np.uintp((i + lane) & mask)
        z, x = np.uintp((i + 2 * lane) & mask), np.uintp((i + 3 * lane) & mask)
        g = shared[0]
        for j in range(some):
            out[0, to + j] = g * noise[w + j]
        g, a = shared[1], first[0, 0]
        for j in range(some):
            out[1, to + j] = g * noise[w + j] + a * noise[y + j]
        g, a, b = shared[2], first[1, 0], first[1, 1]
        for j in range(some):
            out[2, to + j] = g * noise[w + j] + a * noise[y + j] + b * noise[z + j]
        g, a, b, d = shared[3], first[2, 0], first[2, 1], first[2, 2]
        for j in range(some):
            out[3, to + j] = g * noise[w + j] + a * noise[y + j] + b * noise[z + j] + d * noise[x + j]
        for c in range(4, 9):
            g, own = shared[c], np.uintp((i + c * lane) & mask)
            for j in range(some):
                out[c, to + j] = g * noise[w + j] + second * noise[own + j]
        t += length


@part
def _set_gains(e: np.ndarray, gains: NoiseGains) -> None:
    """Gains of a sample with energy and moments `e` (9,), which become ratios s = S / E.

    Own noises of Y, Z, X get the covariance that the moments of order 2 imply, mean(d d^T) - s_1 s_1^T, with d the
    directions of arrival; those of order 2 share what is left, E (1 - sum of s_2m²) / 5 each.
    """
    gains.shared[:] = 0.0
    gains.first[:] = 0.0
    gains.second[:] = 0.0
    if e[0] <= 0.0:
        return
    root, total = math.sqrt(e[0]), e[0]
    for k in range(9):
        e[k] /= total
    s, second = e, 0.0
    for k in range(9):
        gains.shared[k] = root * s[k]
        if k > 3:
            second += s[k] * s[k]
    y, z, x = s[1], s[2], s[3]
    root3 = math.sqrt(3.0)
    zz = (1.0 + 2.0 * s[6]) / 3.0
    xx, yy = 0.5 * (1.0 - zz) + s[8] / root3, 0.5 * (1.0 - zz) - s[8] / root3
    # Cholesky, rows Y, Z, X; what rounding makes negative counts as zero
    yy_own = math.sqrt(max(yy - y * y, 0.0))
    zy = (s[5] / root3 - y * z) / yy_own if yy_own * yy_own > _LEAST_VARIANCE else 0.0
    zz_own = math.sqrt(max(zz - z * z - zy * zy, 0.0))
    xy = (s[4] / root3 - x * y) / yy_own if yy_own * yy_own > _LEAST_VARIANCE else 0.0
    xz = (s[7] / root3 - x * z - zy * xy) / zz_own if zz_own * zz_own > _LEAST_VARIANCE else 0.0
    xx_own = math.sqrt(max(xx - x * x - xy * xy - xz * xz, 0.0))
    first = gains.first
    first[0, 0], first[1, 0], first[1, 1] = root * yy_own, root * zy, root * zz_own
    first[2, 0], first[2, 1], first[2, 2] = root * xy, root * xz, root * xx_own
    gains.second[0] = root * math.sqrt(max(1.0 - second, 0.0) / 5.0)


@kernel
def modulate_waves(
    out: np.ndarray,
    energy: np.ndarray,
    edges: np.ndarray,
    dt: float,
    noise: np.ndarray,
    starts: np.ndarray,
    work: tuple[np.ndarray, np.ndarray],
) -> None:
    """Fill `out` (K, n), samples `dt` s apart, with noises that carry `energy` (bins, K) between `edges` (bins +
    1,), spread evenly over each bin. Wave j reads `noise` from `starts[j]` on. `work`: (K,) float64 energies and
    (K,) float32 amplitudes, scratch.
    """
    waves, n = out.shape
    bins = energy.shape[0]
    mask = len(noise) - 1
    e, gain = work
    k, known = 0, -1
    for t in range(n):
        low, high = max((t - 0.5) * dt, edges[0]), (t + 0.5) * dt
        while k < bins and edges[k + 1] <= low:
            k += 1
        within_bin = k < bins and high <= edges[k + 1] and low < high
        if not (within_bin and known == k):  # within one bin the next sample is alike
            e[:] = 0.0
            j = k
            while j < bins and edges[j] < high:
                share = (min(high, edges[j + 1]) - max(low, edges[j])) / (edges[j + 1] - edges[j])
                for w in range(waves):
                    e[w] += share * energy[j, w]
                j += 1
            for w in range(waves):
                gain[w] = math.sqrt(max(e[w], 0.0))
            known = k if within_bin and t > 0 else -1  # the first sample: see `modulate`
        for w in range(waves):
            out[w, t] = gain[w] * noise[(starts[w] + t) & mask]


@kernel
def gather(
    out: np.ndarray,
    spectra: np.ndarray,
    first: int,
    turns: np.ndarray,
    weights: np.ndarray,
    work: tuple[np.ndarray, np.ndarray],
) -> None:
    """Add plane waves to the spectra of R receivers: out_r(f) += sum over k of w_rk exp(i φ_rk f) s_k(f).

    `out` (R, 2, F; real, imaginary), from bin `first` on; `spectra` s (K, 2, f) of the waves; `weights` w (R, K);
    `turns` φ (R, K), rad per bin. `work`: two (n,) float32, scratch.

    Phasors of n bins are made once and rotated as a whole; unsigned indices let the compiler use vectors.
    """
    cosine, sine = work
    block = len(cosine)
    chunk = 8 * block  # of the bins, so that spectra stay in the cache from row to row
    bins = spectra.shape[2]
    for begin in range(0, bins, chunk):
        end = min(begin + chunk, bins)
        for r in range(out.shape[0]):
            for k in range(spectra.shape[0]):
                t = turns[r, k]
                u, v, step_u, step_v = 1.0, 0.0, math.cos(t), math.sin(t)
                for i in range(block):
                    cosine[i], sine[i] = u, v
                    u, v = u * step_u - v * step_v, u * step_v + v * step_u
                a = weights[r, k] * math.cos(t * (first + begin))
                b = weights[r, k] * math.sin(t * (first + begin))
                for start in range(begin, end, block):
                    p, q = np.float32(a), np.float32(b)
                    here, there = np.uintp(start), np.uintp(first + start)
                    for j in range(np.uintp(min(block, end - start))):
                        i = np.uintp(j)
                        c, s = p * cosine[i] - q * sine[i], p * sine[i] + q * cosine[i]
                        x, y = spectra[k, 0, here + i], spectra[k, 1, here + i]
                        out[r, 0, there + i] += x * c - y * s
                        out[r, 1, there + i] += x * s + y * c
                    a, b = a * u - b * v, a * v + b * u


@kernel
def place(out: np.ndarray, responses: np.ndarray, starts: np.ndarray, harmonics: np.ndarray) -> None:
    """Add `responses` (A, n) to `out` (c, N), each from sample `starts` (A,) on and times its `harmonics` (A,
    c)."""
    n = out.shape[1]
    for a in range(len(starts)):
        first, last = max(0, -starts[a]), min(responses.shape[1], n - starts[a])
        if first >= last:
            continue
        here, there, length = np.uintp(first), np.uintp(starts[a] + first), np.uintp(last - first)
        for c in range(out.shape[0]):
            gain = harmonics[a, c]
            for i in range(length):
                out[c, there + i] += gain * responses[a, here + i]


@kernel
def decode(
    out: np.ndarray, spectrum: np.ndarray, matrix: np.ndarray, filters: np.ndarray, turned: np.ndarray
) -> None:
    """Two ears `out` (2, F) of a field `spectrum` (9, F), rotated by `matrix` (9, 9), through `filters` (2, 9, F).

    out_e(f) = sum over c of filters_ec(f) sum over d of matrix_cd spectrum_d(f). `turned` (F,) is scratch.
    """
    bins = spectrum.shape[1]
    out[:] = 0.0
    for c in range(9):
        order = 0 if c == 0 else (1 if c < 4 else 2)
        turned[:] = 0.0
        for d in range(
            order * order, (order + 1) * (order + 1)
        ):  # a rotation mixes channels of one order only
            m = matrix[c, d]
            if m != 0.0:
                for f in range(bins):
                    turned[f] += m * spectrum[d, f]
        for f in range(bins):
            out[0, f] += filters[0, c, f] * turned[f]
            out[1, f] += filters[1, c, f] * turned[f]
