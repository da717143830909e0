"""The receiver volume of a point: the neighbourhood in which it detects passing subpaths.

A detector of nominal radius r is not the ball |x - q| < r but its part that q can see, kept as a
star-shaped region: in each of `CELLS` equal-area cells of directions the reach is the least clear
distance among a few rays. So the region's volume, which normalises the track-length estimator, is known
exactly, and a segment is seldom hidden in it: where something is as near as that, a shadow ray tells, for
edges that protrude between these rays hide a little of the region.

The radius grows with the length of the path, r = min(r_min + growth * length, r_max), in `LEVELS`
steps: the late field is smooth over a metre, the early one is not. It depends on the whole path's
length alone, so MIS stays exact.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray

_ROWS, _COLUMNS = 12, 24  # equal steps in z and in azimuth: cells of equal solid angle
CELLS = _ROWS * _COLUMNS
_RAYS = 4  # per side of a cell
LEVELS = 24
_GROUP = 6  # points tested together
_CLEAR = 0.8  # of the least reach: an edge of 60° between rays, the widest 19° apart, is no nearer


class Radii(NamedTuple):
    """Nominal radius against path length."""

    radius: np.ndarray  # (LEVELS,) m
    least: float
    growth: float  # m per m of path


class Detectors(NamedTuple):
    """N points that detect."""

    points: np.ndarray  # (N, 3) m
    keys: np.ndarray  # (N,) uint64
    reach: np.ndarray  # (N, CELLS) m
    clearance: np.ndarray  # (N,) m, within which nothing is
    volume: np.ndarray  # (N, LEVELS) m^3
    section: np.ndarray  # (N, LEVELS) m^2, mean cross-section eta
    order: np.ndarray  # (N,) points by group
    sorted_points: np.ndarray  # (N, 3) points[order]
    group_start: np.ndarray  # (G + 1,)
    group_sphere: np.ndarray  # (4, G) centre and radius that hold a group's points


@part(forceinline=True)
def direction_cell(x: float, y: float, z: float) -> int:
    """Cell of a unit direction."""
    row = min(int((z + 1.0) * 0.5 * _ROWS), _ROWS - 1)
    column = min(int((math.atan2(y, x) / (2.0 * math.pi) + 0.5) * _COLUMNS), _COLUMNS - 1)
    return row * _COLUMNS + column


@part(forceinline=True)
def level_of(radii: Radii, length: float) -> int:
    """Radius step of a path of this length."""
    levels = len(radii.radius)
    if levels == 1:
        return 0
    span = radii.radius[levels - 1] - radii.least
    k = int(radii.growth * length / span * (levels - 1))
    return min(k, levels - 1)


@kernel
def _measure_reach(
    first: int,
    last: int,
    geometry: Geometry,
    points: np.ndarray,
    radius_max: float,
    reach: np.ndarray,
) -> None:
    """Fill rows of `reach` (N, CELLS): clear distance around each point, at most `radius_max`."""
    for i in range(first, last):
        for cell in range(CELLS):
            parallel, meridian = cell // _COLUMNS, cell % _COLUMNS
            least = radius_max
            for a in range(_RAYS):
                z = -1.0 + 2.0 * (parallel + a / (_RAYS - 1.0)) / _ROWS
                r = math.sqrt(max(0.0, 1.0 - z * z))
                for b in range(_RAYS):
                    phi = 2.0 * math.pi * ((meridian + b / (_RAYS - 1.0)) / _COLUMNS - 0.5)
                    direction = (r * math.cos(phi), r * math.sin(phi), z)
                    t, _ = cast_ray(geometry, row(points, i), direction, radius_max)
                    least = min(least, t)
            reach[i, cell] = least


def _group(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split points into compact groups of at most `_GROUP`: (order, starts, bounding spheres)."""
    groups = [np.arange(len(points))]
    while any(len(g) > _GROUP for g in groups):
        halves = []
        for g in groups:
            axis = int(np.ptp(points[g], axis=0).argmax())
            ranked = g[np.argsort(points[g, axis], kind="stable")]
            cut = len(g) // 2 if len(g) > _GROUP else 0
            halves += [ranked[:cut], ranked[cut:]] if cut else [ranked]
        groups = halves
    low = np.array([points[g].min(axis=0) for g in groups])
    high = np.array([points[g].max(axis=0) for g in groups])
    center = 0.5 * (low + high)
    radius = np.array(
        [np.linalg.norm(points[g] - c, axis=1).max() for g, c in zip(groups, center, strict=True)]
    )
    start = np.concatenate([[0], np.cumsum([len(g) for g in groups])])
    return np.concatenate(groups), start, np.concatenate([center, radius[:, None]], axis=1).T


class Growth(NamedTuple):
    """Radii of detectors: `least` m, more by `rate` m per m of path, up to `largest` m."""

    least: float
    rate: float
    largest: float


#: A radius blurs arrivals by its travel time, and noise falls as its square. With 1.5 m for 1 m the error of single
#: late bins falls by a sixth, and late energy by .08 to .15 dB (notes/laboratory.md).
GROWTH = Growth(0.1, 0.05, 1.0)


def make_radii(growth: Growth) -> Radii:
    """The radii of all levels."""
    least, rate, largest = growth
    if rate <= 0.0:
        return Radii(np.array([least]), least, 0.0)
    return Radii(np.linspace(least, largest, LEVELS), least, rate)


def make_detectors(geometry: Geometry, points: np.ndarray, keys: np.ndarray, radii: Radii) -> Detectors:
    """Detectors of (N, 3) points."""
    largest = float(radii.radius[-1])
    reach = np.empty((len(points), CELLS))
    over_rows(_measure_reach, len(points), geometry, points, largest, reach)
    clipped = np.minimum(reach[:, :, None], radii.radius[None, None, :])
    volume = (4.0 * math.pi / 3.0) * (clipped**3).mean(axis=1)
    section = volume / (4.0 / 3.0 * radii.radius)
    order, start, spheres = _group(points)
    return Detectors(
        points,
        keys,
        reach,
        _CLEAR * reach.min(axis=1),
        volume,
        section,
        order,
        np.ascontiguousarray(points[order]),
        start,
        np.ascontiguousarray(spheres),
    )
