"""Sound of a line source about rigid bodies in two dimensions, by boundary elements: the reference for edges.

The total field u on the surface solves u / 2 = u_inc + integral of u dG/dn, G = -j/4 H0(kr) of the second kind, and
the same integral gives it elsewhere. Panels have eight Gauss points, at most a wave long, and halve towards corners.
Walls without end are cut by turning the coordinate along them into the complex plane, where the outgoing field decays
(complex scaling, as in perfectly matched layers): no wave comes back from there. A floor at y = 0 is the mirror image
of all bodies and of the source. Bodies that are closed have frequencies at which the equation is singular: rows for
points inside, where the same sum is zero, are added (Schenck 1968, J. Acoust. Soc. Am. 44), by least squares.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import hankel2, j0, j1, y0, y1

_X, _W = np.polynomial.legendre.leggauss(8)
_LEAST = 1e-4  # m, panel at a corner


class Surface(NamedTuple):
    """Points of a surface: places (n, 2) complex m, weights (n,), normals into the air (n, 2), number of the face."""

    at: np.ndarray
    weight: np.ndarray
    normal: np.ndarray
    face: np.ndarray


class Body(NamedTuple):
    """A chain of corners (n, 2) m with the air on its left; `endless`: its first and last face go on downwards."""

    corners: np.ndarray
    endless: bool = False
    on_floor: bool = False  # its first and last corners are on the floor


def slab(left: float, right: float, top: float = 0.0, depth: float = 1.5) -> Body:
    """A wall without a lower end."""
    return Body(np.array([[right, -depth], [right, top], [left, top], [left, -depth]]), endless=True)


def box(x0: float, x1: float, y0: float, y1: float) -> Body:
    """A body with the four corners; on a floor if y0 is 0."""
    if y0 == 0.0:
        return Body(np.array([[x1, y0], [x1, y1], [x0, y1], [x0, y0]]), on_floor=True)
    return Body(np.array([[x1, y0], [x1, y1], [x0, y1], [x0, y0], [x1, y0]]))


def _breaks(length: float, longest: float, graded: tuple[bool, bool]) -> np.ndarray:
    marks = {0.0, length}
    step = _LEAST
    while step < min(0.5 * length, longest):
        if graded[0]:
            marks.add(step)
        if graded[1]:
            marks.add(length - step)
        step *= 2.0
    at = sorted(marks)
    parts = [
        np.linspace(a, b, max(int(np.ceil((b - a) / longest)), 1) + 1)[:-1] for a, b in pairwise(at)
    ]
    return np.append(np.concatenate(parts), length)


def _face(
    a: np.ndarray, b: np.ndarray, longest: float, graded: tuple[bool, bool]
) -> tuple[np.ndarray, ...]:
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    ends = _breaks(length, longest, graded)
    half = 0.5 * np.diff(ends)[:, None]
    s = (0.5 * (ends[1:] + ends[:-1])[:, None] + half * _X).ravel()
    normal = np.tile([along[1], -along[0]], (len(s), 1))
    return a + s[:, None] * along + 0j, (half * _W).ravel() + 0j, normal


def surface(bodies: list[Body], k: float) -> Surface:
    """All faces of some bodies at a wave number, 1/m."""
    wave, parts, number = 2.0 * np.pi / k, [], 0
    for body in bodies:
        widest = np.ptp(body.corners[:, 0])
        longest = min(wave, 0.5, 4.0 * widest)
        last = len(body.corners) - 2
        for i in range(last + 1):
            a, b = body.corners[i], body.corners[i + 1]
            free = body.endless or body.on_floor
            graded = (not (free and i == 0), not (free and i == last))
            pieces = [_face(a, b, longest, graded)]
            if body.endless and i in (0, last):
                foot, tail = (a, 12.0 / k) if i == 0 else (b, 12.0 / k)
                at, weight, normal = _face(foot, foot - [0.0, tail], longest, (False, False))
                down = foot[1] - at[:, 1].real
                at[:, 1] = foot[1] - down * (1.0 - 1.0j)
                pieces.append((at, weight * (1.0 - 1.0j), np.tile(pieces[0][2][0], (len(at), 1))))
            for at, weight, normal in pieces:
                parts.append((at, weight, normal, np.full(len(at), number)))
            number += 1
    return Surface(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _hankel(order: int, z: np.ndarray) -> np.ndarray:
    """Of the second kind, order 0 or 1; most arguments are real, for which there are faster functions."""
    real, out = z.imag == 0.0, np.empty(z.shape, complex)
    j, y = ((j0, y0), (j1, y1))[order]
    x = z[real].real
    out[real] = j(x) - 1j * y(x)
    out[~real] = hankel2(order, z[~real])
    return out


def _source(k: float, at: np.ndarray, source: np.ndarray) -> np.ndarray:
    return np.asarray(-0.25j * _hankel(0, k * np.sqrt(((at - source) ** 2).sum(axis=1))))


def _kernel(k: float, at: np.ndarray, on: Surface, own: np.ndarray | None = None) -> np.ndarray:
    """dG/dn of the surface's points at places (m, 2), times their weights; 0 on the face `own` (m,) of a place."""
    d = on.at[None] - at[:, None]
    r = np.sqrt((d**2).sum(axis=2))
    same = np.zeros(r.shape, bool) if own is None else own[:, None] == on.face[None]
    r[same] = 1.0
    out = 0.25j * k * _hankel(1, k * r) * (d * on.normal).sum(axis=2) / r * on.weight
    out[same] = 0.0
    return np.asarray(out)


def _mirrored(on: Surface) -> Surface:
    down = np.array([1.0, -1.0])
    return on._replace(at=on.at * down, normal=on.normal * down)


def pressures(
    bodies: list[Body], source: np.ndarray, places: np.ndarray, k: float, floor: bool, seed: int = 1
) -> np.ndarray:
    """(m,) total field at places (m, 2), over the amplitude of a line source, so that it is e^(-jkr)/sqrt(r) in the
    far free field."""
    on = surface(bodies, k)
    images = [on, _mirrored(on)] if floor else [on]
    ends = [source, source * [1.0, -1.0]] if floor else [source]

    def incident(at: np.ndarray) -> np.ndarray:
        return np.asarray(sum(_source(k, at, x) for x in ends))

    def sums(at: np.ndarray, own: np.ndarray | None = None) -> np.ndarray:
        return np.asarray(_kernel(k, at, on, own) + sum(_kernel(k, at, x) for x in images[1:]))

    matrix, right = 0.5 * np.eye(len(on.at)) - sums(on.at, on.face), incident(on.at)
    closed = [b.corners for b in bodies if not b.endless]
    if closed:
        random = np.random.default_rng(seed)
        count = int(6 + 4.0 * k * np.mean([np.ptp(c, axis=0).mean() for c in closed]))
        inside = np.concatenate(
            [c.min(axis=0) + random.uniform(0.1, 0.9, (count, 2)) * np.ptp(c, axis=0) for c in closed]
        )
        matrix = np.concatenate([matrix, -sums(inside + 0j)])
        right = np.concatenate([right, incident(inside + 0j)])
        adjoint = matrix.conj().T
        u = np.linalg.solve(adjoint @ matrix, adjoint @ right)
    else:
        u = np.linalg.solve(matrix, right)
    total = incident(places + 0j) + sums(places + 0j) @ u
    far = -0.25j * np.sqrt(2.0 / (np.pi * k)) * np.exp(0.25j * np.pi)
    return np.asarray(total / far)
