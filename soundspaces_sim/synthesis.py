"""Kernels that turn energy into pressure (see `ambisonics` for the formulas)."""

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def modulate(out, energy, edges, dt, noise, start, lane):
    """Fill `out` (channels, n), samples `dt` apart, with noise that carries the energy of one band.

    `energy` (bins, channels) between `edges` is spread evenly over each bin. Channel c reads `noise`
    from `start` + c * `lane` on.
    """
    channels, n = out.shape
    mask = len(noise) - 1  # its length is a power of two
    bins = energy.shape[0]
    e = np.empty(channels)
    k = 0
    for t in range(n):
        low, high = max((t - 0.5) * dt, edges[0]), (t + 0.5) * dt
        while k < bins and edges[k + 1] <= low:
            k += 1
        e[:] = 0.0
        j = k
        while j < bins and edges[j] < high:
            share = (min(high, edges[j + 1]) - max(low, edges[j])) / (edges[j + 1] - edges[j])
            if energy[j, 0] > 0.0:
                for c in range(channels):
                    e[c] += share * energy[j, c]
            j += 1
        if e[0] <= 0.0:
            out[:, t] = 0.0
            continue
        root = math.sqrt(e[0])
        shared = noise[(start + t) & mask] * root
        out[0, t] = shared
        second = 0.0
        for c in range(1, channels):
            e[c] /= e[0]
            out[c, t] = e[c] * shared
            if c > 3:
                second += e[c] * e[c]
        _add_first_order(out, t, e, root, noise, start, lane)
        rest = root * math.sqrt(max(1.0 - second, 0.0) / 5.0)
        for c in range(4, channels):
            out[c, t] += rest * noise[(start + c * lane + t) & mask]


@njit(cache=True, nogil=True, forceinline=True)
def _add_first_order(out, t, s, root, noise, start, lane):
    """Noise in Y, Z, X with the covariance that moments `s` of order 2 imply: mean(d d^T) - s_1 s_1^T."""
    mask = len(noise) - 1
    y, z, x = s[1], s[2], s[3]
    root3 = math.sqrt(3.0)
    zz = (1.0 + 2.0 * s[6]) / 3.0
    xx, yy = 0.5 * (1.0 - zz) + s[8] / root3, 0.5 * (1.0 - zz) - s[8] / root3
    tiny = 1e-6
    # Cholesky factor, row by row; what rounding makes negative counts as zero
    a = math.sqrt(max(yy - y * y, 0.0))
    b = (s[5] / root3 - y * z) / a if a * a > tiny else 0.0
    c = math.sqrt(max(zz - z * z - b * b, 0.0))
    d = (s[4] / root3 - x * y) / a if a * a > tiny else 0.0
    f = (s[7] / root3 - x * z - b * d) / c if c * c > tiny else 0.0
    g = math.sqrt(max(xx - x * x - d * d - f * f, 0.0))
    n1 = noise[(start + lane + t) & mask] * root
    n2 = noise[(start + 2 * lane + t) & mask] * root
    n3 = noise[(start + 3 * lane + t) & mask] * root
    out[1, t] += a * n1
    out[2, t] += b * n1 + c * n2
    out[3, t] += d * n1 + f * n2 + g * n3


@njit(cache=True, nogil=True)
def place(out, responses, starts, harmonics):
    """Add `responses` (A, n) to `out`, each from its `starts` on and times its `harmonics` (A, c)."""
    n = out.shape[1]
    for a in range(len(starts)):
        first, last = max(0, -starts[a]), min(responses.shape[1], n - starts[a])
        for c in range(out.shape[0]):
            gain = harmonics[a, c]
            for i in range(first, last):
                out[c, starts[a] + i] += gain * responses[a, i]


@njit(cache=True, nogil=True)
def decode(out, spectrum, matrix, filters):
    """Two ears (2, F) of a field (9, F): turned by `matrix` (9, 9), then through `filters` (2, 9, F)."""
    bins = spectrum.shape[1]
    turned = np.empty(bins, spectrum.dtype)
    out[:] = 0.0
    for c in range(9):
        order = 0 if c == 0 else (1 if c < 4 else 2)
        turned[:] = 0.0
        for d in range(order * order, (order + 1) * (order + 1)):  # orders turn among themselves
            m = matrix[c, d]
            if m != 0.0:
                for f in range(bins):
                    turned[f] += m * spectrum[d, f]
        for f in range(bins):
            out[0, f] += filters[0, c, f] * turned[f]
            out[1, f] += filters[1, c, f] * turned[f]
