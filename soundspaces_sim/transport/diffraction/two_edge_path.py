"""The geometry of a path by two edges: the shortest one by way of their lines, and its angles.

An apex may be a little beyond the end of its edge: the path fades there, as what comes from between the ends does.
An end of the path may be in the light of the edge that is farther from it: then the path adds to that by one edge.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance
from soundspaces_sim.transport.diffraction.paths import BOUNDARY_OFFSET, cosine_taper
from soundspaces_sim.transport.diffraction.shortest_path import shortest_path
from soundspaces_sim.transport.diffraction.sides_of_faces import on_faces, on_one_side, snapped
from soundspaces_sim.transport.diffraction.two_edge_ends import on_both, taper_of_ends
from soundspaces_sim.transport.diffraction.wedges import Wedges, edge_point, parallel, wedge_coordinates

_MIN_RADIUS = 1e-6  # m, of a point about a wedge


class TwoEdgePath(NamedTuple):
    """The shortest path from p by the edges e and f to q; angles in rad, as in `WedgeCoordinates`."""

    e: int
    f: int
    p: Vec3
    q: Vec3
    z_e: float  # m along e
    z_f: float  # m along f
    at_e: Vec3
    at_f: Vec3
    d_p: float  # m, from p to e
    d_ef: float  # m
    d_q: float  # m, from f to q
    r_p: float  # m, of p about e
    r_q: float  # m, of q about f
    phi_p: float  # of p about e
    phi_f: float  # of the apex on f about e
    phi_e: float  # of the apex on e about f
    phi_q: float  # of q about f
    common: bool  # a face connects both edges
    lit_p: bool  # p is in the light of f, past e
    lit_q: bool  # q is in the light of e, past f
    taper: float  # of the energy: 1 where both apexes are on their edges, down to 0 beyond their ends


@part(forceinline=True)
def path_length(path: TwoEdgePath) -> float:
    """m"""
    return path.d_p + path.d_ef + path.d_q


@part(forceinline=True)
def _off_boundary(phi: float, towards: float, open_to: bool) -> tuple[bool, float]:
    """Whether an end at `phi` is in the light of what is at `towards`, which needs it in that edge's open sector;
    `phi`, off the boundary of the shadow."""
    turn = phi - towards
    lit = abs(turn) <= math.pi and open_to
    if abs(abs(turn) - math.pi) < BOUNDARY_OFFSET:
        lit = open_to  # on the plane of a face rounding may have it either way, about both edges alike
        turn = math.copysign(math.pi - BOUNDARY_OFFSET if lit else math.pi + BOUNDARY_OFFSET, turn)
    return lit, towards + turn


@part(forceinline=True)
def _opens(phi: float, towards: float, sector: float) -> float:
    """1; down to 0 where an end at `phi` comes to the plane of the face that sound from `towards` turns to, beyond
    which more edges go on."""
    depth = abs(phi - towards) - math.pi
    if depth <= 0.0:
        return 1.0
    left = sector - phi if phi > towards else phi
    return 1.0 - cosine_taper(max(left, 0.0) / depth)


@part(forceinline=True)
def _no_path(e: int, f: int, p: Vec3, q: Vec3) -> TwoEdgePath:
    x = math.nan
    return TwoEdgePath(e, f, p, q, x, x, p, q, x, x, x, x, x, x, x, x, x, False, False, False, 0.0)


@part
def two_edge_path(
    wedges: Wedges,
    e: int,
    f: int,
    p: Vec3,
    q: Vec3,
    by: tuple[float, float],
    reach: float,
) -> tuple[bool, TwoEdgePath]:
    """The path; whether its apexes are on their edges or, by detours up to `reach` m, beyond, and its legs in the
    open sectors of both wedges. `by`: see `sides_of_faces.on_one_side`, `BY_BOTH` for a path that neither end sees
    the other edge of."""
    z_e, z_f = shortest_path(wedges, e, f, p, q)
    at_e, at_f = edge_point(wedges, e, z_e), edge_point(wedges, f, z_f)
    taper = taper_of_ends(wedges, (e, f), (z_e, z_f), (p, q), (at_e, at_f), reach)
    if taper <= 0.0:  # also where the shortest path is not known
        return False, _no_path(e, f, p, q)
    p_e, f_e = wedge_coordinates(wedges, e, p), wedge_coordinates(wedges, e, at_f)
    q_f, e_f = wedge_coordinates(wedges, f, q), wedge_coordinates(wedges, f, at_e)
    sector_e, sector_f = math.pi * wedges.n[e], math.pi * wedges.n[f]
    phi_f, phi_e = on_one_side(
        wedges,
        (e, f),
        (snapped(f_e.phi, sector_e), snapped(e_f.phi, sector_f)),
        (p_e.phi, q_f.phi),
        by,
    )
    inside = max(p_e.phi, phi_f) <= sector_e and max(q_f.phi, phi_e) <= sector_f
    inside &= min(p_e.r, f_e.r, q_f.r, e_f.r) >= _MIN_RADIUS
    common = on_faces((phi_f, phi_e), (sector_e, sector_f))
    p_open = wedge_coordinates(wedges, f, p).phi <= sector_f
    q_open = wedge_coordinates(wedges, e, q).phi <= sector_e
    if not parallel(wedges, e, f):
        taper *= _opens(p_e.phi, phi_f, sector_e) * _opens(q_f.phi, phi_e, sector_f)
    lit_p, phi_p = _off_boundary(p_e.phi, phi_f, p_open)
    lit_q, phi_q = _off_boundary(q_f.phi, phi_e, q_open)
    return inside, TwoEdgePath(
        e=e,
        f=f,
        p=p,
        q=q,
        z_e=z_e,
        z_f=z_f,
        at_e=at_e,
        at_f=at_f,
        d_p=distance(p, at_e),
        d_ef=distance(at_e, at_f),
        d_q=distance(at_f, q),
        r_p=p_e.r,
        r_q=q_f.r,
        phi_p=phi_p,
        phi_f=phi_f,
        phi_e=phi_e,
        phi_q=phi_q,
        common=common,
        lit_p=lit_p,
        lit_q=lit_q,
        taper=taper,
    )


@part(forceinline=True)
def meets_both(wedges: Wedges, x: TwoEdgePath) -> bool:
    """Whether the apexes are on their edges."""
    return on_both(wedges, (x.e, x.f), (x.z_e, x.z_f))


@part(forceinline=True)
def is_strip(wedges: Wedges, x: TwoEdgePath) -> bool:
    """Whether a face connects both edges, which are parallel."""
    return x.common and parallel(wedges, x.e, x.f)
