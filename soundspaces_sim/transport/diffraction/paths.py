"""Geometry of a path by one edge: the apex by Keller's cone, its legs and angles, and where it counts.

The path is the shortest one by way of the edge's line; its two legs make the same angle beta with the edge (Keller
1962, Geometrical theory of diffraction, J. Opt. Soc. Am. 52 (2)). All is computed from the end of the smaller angle
phi to the other one, so that a pair gives the same bits whichever end is the source.
"""

import math
from typing import NamedTuple

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.transport.diffraction.utd import (
    WedgeTerms,
    share_of_edge,
    wedge_field,
    wedge_terms,
)
from soundspaces_sim.transport.diffraction.wedges import WedgeCoordinates, Wedges, clear_point

MAX_DETOUR = 2.0  # m, by an edge, up to which it matters to geometrical sound
_MAX_BEYOND = 0.5  # m, detour by an end of an edge beyond which the apex lies, up to which it counts
_TOLERANCE = 1e-5  # rad, of rays about a shadow boundary
BOUNDARY_OFFSET = 1e-8  # rad
_INSET = 0.01  # m, from an edge's end: there, it often stands on something


class DiffractedPath(NamedTuple):
    """A path by one edge, in the symbols of `utd`."""

    n: float  # wedge index
    phi_s: float  # rad
    phi_r: float  # rad
    d_s: float  # m, leg from the source to the apex
    d_r: float  # m, leg from the apex to the receiver
    sin_beta: float
    apex: float  # m along the edge
    edge_length: float  # m
    detour_start: float  # m, by way of the edge's start over the path by the apex
    detour_end: float  # m, by way of its end
    taper: float  # of the energy: 1 where the apex is on the edge, down to 0 beyond its ends
    cut_start: float  # part of what comes from beyond the start of the edge's line that the edge lacks
    cut_end: float
    reflected_cuts: tuple[float, float]  # the same of the terms of the reflected waves


@part
def diffracted_path(
    n: float, edge_length: float, s: WedgeCoordinates, r: WedgeCoordinates, phi_r: float
) -> DiffractedPath:
    """The path from s to r about an edge, with the receiver at the angle `phi_r` instead of r's."""
    total = math.sqrt((s.r + r.r) ** 2 + (r.z - s.z) ** 2)
    sin_beta = (s.r + r.r) / total
    apex = s.z + (r.z - s.z) * (s.r / (s.r + r.r))
    start = math.sqrt(s.r * s.r + s.z * s.z) + math.sqrt(r.r * r.r + r.z * r.z) - total
    xs, xr = edge_length - s.z, edge_length - r.z
    end = math.sqrt(s.r * s.r + xs * xs) + math.sqrt(r.r * r.r + xr * xr) - total
    start, end = max(start, 0.0), max(end, 0.0)
    taper = 1.0
    if apex < 0.0 or apex > edge_length:
        taper = cosine_taper(min(start, end) / _MAX_BEYOND)
    return DiffractedPath(
        n,
        s.phi,
        phi_r,
        s.r / sin_beta,
        r.r / sin_beta,
        sin_beta,
        apex,
        edge_length,
        start,
        end,
        taper,
        1.0,
        1.0,
        (1.0, 1.0),
    )


@part(forceinline=True)
def cuts_of(wedges: Wedges, e: int, s: float, r: float) -> tuple[float, float]:
    """1 for the start of an edge and for its end, as `share_of_edge` has it; 0 where it is on a surface before
    which both ends of a path are, `s` and `r` m along the edge.

    What the surface takes of the diffracted wave it does not take of the direct sound: the edge is to both as if
    surface and sound went on beyond.
    """
    stands, length = wedges.stands, wedges.length[e]
    at_start, at_end = stands[e, 0] and min(s, r) > 0.0, stands[e, 1] and max(s, r) < length
    return 0.0 if at_start else 1.0, 0.0 if at_end else 1.0


@part
def path_about(
    wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates, phi_r: float
) -> DiffractedPath:
    """`diffracted_path` about an edge of a scene. None, with no part of it, between two images in the surface that
    the edge stands on: what they would add is in the path between the points themselves."""
    path = diffracted_path(wedges.n[e], wedges.length[e], s, r, phi_r)
    cuts = cuts_of(wedges, e, s.z, r.z)
    taper, stands = path.taper, wedges.stands
    if (stands[e, 0] and max(s.z, r.z) < 0.0) or (stands[e, 1] and min(s.z, r.z) > wedges.length[e]):
        taper = 0.0
    return with_cuts(path, cuts, cuts, taper)


@part(forceinline=True)
def with_cuts(
    path: DiffractedPath, cuts: tuple[float, float], reflected: tuple[float, float], taper: float
) -> DiffractedPath:
    """A path with other cuts and another taper."""
    return DiffractedPath(
        n=path.n,
        phi_s=path.phi_s,
        phi_r=path.phi_r,
        d_s=path.d_s,
        d_r=path.d_r,
        sin_beta=path.sin_beta,
        apex=path.apex,
        edge_length=path.edge_length,
        detour_start=path.detour_start,
        detour_end=path.detour_end,
        taper=taper,
        cut_start=cuts[0],
        cut_end=cuts[1],
        reflected_cuts=reflected,
    )


@part(forceinline=True)
def terms_of(path: DiffractedPath) -> WedgeTerms:
    """What the fields of a path have in common at all wave numbers."""
    return wedge_terms(path.n, path.phi_s, path.phi_r)


@part(forceinline=True)
def edge_shares(path: DiffractedPath, k: float) -> tuple[complex, complex]:
    """Parts of an endless edge's field that come from between its ends, and from beyond where it is not cut: of the
    incident wave's terms, and of the reflected ones'."""
    detours, cuts = (path.detour_start, path.detour_end), (path.cut_start, path.cut_end)
    incident = share_of_edge(k, path.apex, path.edge_length, detours, cuts)
    if path.reflected_cuts[0] == cuts[0] and path.reflected_cuts[1] == cuts[1]:
        return incident, incident
    return incident, share_of_edge(k, path.apex, path.edge_length, detours, path.reflected_cuts)


@part(forceinline=True)
def path_field(path: DiffractedPath, terms: WedgeTerms, k: float, reflected_weight: float) -> complex:
    """Diffracted field at a wave number, 1/m: the incident wave's terms and so much of the reflected one's."""
    incident, reflected = wedge_field(path.n, terms, path.d_s, path.d_r, path.sin_beta, k)
    of_incident, of_reflected = edge_shares(path, k)
    return incident * of_incident + reflected_weight * reflected * of_reflected


@part(forceinline=True)
def beyond(apex: float, length: float, detours: tuple[float, float]) -> float:
    """That of the `detours` by the start and by the end of an edge which an apex lies beyond, m; 0 on the edge."""
    if apex < 0.0:
        return detours[0]
    return detours[1] if apex > length else 0.0


@part(forceinline=True)
def beyond_end(path: DiffractedPath) -> float:
    """Detour by the end of an edge beyond which the apex lies, m; 0 on the edge."""
    return beyond(path.apex, path.edge_length, (path.detour_start, path.detour_end))


@part(forceinline=True)
def cosine_taper(x: float) -> float:
    """cos²(pi x / 2): from 1 at 0, smoothly to 0 at 1."""
    return math.cos(0.5 * math.pi * x) ** 2 if x < 1.0 else 0.0


@part(forceinline=True)
def faded_in(energy: float, least: float) -> float:
    """0 up to the least energy, from there smoothly to 1 at three times that."""
    if least <= 0.0:
        return 1.0
    return 1.0 - cosine_taper(0.5 * (energy / least - 1.0)) if energy > least else 0.0


@part(forceinline=True)
def in_order(s: WedgeCoordinates, r: WedgeCoordinates) -> tuple[WedgeCoordinates, WedgeCoordinates]:
    """Two points about a wedge, that at the smaller angle first."""
    if s.phi != r.phi:
        first = s.phi < r.phi
    elif s.r != r.r:
        first = s.r < r.r
    else:
        first = s.z <= r.z
    return (s, r) if first else (r, s)


@part(forceinline=True)
def boundary_tolerance(wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates) -> float:
    """Angle within which rays do not tell light from shadow, as they pass an edge at its `offset`, rad."""
    return _TOLERANCE + offset_length(wedges, e) * (1.0 / s.r + 1.0 / r.r)


@part(forceinline=True)
def offset_length(wedges: Wedges, e: int) -> float:
    """m"""
    m = wedges.offset[e]
    return math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2])


@part(forceinline=True)
def beyond_tolerance(s: WedgeCoordinates, r: WedgeCoordinates, offset: float) -> bool:
    """Whether a path is so far in the light that no tolerance brings it into the shadow; `s`, `r` in any order."""
    depth = abs(s.phi - r.phi) - math.pi
    return (-depth - _TOLERANCE) * min(s.r, r.r) > 2.0 * offset + BOUNDARY_OFFSET


@part(forceinline=True)
def contradicts(wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates, lit: bool) -> bool:
    """Whether two points, in order, are on the other side of an edge's shadow boundary than rays have found."""
    depth, tolerance = r.phi - s.phi - math.pi, boundary_tolerance(wedges, e, s, r)
    return (depth > tolerance) if lit else (depth < -tolerance)


@part(forceinline=True)
def off_boundary(s: WedgeCoordinates, r: WedgeCoordinates, lit: bool) -> float:
    """phi of the receiver, moved to the lit or the shadow side: at the boundary the field's two parts jump."""
    if lit:
        return s.phi + min(r.phi - s.phi, math.pi - BOUNDARY_OFFSET)
    return s.phi + max(r.phi - s.phi, math.pi + BOUNDARY_OFFSET)


@part(forceinline=True)
def apex_point(wedges: Wedges, e: int, path: DiffractedPath) -> Vec3:
    """Where a path meets its edge: the apex, or near the end beyond which it is; off the edge as rays need."""
    return met_point(wedges, e, path.apex)


@part(forceinline=True)
def on_edge(wedges: Wedges, e: int, z: float) -> float:
    """Where a path meets an edge, m, whose line it meets at `z`: there, or near the end beyond which that is."""
    length = wedges.length[e]
    inset = min(_INSET, 0.25 * length)
    return min(max(z, inset), length - inset)


@part(forceinline=True)
def met_point(wedges: Wedges, e: int, z: float) -> Vec3:
    """Where a path meets an edge whose line it meets at `z` m, off the edge as rays need."""
    return clear_point(wedges, e, on_edge(wedges, e, z))
