"""Discrete paths that arrive together: levels of their sum as their phases want it.

An arrival is rendered with the phase of its delay. A path by edges has one of its own beside that
(`PathTable.phase`), of up to an eighth of a turn for each edge, and where two arrivals come within a wave or so of
each other their sum depends on it. With E_i the energies, c_i the phases and M(x, a) the mean of
k^a e^(-jkx) e^(-(kx)²/2s²) over the band, over that of k^a, s = 4 pi, the pair's arrivals have together

    T = sum over i, j of sqrt(E_i E_j) Re(c_i c_j* M(l_i - l_j, (a_i + a_j) / 2)),

a_i the exponents with which diffracted energies go by frequency, from neighbouring bands; they are rendered with
R, the same without c and a. M is positive definite, so T and R are not negative. Each arrival gets the ratio of T
to R about it, of its neighbours' parts weighted by a Gaussian of the same width: what comes long before or after
does not count. Where the rendered sum cancels, so that R is below a fiftieth of the energies' sum, the ratio tends
to one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.bands import log_edges
from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.tile import Tile

_WIDTH = 4.0 * np.pi  # rad, s
_REACH = 3.0  # widths, up to which two arrivals matter to each other
_POINTS = 48  # per band
_STEP = 0.05  # rad, at the highest frequency of a band
_SLOPES = np.linspace(-3.0, 0.0, 7)  # a of the tables
_LEAST = 0.02  # of the energies' sum


class _Arrivals(NamedTuple):
    """Discrete paths of some pairs, by pair and length."""

    length: np.ndarray  # (n,) m
    energy: np.ndarray  # (n, b)
    phase: np.ndarray  # (n, b) complex
    slope: np.ndarray  # (n, b) rows of `_SLOPES`, and what is between them


def _tables(bands: tuple[float, ...], c: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(Steps (b,) m, M (slopes, b, n) complex, the Gaussian (b, n)) at whole steps of path differences."""
    edges = log_edges(bands)
    if bands[0] == 0.0:
        edges[0] = 0.5 * edges[1]
    x, weight = np.polynomial.legendre.leggauss(_POINTS)
    middle, half = 0.5 * np.log(edges[1:] * edges[:-1]), 0.5 * np.log(edges[1:] / edges[:-1])
    k = 2.0 * np.pi / c * np.exp(middle[:, None] + half[:, None] * x)
    step = _STEP * c / (2.0 * np.pi * edges[1:])
    count = int(np.ceil(_REACH * _WIDTH / _STEP * (edges[1:] / edges[:-1]).max())) + 2
    phase = k[:, None, :] * step[:, None, None] * np.arange(count)[:, None]
    wave = np.exp(-1j * phase - 0.5 * (phase / _WIDTH) ** 2)
    share = weight * (k / k.mean(axis=1, keepdims=True)) ** _SLOPES[:, None, None]
    share /= share.sum(axis=2, keepdims=True)
    mean = np.ascontiguousarray(np.einsum("bnk,sbk->sbn", wave, share))
    centre = 2.0 * np.pi / c * np.exp(middle)
    near = np.exp(-0.5 * (centre[:, None] * step[:, None] * np.arange(count) / _WIDTH) ** 2)
    return step, mean, near


@kernel
def _find_factors(
    first: int,
    last: int,
    start: np.ndarray,
    arrivals: _Arrivals,
    tables: tuple[np.ndarray, np.ndarray, np.ndarray],
    out: np.ndarray,
) -> None:
    """Factors `out` (3, n, b) [0] of the arrivals of pairs start[i]:start[i + 1], by length; [1] and [2] are their
    parts of T and R."""
    length, energy, phase, slope = arrivals
    step, mean, near = tables
    flat = mean.shape[0] - 1
    for i in range(first, last):
        begin, end = start[i], start[i + 1]
        for b in range(energy.shape[1]):
            for m in range(begin, end):
                out[1, m, b] = out[2, m, b] = energy[m, b]
            for m in range(begin, end):
                for n in range(m + 1, end):
                    x = (length[n] - length[m]) / step[b]
                    at = int(x)
                    if at + 1 >= mean.shape[2]:
                        break
                    part, row = x - at, 0.5 * (slope[m, b] + slope[n, b])
                    low = min(int(row), flat - 1)
                    value = mean[flat, b, at] + part * (mean[flat, b, at + 1] - mean[flat, b, at])
                    under = mean[low, b, at] + part * (mean[low, b, at + 1] - mean[low, b, at])
                    over = mean[low + 1, b, at] + part * (
                        mean[low + 1, b, at + 1] - mean[low + 1, b, at]
                    )
                    tilted = under + (row - low) * (over - under)
                    size = np.sqrt(energy[m, b] * energy[n, b])
                    both = phase[n, b] * np.conj(phase[m, b]) * tilted
                    for which in (m, n):
                        out[1, which, b] += size * both.real
                        out[2, which, b] += size * value.real
            for m in range(begin, end):
                true, rendered, total = out[1, m, b], out[2, m, b], energy[m, b]
                for n in range(begin, end):
                    at = int(abs(length[n] - length[m]) / step[b])
                    if n != m and at < near.shape[1]:
                        true += near[b, at] * out[1, n, b]
                        rendered += near[b, at] * out[2, n, b]
                        total += near[b, at] * energy[n, b]
                out[0, m, b] = 1.0
                if total > 0.0:
                    least = _LEAST * total
                    out[0, m, b] = (max(true, 0.0) + least) / (max(rendered, 0.0) + least)


def _slopes(energy: np.ndarray, bands: tuple[float, ...]) -> np.ndarray:
    """(n, b) exponents of energies (n, b) by frequency, as rows of `_SLOPES` and what is between.

    From a band to the next one, which on walks past edges does better than from the one before, or than the mean.
    """
    edges = log_edges(bands)
    if bands[0] == 0.0:
        edges[0] = 0.5 * edges[1]
    centre = 0.5 * np.log(edges[1:] * edges[:-1])
    if len(centre) < 2:
        return np.full(energy.shape, len(_SLOPES) - 1.0)
    slope = np.diff(np.log(np.maximum(energy, 1e-300)), axis=1) / np.diff(centre)
    row = (np.concatenate([slope, slope[:, -1:]], axis=1) - _SLOPES[0]) / (_SLOPES[1] - _SLOPES[0])
    return np.asarray(np.clip(row, 0.0, len(_SLOPES) - 1.0))


def connect(tile: Tile) -> PathTable | None:
    """Scale what other techniques have found; no paths of its own."""
    bands, pairs = tile.direct.shape[2], tile.walls.size
    found = [paths for paths in tile.discrete.values() if len(paths.pair)]
    if tile.direct_phase is None or not found:
        return None
    direct = tile.direct_phase.reshape(pairs, bands)
    pair = np.concatenate([np.arange(pairs), *(paths.pair for paths in found)])
    length = np.concatenate([tile.distance.ravel(), *(paths.length for paths in found)])
    energy = np.concatenate([tile.direct.reshape(pairs, bands), *(paths.energy for paths in found)])
    phase = np.concatenate([direct, *(paths.phase for paths in found)])
    turned = np.bincount(pair[(phase != 1.0).any(axis=1)], minlength=pairs) > 0
    rows = np.flatnonzero(turned[pair] & (energy > 0.0).any(axis=1))
    rows = rows[np.lexsort((phase[rows, 0].real, energy[rows, 0], length[rows], pair[rows]))]
    own, start = np.unique(pair[rows], return_index=True)
    if len(own) == 0:
        return None
    tables = _tables(tile.model.config.bands, tile.model.config.c)
    out = np.empty((3, len(rows), bands))
    arrivals = _Arrivals(
        length[rows],
        np.ascontiguousarray(energy[rows]),
        np.ascontiguousarray(phase[rows]),
        np.where(phase[rows] != 1.0, _slopes(energy[rows], tile.model.config.bands), len(_SLOPES) - 1.0),
    )
    over_rows(_find_factors, len(own), np.append(start, len(rows)), arrivals, tables, out)
    factor = np.ones_like(energy)
    factor[rows] = out[0]
    tile.direct *= factor[:pairs].reshape(tile.direct.shape)
    begin = pairs
    for paths in found:
        part = slice(begin, begin + len(paths.pair))
        paths.energy[:] *= factor[part]
        begin = part.stop
    return None
