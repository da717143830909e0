"""Discrete paths that arrive together: levels of their sum as their waves want it.

An arrival is rendered with the phase of its delay, and flat over a band. A path by edges has a field that
changes with frequency, in size and phase (`PathTable.wave`), and where two arrivals come within a wave or so of
each other their sum depends on it. With E_i the energies, w_i(k) the waves and <> the mean over a band in log k,
the arrivals of a pair have together

    T = sum over i, j of sqrt(E_i E_j) Re <w_i w_j* e^(-jk(l_i - l_j)) e^(-(k(l_i - l_j))²/2s²)>,  s = 4 pi,

and are rendered with R, the same with all w = 1. A wave is the polynomial in log k through the points at which it
is known, so that means are sums over tables of products of Lagrange's polynomials. As the Gaussian is positive
definite and w has a mean square of at most one, T and R are not negative. Each arrival gets the ratio of T to R
about it, of its neighbours' parts weighted by a Gaussian of the same width: what comes long before or after does
not count. Where the rendered sum cancels, so that R is below a fiftieth of the energies' sum, the ratio tends to
one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.bands import log_edges
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.transport.diffraction.spectrum import wave_points
from soundspaces_sim.transport.path_table import WAVE_POINTS, PathTable
from soundspaces_sim.transport.tile import Tile

_WIDTH = 4.0 * np.pi  # rad, s
_REACH = 4.0  # widths, up to which two arrivals matter to each other
_POINTS = 48  # of a quadrature, per factor e of frequency
_STEP = 0.05  # rad, at the highest frequency of a band
_KNEE = _REACH * _WIDTH / _STEP  # steps; of what is farther off only lower frequencies matter
_LEAST = 0.02  # of the energies' sum


class TileArrivals(NamedTuple):
    """Direct sound of all pairs of a tile, then its discrete paths in the order of `Tile.discrete`."""

    pair: np.ndarray  # (n,)
    length: np.ndarray  # (n,) m
    energy: np.ndarray  # (n, b) before it is scaled
    wave: np.ndarray  # (n, b, 3) complex


class _Arrivals(NamedTuple):
    """Discrete paths of some pairs, by pair and length."""

    length: np.ndarray  # (n,) m
    energy: np.ndarray  # (n, b)
    wave: np.ndarray  # (n, b, 3) complex


class Together(NamedTuple):
    """Arrivals of pairs in which waves count."""

    rows: np.ndarray  # (m,) of `TileArrivals`
    pair: np.ndarray  # (m,)
    start: np.ndarray  # (k + 1,) where each pair begins
    arrivals: _Arrivals  # m


class _Tables(NamedTuple):
    """Means over bands by path difference."""

    k: np.ndarray  # (b,) 1/m, centres of the bands
    scale: np.ndarray  # (b,) steps per m
    #: (b, n, 3, 3) complex, of e^(-jkx) and the Gaussian times products of Lagrange's polynomials, by `_place`
    mean: np.ndarray


@part(forceinline=True)
def _place(steps: float) -> float:
    """Where a path difference is in the tables, whose steps grow with it beyond `_KNEE`."""
    return steps if steps < _KNEE else _KNEE * (1.0 + math.log(steps / _KNEE))


@lru_cache(maxsize=4)
def _tables(bands: tuple[float, ...], c: float) -> _Tables:
    edges = 2.0 * np.pi / c * log_edges(bands)
    if bands[0] == 0.0:
        edges[0] = 0.5 * edges[1]
    wide = float(np.log(edges[1:] / edges[:-1]).max())
    x, weight = np.polynomial.legendre.leggauss(math.ceil(_POINTS * max(wide, 1.0)))
    centre, half = np.sqrt(edges[1:] * edges[:-1]), 0.5 * np.log(edges[1:] / edges[:-1])
    k = centre[:, None] * np.exp(half[:, None] * x)
    place = np.arange(math.ceil(_KNEE * (1.0 + wide)) + 2)
    steps = np.where(place < _KNEE, place, _KNEE * np.exp(place / _KNEE - 1.0))
    at = wave_points()[0]
    lagrange = np.array(
        [
            np.prod((x[:, None] - np.delete(at, n)) / (at[n] - np.delete(at, n)), axis=1)
            for n in range(len(at))
        ]
    )
    product = (0.5 * weight * lagrange[:, None] * lagrange).reshape(len(at) ** 2, -1).T
    mean = np.empty((len(centre), len(place), len(at), len(at)), np.complex128)
    for b in range(len(centre)):
        phase = _STEP / edges[b + 1] * steps[:, None] * k[b]
        wave = np.exp(-1j * phase - 0.5 * (phase / _WIDTH) ** 2)
        mean[b] = (wave @ product).reshape(mean.shape[1:])
    return _Tables(centre, edges[1:] / _STEP, mean)


def band_centres(bands: tuple[float, ...], c: float) -> np.ndarray:
    """(b,) wave numbers at the centres of bands of these edges in Hz, 1/m; a band from 0 Hz is taken from an octave
    below its upper end."""
    return _tables(bands, c).k


@part(forceinline=True)
def _interference(
    mean: np.ndarray, place: float, first: np.ndarray, second: np.ndarray
) -> tuple[float, float]:
    """(Part of T, part of R) of two arrivals of unit energy with waves (3,), the second at `place` after the first
    in a band's table."""
    at = int(place)
    between, true, rendered = place - at, 0j, 0j
    for r in range(WAVE_POINTS):
        inner = 0j
        for t in range(WAVE_POINTS):
            value = mean[at, r, t] + between * (mean[at + 1, r, t] - mean[at, r, t])
            rendered += value
            inner += second[t] * value
        true += np.conj(first[r]) * inner
    return true.real, rendered.real


@kernel
def _find_factors(
    first: int,
    last: int,
    start: np.ndarray,
    arrivals: _Arrivals,
    tables: _Tables,
    out: np.ndarray,
) -> None:
    """Factors `out` (3, n, b) [0] of the arrivals of pairs start[i]:start[i + 1], by length; [1] and [2] are their
    parts of T and R."""
    length, energy, wave = arrivals
    k, scale, mean = tables
    for i in range(first, last):
        begin, end = start[i], start[i + 1]
        for b in range(energy.shape[1]):
            for m in range(begin, end):
                out[1, m, b] = out[2, m, b] = energy[m, b]
            for m in range(begin, end):
                for n in range(m + 1, end):
                    place = _place((length[n] - length[m]) * scale[b])
                    if int(place) + 1 >= mean.shape[1]:
                        break
                    true, rendered = _interference(mean[b], place, wave[m, b], wave[n, b])
                    size = np.sqrt(energy[m, b] * energy[n, b])
                    for which in (m, n):
                        out[1, which, b] += size * true
                        out[2, which, b] += size * rendered
            earliest = begin
            for m in range(begin, end):
                true, rendered, total = out[1, m, b], out[2, m, b], energy[m, b]
                while k[b] * (length[earliest] - length[m]) / _WIDTH <= -_REACH:
                    earliest += 1
                for n in range(earliest, end):
                    x = k[b] * (length[n] - length[m]) / _WIDTH
                    if x >= _REACH:
                        break
                    if n != m:
                        near = math.exp(-0.5 * x * x)
                        true += near * out[1, n, b]
                        rendered += near * out[2, n, b]
                        total += near * energy[n, b]
                out[0, m, b] = 1.0
                if total > 0.0:
                    least = _LEAST * total
                    out[0, m, b] = (max(true, 0.0) + least) / (max(rendered, 0.0) + least)


@kernel
def _find_derivatives(
    first: int,
    last: int,
    start: np.ndarray,
    arrivals: _Arrivals,
    tables: _Tables,
    factors: np.ndarray,
    weight: np.ndarray,
    out: np.ndarray,
) -> None:
    """Derivatives `out` (3, n, b) [0] of the sum of `weight` (n, b) times scaled energies by the logarithms of the
    energies, of the pairs of `_find_factors`, whose `out` is `factors`; [1] and [2] are those by parts of T and
    R."""
    length, energy, wave = arrivals
    k, scale, mean = tables
    for i in range(first, last):
        begin, end = start[i], start[i + 1]
        for b in range(energy.shape[1]):
            for m in range(begin, end):
                out[:, m, b] = 0.0
                out[0, m, b] = weight[m, b] * factors[0, m, b] * energy[m, b]
            for m in range(begin, end):
                true, rendered, total = 0.0, 0.0, 0.0
                for n in range(begin, end):
                    x = k[b] * (length[n] - length[m]) / _WIDTH
                    near = math.exp(-0.5 * x * x) if abs(x) < _REACH else 0.0
                    true += near * factors[1, n, b]
                    rendered += near * factors[2, n, b]
                    total += near * energy[n, b]
                if total <= 0.0:
                    continue
                least, factor = _LEAST * total, factors[0, m, b]
                by_factor = weight[m, b] * energy[m, b] / (max(rendered, 0.0) + least)
                for n in range(begin, end):
                    x = k[b] * (length[n] - length[m]) / _WIDTH
                    near = math.exp(-0.5 * x * x) * by_factor if abs(x) < _REACH else 0.0
                    out[0, n, b] += near * _LEAST * (1.0 - factor) * energy[n, b]
                    out[1, n, b] += near if true > 0.0 else 0.0
                    out[2, n, b] -= near * factor if rendered > 0.0 else 0.0
            for m in range(begin, end):
                out[0, m, b] += (out[1, m, b] + out[2, m, b]) * energy[m, b]
                for n in range(m + 1, end):
                    place = _place((length[n] - length[m]) * scale[b])
                    if int(place) + 1 >= mean.shape[1]:
                        break
                    true, rendered = _interference(mean[b], place, wave[m, b], wave[n, b])
                    half = 0.5 * np.sqrt(energy[m, b] * energy[n, b])
                    change = half * (out[1, m, b] + out[1, n, b]) * true
                    change += half * (out[2, m, b] + out[2, n, b]) * rendered
                    out[0, m, b] += change
                    out[0, n, b] += change


def _bounded(wave: np.ndarray) -> np.ndarray:
    """Waves (n, b, 3) of a mean square of at most one: a product of two may have more."""
    square = (np.abs(wave) ** 2 @ wave_points()[1])[..., None]
    return np.ascontiguousarray(wave / np.sqrt(np.maximum(square, 1.0)), np.complex128)


def tile_arrivals(tile: Tile) -> TileArrivals:
    """What a tile has before `connect` scales it."""
    bands, pairs = tile.direct.shape[2], tile.walls.size
    found, points = list(tile.discrete.values()), WAVE_POINTS
    direct = np.ones((pairs, bands, points)) if tile.direct_wave is None else tile.direct_wave
    return TileArrivals(
        np.concatenate([np.arange(pairs), *(paths.pair for paths in found)]),
        np.concatenate([tile.distance.ravel(), *(paths.length for paths in found)]),
        np.concatenate([tile.direct.reshape(pairs, bands), *(paths.energy for paths in found)]),
        np.concatenate([direct.reshape(pairs, bands, points), *(paths.wave for paths in found)]),
    )


def _together(found: TileArrivals, pairs: int, wanted: np.ndarray) -> Together:
    """Those that are `wanted` (n,), of pairs in which a wave is not 1, of `pairs` in all."""
    pair, length, energy, wave = found
    turned = np.bincount(pair[(wave != 1.0).any(axis=(1, 2))], minlength=pairs) > 0
    rows = np.flatnonzero(wanted & turned[pair] & (energy > 0.0).any(axis=1))
    rows = rows[np.lexsort((wave[rows, 0, 0].real, energy[rows, 0], length[rows], pair[rows]))]
    start = np.unique(pair[rows], return_index=True)[1]
    some = _Arrivals(length[rows], np.ascontiguousarray(energy[rows]), _bounded(wave[rows]))
    return Together(rows, pair[rows], np.append(start, len(rows)), some)


def sums_of(tile: Tile, some: Together) -> np.ndarray:
    """(3, m, b) of `_find_factors`: the ratio about each arrival, its parts of T and of R."""
    tables = _tables(tile.model.config.bands, tile.model.config.c)
    out = np.empty((3, *some.arrivals.energy.shape))
    over_rows(_find_factors, len(some.start) - 1, some.start, some.arrivals, tables, out)
    return out


def scale_together(tile: Tile, wanted: np.ndarray, factors: Callable[[Together], np.ndarray]) -> None:
    """Scale energies of a tile by `factors` (m, b) of those arrivals that are `wanted` (n,), pair by pair; both
    directions of a pair by the same ones."""
    if tile.direct_wave is None:
        return
    found, (rows, columns) = tile_arrivals(tile), tile.walls.shape
    pairs, (i, j) = rows * columns, divmod(found.pair, columns)
    some = _together(found, pairs, wanted & ((i <= j) | (not tile.same)))
    if len(some.rows) == 0:
        return
    factor, of_some = np.ones_like(found.energy), factors(some)
    factor[some.rows] = of_some
    if tile.same:  # pairs i <= j were done, and count for both directions
        back = _together(found._replace(pair=j * columns + i), pairs, wanted & (i > j))
        factor[back.rows] = of_some[(i < j)[some.rows]]
    tile.direct *= factor[:pairs].reshape(tile.direct.shape)
    begin = pairs
    for paths in tile.discrete.values():
        part = slice(begin, begin + len(paths.pair))
        paths.energy[:] *= factor[part]
        begin = part.stop


def connect(tile: Tile) -> PathTable | None:
    """Scale what other techniques have found; no paths of its own."""
    count = tile.walls.size + sum(len(paths.pair) for paths in tile.discrete.values())
    scale_together(tile, np.ones(count, np.bool_), lambda some: sums_of(tile, some)[0])
    return None


def weighted_derivatives(tile: Tile, found: TileArrivals, weight: np.ndarray) -> np.ndarray:
    """(n, b) derivatives of the sum of `weight` (n, b) times the energies that `connect` has scaled, by the
    logarithms of those before."""
    some = _together(found, tile.walls.size, np.ones(len(found.pair), np.bool_))
    out = weight * found.energy
    if len(some.rows):
        tables = _tables(tile.model.config.bands, tile.model.config.c)
        factors, of_some = sums_of(tile, some), np.ascontiguousarray(weight[some.rows])
        made = np.empty_like(factors)
        over_rows(
            _find_derivatives,
            len(some.start) - 1,
            some.start,
            some.arrivals,
            tables,
            factors,
            of_some,
            made,
        )
        out[some.rows] = made[0]
    return out
