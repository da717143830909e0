"""Where two edges of a body meet: which of them takes the sound that passes both.

A screen that fills a quarter of the plane between two points takes B_e B_f of what goes straight between them (the
Kirchhoff integral at right angles; B_e, B_f what endless edges would take), so that they have

    1 - B_e B_f = (1 - B_e) + B_e (1 - B_f) = (1 - B_f) + B_f (1 - B_e):

a path by edge e as if it had no end at the corner, and one by edge f that ends there, or the other way round. At
the boundary of the shadow of e only the first goes on into the light, where the direct sound has 1 - B_e, and at
that of f only the second. A mean of both, weighted by w and 1 - w, has the same sum, whatever the weight: w is 1 at
the boundary of e, 0 at that of f, by their detours. In the light of both edges each has its part that ends.
"""

from __future__ import annotations

import math

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import distance
from soundspaces_sim.transport.diffraction.passed_edges import EdgePair
from soundspaces_sim.transport.diffraction.paths import DiffractedPath, cosine_taper, with_cuts
from soundspaces_sim.transport.diffraction.wedges import Wedges, wedge_coordinates


@part
def _detour_by(wedges: Wedges, f: int, pair: EdgePair) -> tuple[float, float, float]:
    """(Detour by the line of an edge, m, -1 if an end is in the body; how far the pair is in its shadow, rad, below
    0 in its light; how far the ends are from its faces, at least, rad)."""
    a, b = wedge_coordinates(wedges, f, pair.p.at), wedge_coordinates(wedges, f, pair.q.at)
    low, high, sector = min(a.phi, b.phi), max(a.phi, b.phi), math.pi * wedges.n[f]
    if high > sector:
        return -1.0, 0.0, 0.0
    detour = math.sqrt((a.r + b.r) ** 2 + (a.z - b.z) ** 2) - distance(pair.p.at, pair.q.at)
    return max(detour, 0.0), high - low - math.pi, min(low, sector - high)


@part
def _at_corner(
    wedges: Wedges, e: int, end: int, detour: float, pair: EdgePair
) -> tuple[float, bool, bool]:
    """(w of edge `e`, `detour` m; whether the pair is in the shadow of the other edge at this end; whether there is
    one)."""
    nearest, depth, from_face = math.inf, 0.0, 0.0
    for n in range(2):
        f = wedges.corner[e, end, n]
        if f < 0:
            continue
        other, into, off = _detour_by(wedges, f, pair)
        if 0.0 <= other < nearest:
            nearest, depth, from_face = other, into, off
    if (
        nearest == math.inf
    ):  # no path by another edge: of a box, both ends are on this side of its corner
        box = wedges.corner[e, end, 1] >= 0
        return 1.0, box, box
    own, other = detour * detour, nearest * nearest
    weight = other / (own + other) if own + other > 0.0 else 0.5
    if depth > 0.0:  # towards the plane of its face the path by the other edge goes on by more edges
        weight = 1.0 - (1.0 - weight) * (1.0 - cosine_taper(from_face / depth))
    return weight, depth > 0.0, True


@part
def past_corners(
    wedges: Wedges, e: int, path: DiffractedPath, pair: EdgePair, in_light: bool
) -> DiffractedPath:
    """A path by edge `e` with its part of what passes the corners at both of its ends. `pair.lit`: the pair is in
    the light of the edge; `in_light`: in that of all."""
    detour = max(path.d_s + path.d_r - distance(pair.p.at, pair.q.at), 0.0)
    cuts, size = (path.cut_start, path.cut_end), 1.0
    for end in range(2):
        if cuts[end] <= 0.0:
            continue
        weight, dark, there = _at_corner(wedges, e, end, detour, pair)
        if not there:
            continue
        if dark:
            cut = 1.0 - weight
            cuts = (cut, cuts[1]) if end == 0 else (cuts[0], cut)
        elif in_light and not pair.lit:
            size *= 1.0 - weight
    return with_cuts(path, cuts, path.taper * size * size)
