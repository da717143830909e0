"""Where to send walks that only mirror: the directions along which sound lives long.

Late sound that was never scattered runs along the few directions that miss everything soft, and what they are
is a property of the scene: in a house those between its hard walls. A pilot from all over its surfaces finds how
much energy is left of each direction after some reflections; walks are drawn from that, and a part evenly,
and weigh the inverse of their density (importance sampling), so that no expectation hangs on it.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.base.kernel import kernel, over_rows, part
from soundspaces_sim.base.rng import combine, hashed_uniform
from soundspaces_sim.rays.directions import sample_sphere
from soundspaces_sim.rays.geometry import Geometry
from soundspaces_sim.transport.bounce import leave, meet
from soundspaces_sim.transport.lobes import MIRROR, THROUGH
from soundspaces_sim.transport.surface import Surfaces, total, weaken

_CELLS = 64  # along either coordinate of the sphere
_PILOTS = 16  # walks per cell
_AFTER = np.array([0.1, 0.2])  # of the echogram's length: where the survivors count, alike
_MOST_EVENTS = 500
_EVEN = 0.5  # of the density
_STREAM = 0x6D1E


class Guide(NamedTuple):
    """A density on the unit square of `sample_sphere`, even in each of n × n cells, with mean 1."""

    density: np.ndarray  # (n, n)
    rows: np.ndarray  # (n + 1,) cumulative
    columns: np.ndarray  # (n, n + 1) cumulative within each row


@part
def _invert(cumulative, u):
    """(cell, place in [0, 1)) at which a piecewise linear `cumulative` (n + 1,) from 0 to 1 reaches u in [0, 1)."""
    low, high = 0, len(cumulative) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if cumulative[middle] <= u:
            low = middle
        else:
            high = middle
    width = cumulative[low + 1] - cumulative[low]
    return low, min(max((u - cumulative[low]) / width, 0.0), 1.0)


@part
def sample_guided(guide, u, v):
    """(unit direction, 4 pi times its density) from two uniform numbers; stratified ones stay so."""
    n = len(guide.density)
    i, s = _invert(guide.rows, u)
    j, t = _invert(guide.columns[i], v)
    return sample_sphere((i + s) / n, (j + t) / n), guide.density[i, j]


@part
def _pass_on(surfaces, material, cos, beta, u):
    """Weigh `beta` by what is mirrored or passes, one of them chosen; the lobe, -1 if nothing is left."""
    mirror, through = total(surfaces, material, MIRROR), total(surfaces, material, THROUGH)
    if mirror + through <= 0.0:
        return -1
    chance = through / (mirror + through)
    lobe = THROUGH if u < chance else MIRROR
    weaken(surfaces, material, lobe, cos, beta, chance if lobe == THROUGH else 1.0 - chance)
    return lobe


@kernel
def _explore(first, last, geometry, surfaces, corners, upto, cells, after, left, weight, work):
    """Fill `left` (n, stages, b) and `weight` (n,): pilots `first` to `last`, `cells`² directions in turn."""
    beta = work
    for k in range(first, last):
        key = combine(_STREAM, k)
        cell = k % (cells * cells)
        d = sample_sphere(
            (cell // cells + hashed_uniform(key, 0)) / cells,
            (cell % cells + hashed_uniform(key, 1)) / cells,
        )
        face, _ = _invert(upto, hashed_uniform(key, 2))
        root, w = np.sqrt(hashed_uniform(key, 3)), hashed_uniform(key, 4)
        n, c = geometry.normal[face], corners[face]
        cosine = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
        lift = geometry.epsilon if cosine > 0.0 else -geometry.epsilon
        a, e, f = 1.0 - root, root * (1.0 - w), root * w
        origin = (
            a * c[0, 0] + e * c[1, 0] + f * c[2, 0] + lift * n[0],
            a * c[0, 1] + e * c[1, 1] + f * c[2, 1] + lift * n[1],
            a * c[0, 2] + e * c[1, 2] + f * c[2, 2] + lift * n[2],
        )
        weight[k] = abs(cosine)
        for b in range(len(beta)):
            beta[b] = weight[k]
        stage, event, length = 0, 0, 0.0
        while event < _MOST_EVENTS:
            t, triangle, x, m = meet(geometry, origin, d, np.inf)
            if triangle < 0:
                break
            length += t
            while stage < len(after) and length >= after[stage]:
                for b in range(len(beta)):
                    left[k, stage, b] = beta[b]
                stage += 1
            if stage == len(after):
                break
            event += 1
            draw = combine(key, 5 + event)
            cos = -(m[0] * d[0] + m[1] * d[1] + m[2] * d[2])
            lobe = _pass_on(surfaces, geometry.material[triangle], cos, beta, hashed_uniform(draw, 0))
            if lobe < 0:
                break
            origin, d = leave(geometry, lobe, x, m, d, 0.0, 0.0)


def make_guide(geometry: Geometry, surfaces: Surfaces, corners: np.ndarray, longest: float) -> Guide:
    """The guide of a scene of triangles (F, 3, 3), in m, relative to its centre, for paths of up to `longest` m.

    The same for every seed.
    """
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    upto = np.concatenate([[0.0], np.cumsum(area) / area.sum()])
    n, bands = _CELLS**2 * _PILOTS, surfaces.energy.shape[2]
    left, weight = np.zeros((n, len(_AFTER), bands)), np.zeros(n)
    over_rows(
        _explore, n, geometry, surfaces, np.ascontiguousarray(corners), upto, _CELLS, _AFTER * longest, left,
        weight,        scratch=lambda: np.empty(bands),
    )  # fmt: skip
    cells = (_PILOTS, _CELLS, _CELLS)
    even = _smooth(weight.reshape(cells).sum(axis=0))
    kept = left.reshape(*cells, -1).sum(axis=0)
    shares = [_smooth(x) / even for x in np.moveaxis(kept, -1, 0) if x.any()]
    guide = sum((x / x.mean() for x in shares), np.zeros((_CELLS, _CELLS)))
    return _guide(_EVEN + (1.0 - _EVEN) * guide / guide.mean() if shares else np.ones_like(guide))


def _smooth(table: np.ndarray) -> np.ndarray:
    """(n, n) mean over neighbours, binomial; the second coordinate runs round."""
    for _ in range(2):
        rows = np.pad(table, ((1, 1), (0, 0)), mode="edge")
        table = 0.25 * rows[:-2] + 0.5 * rows[1:-1] + 0.25 * rows[2:]
        table = 0.25 * np.roll(table, 1, axis=1) + 0.5 * table + 0.25 * np.roll(table, -1, axis=1)
    return table


def _guide(density: np.ndarray) -> Guide:
    density = density / density.mean()
    rows = np.concatenate([[0.0], np.cumsum(density.sum(axis=1)) / density.size])
    columns = np.cumsum(density, axis=1) / density.sum(axis=1, keepdims=True)
    columns = np.concatenate([np.zeros((len(density), 1)), columns], axis=1)
    rows[-1], columns[:, -1] = 1.0, 1.0
    return Guide(np.ascontiguousarray(density), rows, np.ascontiguousarray(columns))
