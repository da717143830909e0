"""Wave numbers at which diffraction is computed: Gauss-Legendre points of every band, in log frequency.

Kernels take a band's mean energy as a weighted sum over its points (Gauss, n points are exact for polynomials of
degree 2n - 1 in log f). Where the diffracted wave interferes with a geometrical one there are more points.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.bands import log_edges
from soundspaces_sim.transport.path_table import WAVE_POINTS

SHADOW_POINTS, LIT_POINTS = WAVE_POINTS, 8  # per band
NODES = 2  # per band, of what changes slowly


class Quadrature(NamedTuple):
    """Points in every band."""

    k: np.ndarray  # (b, g) wave numbers, 1/m
    weight: np.ndarray  # (g,) which sum to one
    node: np.ndarray  # (b, n) wave numbers at which endless edges are computed, 1/m
    between: np.ndarray  # (b, g, n) by which it is had at `k` from there, but for its phase
    project: (
        np.ndarray
    )  # (`WAVE_POINTS`, g) makes fields at the points of `PathTable.wave` of those at `k`


class Spectrum(NamedTuple):
    """Points for a diffracted wave by itself, and for its interference with a geometrical one."""

    shadow: Quadrature
    lit: Quadrature


@lru_cache(maxsize=8)
def make_spectrum(bands: tuple[float, ...], c: float) -> Spectrum:
    """Points in `bands`, their edges in Hz, at a speed of sound in m/s."""
    return Spectrum(make_quadrature(bands, SHADOW_POINTS, c), make_quadrature(bands, LIT_POINTS, c))


def make_quadrature(bands: tuple[float, ...], points: int, c: float) -> Quadrature:
    """So many points in every band; a band from 0 Hz is taken as an octave.

    Diffracted fields, but for the phase of their path and what edges lack beyond their ends, change slowly, between
    not at all and as one over the wave number: times its root they are interpolated from `NODES` in log frequency.
    """
    edges = log_edges(bands)
    if bands[0] == 0.0:
        edges[0] = 0.5 * edges[1]  # lower, waves are longer than the walls that the edges are of
    x, weight = np.polynomial.legendre.leggauss(points)
    at_nodes = np.polynomial.legendre.leggauss(NODES)[0]
    middle, half = 0.5 * np.log(edges[1:] * edges[:-1]), 0.5 * np.log(edges[1:] / edges[:-1])
    k, node = (2.0 * np.pi / c * np.exp(middle[:, None] + half[:, None] * at) for at in (x, at_nodes))
    share = np.ones((points, NODES))  # Lagrange's polynomials
    for n in range(NODES):
        for m in range(NODES):
            if m != n:
                share[:, n] *= (x - at_nodes[m]) / (at_nodes[n] - at_nodes[m])
    between = share * np.sqrt(node[:, None, :] / k[:, :, None])
    return Quadrature(k, 0.5 * weight, node, np.ascontiguousarray(between), _projection(x, 0.5 * weight))


def _projection(x: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(`WAVE_POINTS`, g) The polynomial of second degree in log f that is nearest to a field in the mean square, at
    `wave_points`: the field itself where it has no more points."""
    legendre = np.polynomial.legendre.legvander
    order = 2 * np.arange(WAVE_POINTS) + 1
    at = legendre(wave_points()[0], WAVE_POINTS - 1)
    return np.ascontiguousarray(at @ (order[:, None] * legendre(x, WAVE_POINTS - 1).T * weight))


@lru_cache(maxsize=1)
def wave_points() -> tuple[np.ndarray, np.ndarray]:
    """(Points of `PathTable.wave` in a band, in log f from -1 to 1; their weights, which sum to one)."""
    x, weight = np.polynomial.legendre.leggauss(WAVE_POINTS)
    return x, 0.5 * weight
