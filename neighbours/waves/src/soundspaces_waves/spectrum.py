"""From what the lattice records to responses: its frequencies put right, the source's pulse divided out, air.

The response at frequency f is the record's transform at the lattice's frequency for f (`dispersion`) over that
of the pulse. Air attenuates by exp(-m(f) c t / 2): the transform is taken at a complex frequency, which moves
every pole by it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.parts import (
    Air,
    check_memory,
    lead_samples,
    low_band_gain as band_gain,
    response_rate,
    response_samples,
)
from soundspaces_waves.dispersion import amplitude_factor, lattice_frequency
from soundspaces_waves.placing import ROWS

_PAD_S = 0.15  # room for what the ends of the band spread over time
_FADE_S = 0.05  # of the record's end
_CENTRE = 5.0  # of the pulse, in its widths
_OF_EDGE = 0.8  # frequency of the pulse's largest amplitude over the edge
_COLUMNS = (
    32  # of one matrix product: BLAS adds in another order for another shape; and rows made at once
)


class Transform(NamedTuple):
    """(2 k, steps) float32 of records into spectra at k frequencies, real parts above imaginary ones."""

    matrix: np.ndarray
    frequency: np.ndarray  # (k,) Hz
    bins: np.ndarray  # (k,) of the response's transform
    size: int  # of the response's transform
    rate: float  # Hz, of the response
    samples: int  # of the response


def pulse(edge: float, step: float) -> np.ndarray:
    """(n,) second derivative of a Gaussian, sampled: little beyond twice the edge.

    Its ends are cut; what that leaves in the sum is taken off, or the source would go on to blow air into the room
    and the pressure in a sealed one would rise for ever.
    """
    width = np.sqrt(2.0) / (2.0 * np.pi * _OF_EDGE * edge)
    t = np.arange(int(np.ceil(2.0 * _CENTRE * width / step))) * step
    x = (t - _CENTRE * width) / width
    bell = np.exp(-0.5 * x**2)
    out = (1.0 - x**2) * bell
    return np.asarray(out - bell * (out.sum() / bell.sum()))


def record_steps(edge: float, duration: float, step: float) -> int:
    """Steps to run for responses of `duration` s."""
    return int(np.ceil((1.05 * duration + _FADE_S) / step)) + len(pulse(edge, step))


def make_transform(
    edge: float, duration: float, steps: int, step: float, spacing: float, c: float, air: Air | None
) -> Transform:
    """From records of `steps` steps of `step` s to responses of `duration` s up to `edge`, Hz."""
    rate = response_rate(edge)
    samples = response_samples(edge, duration)
    size = 2 * int(np.ceil(0.5 * (samples + _PAD_S * rate)))
    every = np.arange(size // 2 + 1) * rate / size
    bins = np.flatnonzero((every > 0.0) & (every < 0.5 * rate))
    frequency = every[bins]
    on_lattice = lattice_frequency(frequency, spacing, step, c)
    loss = 0.5 * c * air.attenuation(frequency) if air is not None else np.zeros(len(bins))
    check_memory(8.0 * len(bins) * steps, f"the transform of waves of {duration:g} s")
    t = np.arange(steps) * step
    signal = pulse(edge, step)
    gain = np.sqrt(4.0 * np.pi) * amplitude_factor(frequency, spacing, c)
    gain = (
        gain * band_gain(frequency, edge) * np.exp(-2j * np.pi * frequency * lead_samples(edge) / rate)
    )
    fade = np.sin(0.5 * np.pi * np.clip((t[-1] - t) / _FADE_S, 0.0, 1.0)) ** 2
    both = np.empty((2, len(bins), steps), np.float32)
    for first in range(0, len(bins), _COLUMNS):
        rows = slice(first, first + _COLUMNS)
        turn = np.exp(-(2j * np.pi * on_lattice[rows] + loss[rows])[:, None] * t)
        of_pulse = (turn[:, : len(signal)] * signal).sum(axis=1)
        turn *= (gain[rows] / of_pulse)[:, None]
        turn *= fade
        both[0, rows], both[1, rows] = turn.real, turn.imag
    return Transform(both.reshape(-1, steps), frequency, bins, size, rate, samples)


def spectra(transform: Transform, records: np.ndarray) -> np.ndarray:
    """(columns, k) complex64 of records (steps, columns) float32."""
    columns = records.shape[1]
    out = np.empty((columns, len(transform.bins)), np.complex64)
    for first in range(0, columns, _COLUMNS):
        block = np.zeros((len(records), _COLUMNS), np.float32)
        part = records[:, first : first + _COLUMNS]
        block[:, : part.shape[1]] = part
        made = transform.matrix @ block
        real, imaginary = made[: len(transform.bins)], made[len(transform.bins) :]
        out[first : first + part.shape[1]] = (real + 1j * imaginary).T[: part.shape[1]]
    return out


def responses(transform: Transform, records: np.ndarray, c: float) -> np.ndarray:
    """(listeners, 4, samples) float32: pressure and -rho c u along x, y and z, from records (steps, listeners *
    4) of the pressure and its derivatives in 1/m."""
    spectrum = spectra(transform, records).reshape(-1, ROWS, len(transform.bins))
    wave_number = (2.0 * np.pi * transform.frequency / c).astype(np.float32)
    spectrum[:, 1:] /= 1j * wave_number
    full = np.zeros((*spectrum.shape[:2], transform.size // 2 + 1), np.complex64)
    full[:, :, transform.bins] = spectrum
    return np.asarray(np.fft.irfft(full, transform.size)[:, :, : transform.samples], np.float32)
