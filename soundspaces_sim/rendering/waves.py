"""Reverberation as plane waves, so that points that stand together hear one and the same field.

Waves come from directions spread evenly over the sphere, each with noise of its own. The energy of a time bin
and band is shared among them: of all shares with its moments up to order 2, those of the largest entropy (Jaynes
1957), w_d ~ exp(lambda . Y(d)). A point beside the origin hears each wave earlier or later. So a diffuse field
has the coherence sin(k r) / (k r) between two points (Cook et al. 1955), and one wave has one direction.

As in `ambisonics`, low bands are made at a low rate.
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from soundspaces_sim.core.numerics.axes import head_matrix, spherical_harmonics
from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.filters import white_noise
from soundspaces_sim.rendering.air import through_air, without_air
from soundspaces_sim.rendering.ambisonics import band_plans
from soundspaces_sim.rendering.synthesis import gather, modulate_waves

WAVES = 192
_BLOCK = 64
LANES = 2000  # streams of noise apart from those of other renderers
_RIDGE = 3e-3
_STEPS = 16
_REACH = 3.0  # most that a step may change an exponent by
_CLOSE = 1e-4  # of moments: what is nearer needs no more steps


def lattice(count: int = WAVES) -> np.ndarray:
    """(K, 3) unit vectors spread evenly over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, phi = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z**2)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)


def turned_lattice(seed: int, count: int = WAVES) -> np.ndarray:
    """(K, 3) a lattice turned at random; of one wave, no direction."""
    turn = np.random.default_rng(seed % 2**64).uniform(-180.0, 180.0, 3)
    return lattice(count) @ head_matrix(*turn).T if count > 1 else np.zeros((1, 3))


class WaveField:
    """The reverberation of an echogram, n samples of it at `rate` Hz, as waves from `directions` (K, 3), a lattice
    turned at random; a single wave carries all energy and has no direction. The noise is a function of `seed`
    alone."""

    def __init__(self, echogram: Echogram, n: int, rate: int, seed: int, waves: int = WAVES) -> None:
        self.directions = turned_lattice(seed, waves)
        self._n, self._rate = n, rate
        self._size, self._plans = band_plans(echogram.bands, int(rate), n)
        stream = combine(np.uint64(seed % 2**64), LANES)
        self._air, echogram = echogram.air, without_air(echogram)
        self._spectra = []  # (K, 2, last - first) of each band
        for b, plan in enumerate(self._plans):
            energy = shared_energy(echogram.energy[:, :, b].astype(float), self.directions)
            key, table = np.uint64(combine(np.uint64(stream), b)), white_noise()
            starts = np.array([int(combine(key, j) % np.uint64(len(table))) for j in range(waves)])
            samples = np.empty((waves, self._size // plan.step), np.float32)
            work = np.empty(waves), np.empty(waves, np.float32)
            modulate_waves(samples, energy, echogram.time_edges, plan.step / rate, table, starts, work)
            spectrum = scipy.fft.rfft(samples, overwrite_x=True)[:, plan.first : plan.last] * plan.gain
            self._spectra.append(np.stack([spectrum.real, spectrum.imag], axis=1))

    def at(self, offsets: np.ndarray, weights: np.ndarray, speed_of_sound: float) -> np.ndarray:
        """(R, n) float32 signals `offsets` (R, 3) m beside the origin; `weights`: of each wave in each signal,
        (R, K), or (R, b, K) if they differ by band."""
        turns = 2.0 * np.pi * self._rate / self._size * (offsets @ self.directions.T) / speed_of_sound
        each = weights if weights.ndim == 3 else weights[:, None]
        each = np.broadcast_to(
            each, (len(offsets), max(len(self._plans), each.shape[1]), weights.shape[-1])
        )
        out = np.zeros((len(offsets), 2, self._size // 2 + 1), np.float32)
        work = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
        for b, plan in enumerate(self._plans):  # bands above Nyquist have none
            gather(
                out,
                self._spectra[b],
                plan.first,
                turns,
                np.ascontiguousarray(each[:, b], np.float32),
                work,
            )
        spectrum = np.empty((len(out), out.shape[2]), np.complex64)
        spectrum.real, spectrum.imag = out[:, 0], out[:, 1]
        made = np.ascontiguousarray(scipy.fft.irfft(spectrum, self._size)[:, : self._n], np.float32)
        return through_air(made, self._air, int(self._rate))


def shared_energy(energy: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(bins, K) energy of each direction, from moments (bins, 9)."""
    whole = energy[:, :1]
    if len(directions) == 1:
        return np.ascontiguousarray(whole)
    out = np.zeros((len(energy), len(directions)))
    heard = whole[:, 0] > 0.0
    out[heard] = whole[heard] * shares(energy[heard, 1:] / whole[heard], directions)
    return out


def shares(moments: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n, K) shares of the largest entropy, sum 1, with the moments (n, 8) of orders 1 and 2 (SN3D).

    Newton's method on the dual problem. `_RIDGE` bounds lambda where moments are those of fewer directions
    than K can tell apart: there they are met as nearly as the directions allow.
    """
    basis = spherical_harmonics(directions)[:, 1:]
    squares = (basis[:, :, None] * basis[:, None, :]).reshape(len(basis), -1)
    dual = np.zeros(moments.shape)
    rows = np.arange(len(moments))
    for _ in range(_STEPS):  # einsum, not @: a row's bits must not depend on the number of rows
        weight = _softmax(np.einsum("ri,ki->rk", dual[rows], basis))
        mean = np.einsum("rk,ki->ri", weight, basis)
        slope = moments[rows] - mean - _RIDGE * dual[rows]
        open_ = np.abs(slope).max(axis=1) > _CLOSE
        rows, weight, mean, slope = rows[open_], weight[open_], mean[open_], slope[open_]
        if len(rows) == 0:
            break
        curvature = np.einsum("rk,kq->rq", weight, squares).reshape(-1, 8, 8)
        curvature += _RIDGE * np.eye(8) - mean[:, :, None] * mean[:, None, :]
        step = np.linalg.solve(curvature, slope[:, :, None])[:, :, 0]
        reach = np.abs(np.einsum("ri,ki->rk", step, basis)).max(axis=1)
        dual[rows] += step * np.minimum(1.0, _REACH / np.maximum(reach, 1e-9))[:, None]
    return _softmax(np.einsum("ri,ki->rk", dual, basis))


def _softmax(exponent: np.ndarray) -> np.ndarray:
    weight = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))
