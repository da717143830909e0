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
from soundspaces_sim.core.numerics.vec3 import Vec3, dot, length, row, subtract

_PARALLEL = 0.999  # cosine between edges
ON_FACE = 0.01  # rad: what is so near to a face is on it
OFF_LINE = 0.25  # of `offset`: a fitted edge's line may be so far off
_TOLERANCE = 1e-5  # rad, of rays about a shadow boundary
BOUNDARY_OFFSET = 1e-8  # rad: at a boundary the two parts of a field jump
_INSET = 0.01  # m, from an edge's end: there, it often stands on something


class Wedges(NamedTuple):
    """E wedges, their coordinates relative to the scene's centre."""

    start: np.ndarray  # (E, 3) m, of the edge
    along: np.ndarray  # (E, 3) unit, along the edge
    length: np.ndarray  # (E,) m
    face: np.ndarray  # (E, 3) unit, in the first face, away from the edge
    normal: np.ndarray  # (E, 3) unit, of the first face, into the open sector
    n: np.ndarray  # (E,) wedge index: open sector / pi, 1 to 2
    offset: np.ndarray  # (E, 3) m, from the edge to where rays just clear it
    clear: np.ndarray  # (E, 3) m, the same or farther off, to where rays pass it
    stands: np.ndarray  # (E, 2) whether its start and its end are on a surface


class WedgeCoordinates(NamedTuple):
    """Where a point is about a wedge."""

    z: float  # m
    r: float  # m
    phi: float  # rad


def no_wedges() -> Wedges:
    """None."""
    v, s = np.empty((0, 3)), np.empty(0)
    return Wedges(v, v, s, v, v, s, v, v, np.empty((0, 2), np.bool_))


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
def on_face(wedges: Wedges, e: int, f: int, r: float) -> float:
    """Angle about either of two edges, r m apart, up to which the other one is on its face, rad."""
    a, b = row(wedges.offset, e), row(wedges.offset, f)
    return ON_FACE + OFF_LINE * (length(a) + length(b)) / r


@part(forceinline=True)
def edge_point(wedges: Wedges, e: int, z: float) -> Vec3:
    """The point at `z` m on an edge."""
    s, a = wedges.start[e], wedges.along[e]
    return s[0] + z * a[0], s[1] + z * a[1], s[2] + z * a[2]


@part(forceinline=True)
def clear_point(wedges: Wedges, e: int, z: float) -> Vec3:
    """`edge_point`, moved into the open sector to where rays pass the edge."""
    s, a, m = wedges.start[e], wedges.along[e], wedges.clear[e]
    return s[0] + z * a[0] + m[0], s[1] + z * a[1] + m[1], s[2] + z * a[2] + m[2]


@part(forceinline=True)
def cuts_of(wedges: Wedges, e: int, s: float, r: float) -> tuple[float, float]:
    """1 for the start of an edge and for its end, if it ends there (T33a); 0 where it is on a surface before
    which both ends of a path are, `s` and `r` m along the edge.

    What the surface takes of the diffracted wave it does not take of the direct sound: the edge is to both as if
    surface and sound went on beyond.
    """
    stands, length = wedges.stands, wedges.length[e]
    at_start, at_end = stands[e, 0] and min(s, r) > 0.0, stands[e, 1] and max(s, r) < length
    return 0.0 if at_start else 1.0, 0.0 if at_end else 1.0


@part(forceinline=True)
def cosine_taper(x: float) -> float:
    """cos²(pi x / 2): from 1 at 0, smoothly to 0 at 1."""
    return math.cos(0.5 * math.pi * x) ** 2 if x < 1.0 else 0.0


@part(forceinline=True)
def boundary_tolerance(wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates) -> float:
    """Angle within which rays do not tell light from shadow, rad: a mesh strays from an edge's line by up to its
    `offset`."""
    m = wedges.offset[e]
    return _TOLERANCE + math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]) * (1.0 / s.r + 1.0 / r.r)


@part(forceinline=True)
def met_edge(wedges: Wedges, e: int, z: float) -> Vec3:
    """Where a path meets an edge whose line it meets at `z` m; at the end beyond which that is."""
    return edge_point(wedges, e, min(max(z, 0.0), wedges.length[e]))


@part(forceinline=True)
def met_point(wedges: Wedges, e: int, z: float) -> Vec3:
    """The same, off the edge and its ends as rays need."""
    length = wedges.length[e]
    inset = min(_INSET, 0.25 * length)
    return clear_point(wedges, e, min(max(z, inset), length - inset))
