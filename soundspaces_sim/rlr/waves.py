"""Reverberation as plane waves, so that points that stand together hear one and the same field.

The energy of a time bin is shared among K directions: of all shares with its moments up to order 2, those
of the largest entropy (Jaynes 1957), w_d ~ exp(lambda . Y(d)). Every direction carries noise of its own; a
point beside the origin hears each wave earlier or later. A diffuse field so has the spatial coherence
sin(k r) / (k r) of the ideal one, to about 1 / sqrt(K).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft

from soundspaces_sim.base.axes import spherical_harmonics
from soundspaces_sim.echo.echogram import Echogram
from soundspaces_sim.echo.filters import band_shares
from soundspaces_sim.rlr.kernels import gather

_WAVES = 64
_PAD_S = 0.1  # room for band filters to ring and for waves to be moved
_RIDGE = 3e-3
_STEPS = 16
_REACH = 3.0  # most that a step may change an exponent by


@lru_cache(maxsize=1)
def wave_directions() -> np.ndarray:
    """(K, 3) unit vectors spread evenly over the sphere (Fibonacci lattice)."""
    i = np.arange(_WAVES) + 0.5
    z = 1.0 - 2.0 * i / _WAVES
    phi = i * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z * z)
    directions = np.column_stack([r * np.cos(phi), r * np.sin(phi), z])
    directions.setflags(write=False)
    return directions


class WaveField:
    """The noise of one echogram as spectra of plane waves from `directions` (K, 3); one wave without
    direction if that is None. `n` samples at `rate` Hz; the noise hangs on `seed` alone."""

    def __init__(
        self, echogram: Echogram, directions: np.ndarray | None, n: int, rate: int, seed: int
    ) -> None:
        self.n, self.rate, self.directions = n, rate, directions
        self.size = int(scipy.fft.next_fast_len(n + round(_PAD_S * rate), real=True))
        shares = band_shares(echogram.bands, np.fft.rfftfreq(self.size, 1.0 / rate), rate)
        edges, bins = echogram.time_edges, len(echogram.time_edges) - 1
        rows = np.searchsorted(edges, (np.arange(n) + 0.5) / rate, "right") - 1
        rows = rows[rows < bins]
        counts = np.maximum(np.bincount(rows, minlength=bins), 1)
        waves = 1 if directions is None else len(directions)
        random = np.random.default_rng(seed % 2**64)
        self.spectra = np.zeros((waves, self.size // 2 + 1), np.complex64)
        for b, share in enumerate(shares):
            energy = echogram.energy[:, :, b].astype(float)
            gain = np.sqrt(_shared(energy, directions) / counts[:, None]).astype(np.float32)
            noise = random.standard_normal((waves, len(rows)), np.float32)
            noise *= gain.T[:, rows]
            part = np.asarray(scipy.fft.rfft(noise, self.size, overwrite_x=True))
            self.spectra += part * np.sqrt(share).astype(np.float32)

    def at(self, offset: np.ndarray, weights: np.ndarray, speed_of_sound: float) -> np.ndarray:
        """(C, n) signals `offset` (3,) m beside the origin; `weights` (K, C): of each wave in each."""
        lead = np.zeros(len(self.spectra))
        if self.directions is not None:
            lead = self.directions @ offset / speed_of_sound
        out = np.zeros((weights.shape[1], self.spectra.shape[1]), np.complex64)
        gather(out, self.spectra, 2.0 * np.pi * self.rate / self.size * lead, weights.astype(np.float32))
        return np.asarray(scipy.fft.irfft(out, self.size, overwrite_x=True)[:, : self.n])


def _shared(energy: np.ndarray, directions: np.ndarray | None) -> np.ndarray:
    """(bins, K) energy of each direction, from moments (bins, 9); all of it if there is no direction."""
    whole = energy[:, :1]
    if directions is None:
        return whole
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
    dual = np.zeros_like(moments)
    for _ in range(_STEPS):  # einsum, not @: a row's bits must not hang on how many rows there are
        weight = _softmax(np.einsum("ri,ki->rk", dual, basis))
        mean = np.einsum("rk,ki->ri", weight, basis)
        slope = moments - mean - _RIDGE * dual
        curvature = np.einsum("rk,kq->rq", weight, squares).reshape(-1, 8, 8)
        curvature += _RIDGE * np.eye(8) - mean[:, :, None] * mean[:, None, :]
        step = np.linalg.solve(curvature, slope[:, :, None])[:, :, 0]
        reach = np.abs(np.einsum("ri,ki->rk", step, basis)).max(axis=1)
        dual += step * np.minimum(1.0, _REACH / np.maximum(reach, 1e-9))[:, None]
    return _softmax(np.einsum("ri,ki->rk", dual, basis))


def _softmax(exponent: np.ndarray) -> np.ndarray:
    weight = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))
