"""Where a path by two edges goes beyond their ends: detours by these, and how the path fades."""

from __future__ import annotations

import math

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance
from soundspaces_sim.transport.diffraction.paths import beyond, cosine_taper
from soundspaces_sim.transport.diffraction.wedges import Wedges, edge_point, line_coordinates, parallel


@part(forceinline=True)
def _detour(wedges: Wedges, e: int, z: float, p: Vec3, q: Vec3, straight: float) -> float:
    """Of the way from p by z on an edge to q, over one of length `straight`, m."""
    at = edge_point(wedges, e, z)
    return max(distance(p, at) + distance(at, q) - straight, 0.0)


@part(forceinline=True)
def _detours_in_line(
    length: float, legs: tuple[float, float], z: tuple[float, float], total: float
) -> tuple[float, float]:
    """Of the ways by the ends of an edge from 0 to `length` m, over one of `total` m, between two points: their
    distances from its line, and where they are along it, m."""
    start = math.sqrt(legs[0] ** 2 + z[0] ** 2) + math.sqrt(legs[1] ** 2 + z[1] ** 2)
    end = math.sqrt(legs[0] ** 2 + (length - z[0]) ** 2) + math.sqrt(legs[1] ** 2 + (length - z[1]) ** 2)
    return max(start - total, 0.0), max(end - total, 0.0)


@part
def detours_of_ends(
    wedges: Wedges, e: int, f: int, ends: tuple[Vec3, Vec3], at: tuple[Vec3, Vec3]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Of the ways from p to q by the ends of e, and by those of f, over the path that meets them `at` two places,
    m. Parallel edges are in line once the way across them is unfolded; of others the place on the other stays."""
    (p, q), (at_e, at_f) = ends, at
    d_p, d_ef, d_q = distance(p, at_e), distance(at_e, at_f), distance(at_f, q)
    if parallel(wedges, e, f):
        (z_pe, r_p), (z_qe, _) = line_coordinates(wedges, e, p), line_coordinates(wedges, e, q)
        (z_pf, _), (z_qf, r_q) = line_coordinates(wedges, f, p), line_coordinates(wedges, f, q)
        w, total = line_coordinates(wedges, e, at_f)[1], d_p + d_ef + d_q
        return (
            _detours_in_line(wedges.length[e], (r_p, w + r_q), (z_pe, z_qe), total),
            _detours_in_line(wedges.length[f], (r_p + w, r_q), (z_pf, z_qf), total),
        )
    return (
        (
            _detour(wedges, e, 0.0, p, at_f, d_p + d_ef),
            _detour(wedges, e, wedges.length[e], p, at_f, d_p + d_ef),
        ),
        (
            _detour(wedges, f, 0.0, at_e, q, d_ef + d_q),
            _detour(wedges, f, wedges.length[f], at_e, q, d_ef + d_q),
        ),
    )


@part(forceinline=True)
def on_both(wedges: Wedges, edges: tuple[int, int], z: tuple[float, float]) -> bool:
    """Whether apexes at `z` m along two edges are on them."""
    return 0.0 < z[0] < wedges.length[edges[0]] and 0.0 < z[1] < wedges.length[edges[1]]


@part
def taper_of_ends(
    wedges: Wedges,
    edges: tuple[int, int],
    z: tuple[float, float],
    ends: tuple[Vec3, Vec3],
    at: tuple[Vec3, Vec3],
    reach: float,
) -> float:
    """1 of apexes on their edges; down to 0 as the detours grow, up to `reach` m, by the ends beyond which they
    are. 0 where they are not known (NaN)."""
    (e, f), (z_e, z_f) = edges, z
    if on_both(wedges, edges, z):
        return 1.0
    if reach <= 0.0 or not (abs(z_e) < math.inf and abs(z_f) < math.inf):
        return 0.0
    by_e, by_f = detours_of_ends(wedges, e, f, ends, at)
    of_e = cosine_taper(beyond(z_e, wedges.length[e], by_e) / reach)
    return of_e * cosine_taper(beyond(z_f, wedges.length[f], by_f) / reach)
