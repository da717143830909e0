"""Geometry of a reflection beside an edge of its plane: which face reflects, how the path misses it or meets it."""

from __future__ import annotations

import math
from typing import NamedTuple

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport.diffraction.passed_edges import EdgePair
from soundspaces_sim.transport.diffraction.paths import DiffractedPath, path_about
from soundspaces_sim.transport.diffraction.wedges import WedgeCoordinates, Wedges, wedge_coordinates

_ON_BOUNDARY = 1e-9  # rad: on the boundary of a reflection `utd` is on the side of the reflection


class Reflection(NamedTuple):
    """How an edge is passed by the reflection whose boundary it makes."""

    beside: float  # rad, by which the path misses the face
    length: float  # m, of the path by the endless plane


@part(forceinline=True)
def face_between(wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates) -> int:
    """The face, 0 or 1, of the smaller angle phi' + phi between two points."""
    return 0 if s.phi + r.phi <= math.pi * wedges.n[e] else 1


@part(forceinline=True)
def turn_by(wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates, face: int) -> float:
    """The angle between two points about an edge by one of its faces, rad."""
    total = s.phi + r.phi
    return total if face == 0 else 2.0 * math.pi * wedges.n[e] - total


@part(forceinline=True)
def least_detour(s: WedgeCoordinates, r: WedgeCoordinates, turn: float) -> float:
    """A bound from below of the detour by an edge over the reflection beside it, m: 1 - cos x is at least
    x² / 2 - x⁴ / 24."""
    x, dz = (turn - math.pi) ** 2, r.z - s.z
    square = (s.r + r.r) ** 2 + dz * dz
    reflected = square - 2.0 * s.r * r.r * x * max(0.5 - x / 24.0, 0.0)
    return math.sqrt(square) - math.sqrt(max(reflected, 0.0))


@part
def reflection_by(wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates) -> Reflection:
    """For points in order, by the face of `face_between`, unfolded."""
    angle, dz = turn_by(wedges, e, s, r, face_between(wedges, e, s, r)), r.z - s.z
    length = math.sqrt(dz * dz + s.r * s.r + r.r * r.r - 2.0 * s.r * r.r * math.cos(angle))
    return Reflection(angle - math.pi, length)


@part
def path_beside(
    wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates, beside: float
) -> DiffractedPath:
    """The path by an edge, its reflection missing the face by `beside` rad."""
    sector, total = math.pi * wedges.n[e], s.phi + r.phi
    target = math.pi + beside if total <= sector else 2.0 * sector - math.pi - beside
    return path_about(wedges, e, s, r, r.phi + target - total)


@part(forceinline=True)
def is_behind(sector: float, s: WedgeCoordinates, r: WedgeCoordinates, face: int) -> bool:
    """Whether one of two ends in order is behind the plane of a face."""
    return (r.phi if face == 0 else sector - s.phi) > math.pi


@part(forceinline=True)
def below_face(wedges: Wedges, e: int, face: float, pair: EdgePair) -> bool:
    """Whether an end is below the plane of the face at the angle `face` about a wedge."""
    a, b = wedge_coordinates(wedges, e, pair.p.at), wedge_coordinates(wedges, e, pair.q.at)
    return max(abs(a.phi - face), abs(b.phi - face)) > math.pi


@part
def reflection_in_face(wedges: Wedges, e: int, face: float, pair: EdgePair) -> tuple[float, bool]:
    """(Length, m, of the reflection by the endless face at the angle `face` about a wedge; whether the face begins
    before it at this edge)."""
    a, b = wedge_coordinates(wedges, e, pair.p.at), wedge_coordinates(wedges, e, pair.q.at)
    angle, dz = abs(a.phi - face) + abs(b.phi - face), a.z - b.z
    square = dz * dz + a.r * a.r + b.r * b.r - 2.0 * a.r * b.r * math.cos(angle)
    return math.sqrt(max(square, 0.0)), angle < math.pi + _ON_BOUNDARY
