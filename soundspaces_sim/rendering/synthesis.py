"""Kernels that turn energy into pressure (see `ambisonics` for the formulas)."""

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part


@kernel
def modulate(out, energy, edges, dt, noise, start, lane, work):
    """Fill `out` (9, n), samples `dt` apart, with noise that carries the energy of one band.

    `energy` (bins, 9) between `edges` is spread evenly over each bin. Channel c reads `noise` from
    `start` + c * `lane` on. `work`: (9,) float64 and (16,) float32 to work in.
    """
    n = out.shape[1]
    bins = energy.shape[0]
    mask = len(noise) - 1  # its length is a power of two
    e, gain = work
    k, known = 0, -1
    for t in range(n):
        low, high = max((t - 0.5) * dt, edges[0]), (t + 0.5) * dt
        while k < bins and edges[k + 1] <= low:
            k += 1
        if k < bins and high <= edges[k + 1] and low < high:  # within one bin: the next sample is alike
            if known != k:
                share = (high - low) / (edges[k + 1] - edges[k])
                for c in range(9):
                    e[c] = share * energy[k, c]
                _gains(e, gain)
                known = k
        else:
            e[:] = 0.0
            j = k
            while j < bins and edges[j] < high:
                share = (min(high, edges[j + 1]) - max(low, edges[j])) / (edges[j + 1] - edges[j])
                for c in range(9):
                    e[c] += share * energy[j, c]
                j += 1
            _gains(e, gain)
            known = -1
        i = start + t
        shared = noise[i & mask]
        y = noise[(i + lane) & mask]
        z = noise[(i + 2 * lane) & mask]
        x = noise[(i + 3 * lane) & mask]
        out[0, t] = gain[0] * shared
        out[1, t] = gain[1] * shared + gain[9] * y
        out[2, t] = gain[2] * shared + gain[10] * y + gain[11] * z
        out[3, t] = gain[3] * shared + gain[12] * y + gain[13] * z + gain[14] * x
        for c in range(4, 9):
            out[c, t] = gain[c] * shared + gain[15] * noise[(i + c * lane) & mask]


@part
def _gains(e, gain):
    """Gains of a sample with energies and moments `e` (9,), which become ratios: 0 to 8 of the shared noise
    in each channel, 9 to 14 of own noise in Y, Z, X (rows of a Cholesky factor), 15 of own noise in order 2.

    Y, Z, X get the covariance that the moments of order 2 imply: mean(d d^T) - s_1 s_1^T.
    """
    gain[:] = 0.0
    if e[0] <= 0.0:
        return
    root, whole = math.sqrt(e[0]), e[0]
    for k in range(9):
        e[k] /= whole
    s, second = e, 0.0
    for k in range(9):
        gain[k] = root * s[k]
        if k > 3:
            second += s[k] * s[k]
    y, z, x = s[1], s[2], s[3]
    root3 = math.sqrt(3.0)
    zz = (1.0 + 2.0 * s[6]) / 3.0
    xx, yy = 0.5 * (1.0 - zz) + s[8] / root3, 0.5 * (1.0 - zz) - s[8] / root3
    tiny = 1e-6
    # what rounding makes negative counts as zero
    a = math.sqrt(max(yy - y * y, 0.0))
    b = (s[5] / root3 - y * z) / a if a * a > tiny else 0.0
    c = math.sqrt(max(zz - z * z - b * b, 0.0))
    d = (s[4] / root3 - x * y) / a if a * a > tiny else 0.0
    f = (s[7] / root3 - x * z - b * d) / c if c * c > tiny else 0.0
    g = math.sqrt(max(xx - x * x - d * d - f * f, 0.0))
    gain[9], gain[10], gain[11] = root * a, root * b, root * c
    gain[12], gain[13], gain[14] = root * d, root * f, root * g
    gain[15] = root * math.sqrt(max(1.0 - second, 0.0) / 5.0)


@kernel
def modulate_waves(out, energy, edges, dt, noise, starts, work):
    """Fill `out` (K, n), samples `dt` apart, with noises that carry `energy` (bins, K) between `edges`, spread
    evenly over each bin. Wave j reads `noise` from `starts[j]` on. `work`: (K,) float64 and (K,) float32 to
    work in.
    """
    waves, n = out.shape
    bins = energy.shape[0]
    mask = len(noise) - 1  # its length is a power of two
    e, gain = work
    k, known = 0, -1
    for t in range(n):
        low, high = max((t - 0.5) * dt, edges[0]), (t + 0.5) * dt
        while k < bins and edges[k + 1] <= low:
            k += 1
        whole = k < bins and high <= edges[k + 1] and low < high
        if not (whole and known == k):  # within one bin the next sample is alike
            e[:] = 0.0
            j = k
            while j < bins and edges[j] < high:
                share = (min(high, edges[j + 1]) - max(low, edges[j])) / (edges[j + 1] - edges[j])
                for w in range(waves):
                    e[w] += share * energy[j, w]
                j += 1
            for w in range(waves):
                gain[w] = math.sqrt(max(e[w], 0.0))
            known = k if whole else -1
        for w in range(waves):
            out[w, t] = gain[w] * noise[(starts[w] + t) & mask]


@kernel
def gather(out, spectra, first, turns, weights, work):
    """Add to `out` (R, 2, F; real, imaginary), from bin `first` on, waves `spectra` (K, 2, f): into row r wave k
    times weights[r, k], turned by turns[r, k] rad per bin. `work`: two (n,) float32 to work in.

    Phasors of n bins are made once and turned on as a whole; unsigned indices let the compiler use vectors.
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
def place(out, responses, starts, harmonics):
    """Add `responses` (A, n) to `out`, each from its `starts` on and times its `harmonics` (A, c)."""
    n = out.shape[1]
    for a in range(len(starts)):
        first, last = max(0, -starts[a]), min(responses.shape[1], n - starts[a])
        for c in range(out.shape[0]):
            gain = harmonics[a, c]
            for i in range(first, last):
                out[c, starts[a] + i] += gain * responses[a, i]


@kernel
def play(out, sound, first, position, gains, table):
    """Add `sound` (m,) to `out` (c, n) from sample `first` on, read at fractional samples `position` (k,) and
    times `gains` (c, k). `table`: `filters.sinc_table`."""
    phases, taps = table.shape[0] - 1, table.shape[1]
    for i in range(len(position)):
        whole = math.floor(position[i])
        row = (position[i] - whole) * phases
        k = min(int(row), phases - 1)
        mix = row - k
        start = int(whole) - taps // 2 + 1
        y = 0.0
        for j in range(max(0, -start), min(taps, len(sound) - start)):
            y += ((1.0 - mix) * table[k, j] + mix * table[k + 1, j]) * sound[start + j]
        for c in range(out.shape[0]):
            out[c, first + i] += gains[c, i] * y


@kernel
def decode(out, spectrum, matrix, filters, turned):
    """Two ears (2, F) of a field (9, F): turned by `matrix` (9, 9), then through `filters` (2, 9, F).

    `turned` (F,): to work in.
    """
    bins = spectrum.shape[1]
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
