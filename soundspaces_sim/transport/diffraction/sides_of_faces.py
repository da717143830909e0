"""On which side of a wedge's faces the leg between two edges is."""

from __future__ import annotations

import math

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, dot
from soundspaces_sim.transport.diffraction.wedges import Wedges, edge_point, wedge_coordinates

_ON_FACE = 0.01  # rad: a point so near to a face is on it
BY_BOTH = (1.0, 1.0)  # ends whose turns say on which side of a plate a path is


@part(forceinline=True)
def snapped(phi: float, sector: float) -> float:
    """The angle of a face for a point on it, whichever side of the face rounding puts the point."""
    if phi < _ON_FACE or phi > 2.0 * math.pi - _ON_FACE:
        return 0.0 if sector < 2.0 * math.pi - _ON_FACE or phi < _ON_FACE else sector
    return sector if abs(phi - sector) < _ON_FACE else phi


@part(forceinline=True)
def _on_a_face(phi: float, sector: float) -> bool:
    return phi <= 0.0 or phi >= sector


@part(forceinline=True)
def on_faces(phi: tuple[float, float], sectors: tuple[float, float]) -> bool:
    """Whether the leg between two edges is on a face of both: its angles about them and their sectors, rad."""
    return _on_a_face(phi[0], sectors[0]) and _on_a_face(phi[1], sectors[1])


@part(forceinline=True)
def face_normal(wedges: Wedges, e: int, phi: float) -> Vec3:
    """Normal, into the open sector, of the face of a wedge at phi = 0, or else of the other one."""
    f, t = wedges.face[e], wedges.normal[e]
    if phi <= 0.0:
        return t[0], t[1], t[2]
    c, d = math.cos(math.pi * wedges.n[e]), math.sin(math.pi * wedges.n[e])
    return d * f[0] - c * t[0], d * f[1] - c * t[1], d * f[2] - c * t[2]


@part
def on_one_side(
    wedges: Wedges,
    edges: tuple[int, int],
    along: tuple[float, float],
    ends: tuple[float, float],
    by: tuple[float, float],
) -> tuple[float, float]:
    """Angles of the leg between two edges about both. A thin plate has both its faces in that direction: the leg is
    on the side of the other edge's face or, along a plate with two free edges, on that with the smaller turns,
    weighed `by` these."""
    sector_e, sector_f = math.pi * wedges.n[edges[0]], math.pi * wedges.n[edges[1]]
    plate_e, plate_f = sector_e > 2.0 * math.pi - _ON_FACE, sector_f > 2.0 * math.pi - _ON_FACE
    if not ((plate_e or plate_f) and on_faces(along, (sector_e, sector_f))):
        return along
    best, least = along, math.inf
    for i in range(2):
        for j in range(2):
            tried = (sector_e * i if plate_e else along[0]), (sector_f * j if plate_f else along[1])
            same = (
                dot(face_normal(wedges, edges[0], tried[0]), face_normal(wedges, edges[1], tried[1]))
                > 0.0
            )
            turns = by[0] * abs(ends[0] - tried[0]) + by[1] * abs(ends[1] - tried[1])
            if same and turns < least:
                best, least = tried, turns
    return best


@part
def common_face(
    wedges: Wedges, edges: tuple[int, int], ends: tuple[Vec3, Vec3]
) -> tuple[bool, tuple[float, float]]:
    """(Whether a face connects two parallel edges, its angles about both); of a plate that on the side of both
    ends."""
    (e, f), (p, q) = edges, ends
    sector_e, sector_f = math.pi * wedges.n[e], math.pi * wedges.n[f]
    to_f = wedge_coordinates(wedges, e, edge_point(wedges, f, 0.5 * wedges.length[f])).phi
    to_e = wedge_coordinates(wedges, f, edge_point(wedges, e, 0.5 * wedges.length[e])).phi
    about_e = wedge_coordinates(wedges, e, p).phi + wedge_coordinates(wedges, e, q).phi
    about_f = wedge_coordinates(wedges, f, p).phi + wedge_coordinates(wedges, f, q).phi
    along = snapped(to_f, sector_e), snapped(to_e, sector_f)
    phi = on_one_side(wedges, edges, along, (0.5 * about_e, 0.5 * about_f), BY_BOTH)
    return on_faces(phi, (sector_e, sector_f)), phi
