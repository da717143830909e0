"""The wedges of a scene as kernels see them, and a point's coordinates about one.

A wedge is a straight edge and the sector between its two faces that is open to sound: n pi wide, n the wedge
index of Kouyoumjian & Pathak (1974), 3/2 at a right-angled corner, 2 at the free edge of a thin plate.
Coordinates about a wedge are cylindrical: z along the edge from its start, r from it, and phi from the first face
through the open sector, 0 to n pi.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, dot, row, subtract

_PARALLEL = 0.999  # cosine between edges


class Wedges(NamedTuple):
    """E wedges, their coordinates relative to the scene's centre."""

    start: np.ndarray  # (E, 3) m, of the edge
    along: np.ndarray  # (E, 3) unit, along the edge
    length: np.ndarray  # (E,) m
    face: np.ndarray  # (E, 3) unit, in the first face, away from the edge
    normal: np.ndarray  # (E, 3) unit, of the first face, into the open sector
    n: np.ndarray  # (E,) wedge index: open sector / pi, 1 to 2
    offset: np.ndarray  # (E, 3) m, from the edge to where rays just clear it
    stands: np.ndarray  # (E, 2) whether its start and its end are on a surface
    #: (E, 2, 2) other edges that begin or end at its start, and at its end, or across a plate's side; -1 for none
    corner: np.ndarray


class WedgeCoordinates(NamedTuple):
    """Where a point is about a wedge."""

    z: float  # m
    r: float  # m
    phi: float  # rad


def no_wedges() -> Wedges:
    """None."""
    v, s = np.empty((0, 3)), np.empty(0)
    return Wedges(v, v, s, v, v, s, v, np.empty((0, 2), np.bool_), np.empty((0, 2, 2), np.int64))


@part(forceinline=True)
def wedge_coordinates(wedges: Wedges, e: int, point: Vec3) -> WedgeCoordinates:
    """Coordinates of a point about wedge `e`; phi from 0 to 2 pi."""
    v = subtract(point, row(wedges.start, e))
    x, y = dot(v, row(wedges.face, e)), dot(v, row(wedges.normal, e))
    phi = math.atan2(y, x)
    if phi < 0.0:
        phi += 2.0 * math.pi
    return WedgeCoordinates(dot(v, row(wedges.along, e)), math.sqrt(x * x + y * y), phi)


@part(forceinline=True)
def line_coordinates(wedges: Wedges, e: int, point: Vec3) -> tuple[float, float]:
    """(z, r) of `wedge_coordinates`, which takes an arctangent for phi."""
    v = subtract(point, row(wedges.start, e))
    x, y = dot(v, row(wedges.face, e)), dot(v, row(wedges.normal, e))
    return dot(v, row(wedges.along, e)), math.sqrt(x * x + y * y)


@part(forceinline=True)
def parallel(wedges: Wedges, e: int, f: int) -> bool:
    """Whether two edges have one direction, or opposite ones."""
    return abs(dot(row(wedges.along, e), row(wedges.along, f))) > _PARALLEL


@part(forceinline=True)
def edge_point(wedges: Wedges, e: int, z: float) -> Vec3:
    """The point at `z` m on an edge."""
    s, a = wedges.start[e], wedges.along[e]
    return s[0] + z * a[0], s[1] + z * a[1], s[2] + z * a[2]


@part(forceinline=True)
def clear_point(wedges: Wedges, e: int, z: float) -> Vec3:
    """`edge_point`, moved into the open sector as far as rays need to clear the edge."""
    s, a, m = wedges.start[e], wedges.along[e], wedges.offset[e]
    return s[0] + z * a[0] + m[0], s[1] + z * a[1] + m[1], s[2] + z * a[2] + m[2]
