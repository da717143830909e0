"""Kernels that turn energy into pressure: here an echogram becomes a waveform (see `ambisonics`)."""

import math

import numpy as np
from numba import njit

from soundspaces_sim.transport.rng import combine


@njit(cache=True)
def fill_reverberation(out, energy, samples_per_step, noise, seed):
    """Add noise under interpolated energy envelopes; see `ambisonics` for the formula."""
    steps, channels, bands = energy.shape
    length = noise.shape[1]
    base = int(combine(seed, 1) % np.uint64(length))
    lane = length // channels  # channels read the same noise far apart: no overlap within a response
    n = out.shape[1]
    s = np.empty(channels)
    for b in range(bands):
        for t in range(n):
            position = t / samples_per_step - 0.5
            k = int(math.floor(position))
            frac = position - k
            lo, hi = min(max(k, 0), steps - 1), min(max(k + 1, 0), steps - 1)
            e = energy[lo, 0, b] + frac * (energy[hi, 0, b] - energy[lo, 0, b])
            if e <= 0.0:
                continue
            root = math.sqrt(e / samples_per_step)
            i = (base + t) % length
            shared = noise[b, i] * root
            out[0, t] += shared
            first, second = 0.0, 0.0
            for c in range(1, channels):
                s[c] = (energy[lo, c, b] + frac * (energy[hi, c, b] - energy[lo, c, b])) / e
                if c < 4:
                    first += s[c] * s[c]
                else:
                    second += s[c] * s[c]
            diffuse1 = root * math.sqrt(max(1.0 - first, 0.0) / 3.0)
            diffuse2 = root * math.sqrt(max(1.0 - second, 0.0) / 5.0)
            for c in range(1, channels):
                own = noise[b, (i + c * lane) % length]
                out[c, t] += s[c] * shared + (diffuse1 if c < 4 else diffuse2) * own


@njit(cache=True)
def place_arrival(out, position, gains, harmonics, sinc, lowpass, half):
    """Add one arrival at a fractional sample position; see `ambisonics` for the filter."""
    n = out.shape[1]
    phases = sinc.shape[0] - 1
    whole = int(math.floor(position))
    frac = position - whole
    row = frac * phases
    k = min(int(row), phases - 1)
    mix = row - k
    top = gains[len(gains) - 1]
    for j in range(sinc.shape[1]):
        t = whole + j - sinc.shape[1] // 2 + 1
        if 0 <= t < n:
            value = top * (sinc[k, j] + mix * (sinc[k + 1, j] - sinc[k, j]))
            for c in range(len(harmonics)):
                out[c, t] += value * harmonics[c]
    for b in range(len(gains) - 1):
        step = gains[b] - gains[b + 1]
        if abs(step) <= 1e-6 * max(gains[b], gains[b + 1]):
            continue
        for j in range(-half, half + 1):
            t = whole + j
            if 0 <= t < n:
                at = (j - frac + half + 1) * 8.0
                i = int(at)
                value = step * (lowpass[b, i] + (at - i) * (lowpass[b, i + 1] - lowpass[b, i]))
                for c in range(len(harmonics)):
                    out[c, t] += value * harmonics[c]
