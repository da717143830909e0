"""Where two edges of a body meet: which of them takes the sound that passes both.

A screen that fills a quarter of the plane between two points takes B_e B_f of what goes straight between them (the
Kirchhoff integral at right angles; B_e, B_f what endless edges would take), so that they have

    1 - B_e B_f = (1 - B_e) + B_e (1 - B_f) = (1 - B_f) + B_f (1 - B_e):

a path by edge e as if it had no end at the corner, and one by edge f that ends there, or the other way round. At
the boundary of the shadow of e only the first goes on into the light, where the direct sound has 1 - B_e, and at
that of f only the second. A mean of both, weighted by w and 1 - w, has the same sum, whatever the weight: w is 1 at
the boundary of e, 0 at that of f, by the squares of their detours. In the light of both edges each has its part
that ends. Where an end comes to the plane of a face of e, beyond which two edges go on, w is 0; but in the light of
f, by more than a detour of 0.15 m, what goes on there has faded, and w is 1.

That is of the incident wave's terms. Those of reflected waves jump at the boundary of the reflection, not at that
of the shadow, and end where the edge does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance
from soundspaces_sim.transport.diffraction.paths import DiffractedPath, cosine_taper, with_cuts
from soundspaces_sim.transport.diffraction.wedges import Wedges, wedge_coordinates

_FADES = 0.15  # m, detour by an edge: near the boundary of its shadow
_LEAST = 1e-30  # m², below the rounding of squares of detours: at the corner each edge has a half


class _Turn(NamedTuple):
    """Of two points about an edge."""

    detour: float  # m, by its line
    depth: float  # rad, how far they are in its shadow, below 0 in its light
    opens: float  # 1; down to 0 where an end comes to the plane of a face, beyond which more edges go on


@part(forceinline=True)
def _turn_about(wedges: Wedges, f: int, p: Vec3, q: Vec3) -> _Turn:
    """`opens` is 0 as well where an end is behind the edge."""
    a, b = wedge_coordinates(wedges, f, p), wedge_coordinates(wedges, f, q)
    low, high, sector = min(a.phi, b.phi), max(a.phi, b.phi), math.pi * wedges.n[f]
    detour = math.sqrt((a.r + b.r) ** 2 + (a.z - b.z) ** 2) - distance(p, q)
    depth, opens = high - low - math.pi, 1.0
    if high > sector:
        opens = 0.0
    elif depth > 0.0:
        opens = 1.0 - cosine_taper(min(low, sector - high) / depth)
    return _Turn(max(detour, 0.0), depth, opens)


@part
def _other_at(wedges: Wedges, e: int, end: int, p: Vec3, q: Vec3) -> tuple[bool, _Turn]:
    """(Whether another edge shares in what passes the start, 0, or the `end`, 1, of an edge; that with the least
    detour). From behind both others of a box all that passes is of this edge; of a plate this edge ends there."""
    found, least = False, _Turn(math.inf, 1.0, 0.0)
    for n in range(2):
        f = wedges.corner[e, end, n]
        if f >= 0:
            turn = _turn_about(wedges, f, p, q)
            if turn.opens > 0.0 and turn.detour < least.detour:
                found, least = True, turn
    return found or wedges.corner[e, end, 1] >= 0, least


@part(forceinline=True)
def _kept(dark: _Turn, share: float, lit: _Turn) -> float:
    """Part of the pressure of a path by an edge in whose shadow two points are, in the light of the other one: its
    `share`; near the plane of a face, beyond which two edges go on, all of it near the boundary of that light."""
    return dark.opens * share + (1.0 - dark.opens) * cosine_taper(lit.detour / _FADES)


@part
def past_corners(
    wedges: Wedges, e: int, path: DiffractedPath, ends: tuple[Vec3, Vec3], in_light: bool
) -> DiffractedPath:
    """A path by edge `e` with its part of what passes the corners at its ends. `in_light`: the straight path is
    clear."""
    p, q = ends
    own, cuts, size = _turn_about(wedges, e, p, q), (path.cut_start, path.cut_end), 1.0
    for end in range(2):
        if cuts[end] <= 0.0:
            continue
        there, other = _other_at(wedges, e, end, p, q)
        if not there:
            continue
        share = (own.detour**2 + _LEAST) / (own.detour**2 + other.detour**2 + 2.0 * _LEAST)
        if own.depth > 0.0 >= other.depth:
            size *= _kept(own, share, other) if in_light else 1.0
        if other.depth <= 0.0:
            continue
        if own.depth > 0.0:
            lost = 1.0 - own.opens * (1.0 - share * other.opens)
        else:
            lost = 1.0 - _kept(other, 1.0 - share, own)
        cuts = (lost, cuts[1]) if end == 0 else (cuts[0], lost)
    return with_cuts(path, cuts, path.reflected_cuts, path.taper * size * size)
