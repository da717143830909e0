"""Edges that a path by one edge passes.

In the shadow, the path p, e, q has the field p_e. Where q sees e closely past another edge f, the path p, e, f, q
(`two_edges`) is added to it, with its phase; and so before e on the side of p. With several other edges the mean
ratio to p_e counts, weighted by the fourth power of its size, on either side; both sides multiply. The sum is
continuous where f comes between e and q: there the path by one edge ends, and that by both goes on alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.double_wedge import (
    DoubleWedgeScratch,
    make_double_wedge_scratch,
)
from soundspaces_sim.transport.diffraction.ends import End, View, reach_beyond, sees
from soundspaces_sim.transport.diffraction.energy import (
    Interference,
    both_sides,
    clear,
    mean_ratio,
    weigh,
)
from soundspaces_sim.transport.diffraction.mirrored_edges import MirroredEdges, sees_mirrored
from soundspaces_sim.transport.diffraction.mutual_visibility import MutualVisibility
from soundspaces_sim.transport.diffraction.paths import (
    MAX_DETOUR,
    DiffractedPath,
    apex_point,
    contradicts,
    in_order,
    met_point,
    off_boundary,
    path_about,
    path_field,
    terms_of,
)
from soundspaces_sim.transport.diffraction.spectrum import Quadrature, Spectrum
from soundspaces_sim.transport.diffraction.two_edge_path import (
    TwoEdgePath,
    is_strip,
    meets_both,
    path_length,
    two_edge_path,
)
from soundspaces_sim.transport.diffraction.two_edge_sight import legs_clear
from soundspaces_sim.transport.diffraction.two_edges import most_energy, two_edge_field
from soundspaces_sim.transport.diffraction.utd import most_of_wedge
from soundspaces_sim.transport.diffraction.wedges import (
    WedgeCoordinates,
    Wedges,
    line_coordinates,
)

ADDED = 1e-4  # of a path's energy: other edges that add less change its level by less than 0.1 dB
BESIDE = (
    0.2  # of `heard`: less, beside another wave on the same path, changes a walk by less than 0.1 dB
)
_MOST_SHARE = 1.5  # |`edge_shares`|: a slit lets at most 1.34 times the amplitude through
_LEAST_RADIUS = 1e-9  # m, of two points about an edge
_MOST_PASSED = 64  # edges that count beside a direct sound, those of the largest ratios


class EdgesOfScene(NamedTuple):
    """What a scene is to its edges."""

    sight: View
    wedges: Wedges  # and their mirror images, which no end sees and no path of its own goes by
    mirrored: MirroredEdges
    mutual: MutualVisibility
    strip: np.ndarray  # (n,) `strip_rows`
    lowest: float  # 1/m, the lowest wave number


class EdgePair(NamedTuple):
    """Both ends, in an order of their own, and which wedges they see: rows, -1 for none."""

    p: End
    q: End
    row_p: np.ndarray  # (E,)
    row_q: np.ndarray  # (E,)
    lit: bool  # they see each other, or there is the reflection between them


class PassedScratch(NamedTuple):
    """What a thread works in. `row_a`, `row_b` are -1 between pairs."""

    row_a: np.ndarray  # (E,) of `VisibleWedges`
    row_b: np.ndarray  # (E,)
    field: np.ndarray  # (2, b, g) complex: of a path by one edge, and by two
    #: (4, b, h) complex, in the light: sums of ratios, of those of waves that strips reflect; a field of two edges;
    #: the ratio of waves that other faces reflect
    lit: np.ndarray
    merged: np.ndarray  # (b, h) `merged_share`
    before: Interference  # (b, g), on the side of p
    after: Interference  # (b, g)
    double: DoubleWedgeScratch
    through: np.ndarray  # (2, b) of `sees_mirrored`
    edge: np.ndarray  # (m,) that the direct sound passes
    position: np.ndarray  # (E,) in `edge`, -1 for none
    share: np.ndarray  # (m,) of the reflected wave's terms that counts to the direct sound
    detour: np.ndarray  # (m,) m
    moved: np.ndarray  # (2,) how much of what an edge's faces reflect counts with their strips
    beyond: np.ndarray  # (m,) m, detour by the end of the edge beyond which the apex lies, 0 on the edge
    size: np.ndarray  # (m,) largest of `ratio`, the sum of its terms' sizes
    #: (3, m, b, h) complex, p_d / p_direct: terms of the incident wave, of those that both faces reflect
    ratio: np.ndarray
    #: (m, b, h) complex: what an edge's length leaves of the reflected waves of an endless one
    of_length: np.ndarray
    strip: np.ndarray  # (m,) row of `MutualVisibility` whose field is in `of_strip`
    clear: np.ndarray  # (m,) whether its legs are
    of_strip: np.ndarray  # (m, b, h) complex, 1/m


def make_passed_scratch(edges: int, spectrum: Spectrum) -> PassedScratch:
    """For so many edges."""
    none, shadow, lit = np.full(edges, -1, np.int64), spectrum.shadow.k.shape, spectrum.lit.k.shape

    def sums() -> Interference:
        return Interference(np.empty(shadow, np.complex128), np.empty(shadow))

    most = min(edges, _MOST_PASSED)
    slots = most + 1  # the last for one that may take another's place
    return PassedScratch(
        row_a=none,
        row_b=none.copy(),
        field=np.empty((2, *shadow), np.complex128),
        lit=np.empty((4, *lit), np.complex128),
        merged=np.empty(lit),
        before=sums(),
        after=sums(),
        double=make_double_wedge_scratch(),
        through=np.empty((2, shadow[0])),
        edge=np.empty(most, np.int64),
        position=none.copy(),
        share=np.empty(most),
        detour=np.empty(most),
        moved=np.empty(2),
        beyond=np.empty(most),
        size=np.empty(most),
        ratio=np.empty((3, slots, *lit), np.complex128),
        of_length=np.empty((slots, *lit), np.complex128),
        strip=np.empty(most, np.int64),
        clear=np.empty(most, np.bool_),
        of_strip=np.empty((most, *lit), np.complex128),
    )


@part(forceinline=True)
def path_strength(path: DiffractedPath, k: float) -> float:
    """Energy at a wave number, J/m² for 1 J."""
    p = path_field(path, terms_of(path), k, 1.0)
    return path.taper * (p.real * p.real + p.imag * p.imag) * INV_4PI


@part(forceinline=True)
def _not_heard(path: DiffractedPath, k: float, heard: float) -> bool:
    """Whether a path has less energy than `heard` at a wave number; most have by a bound that takes no field."""
    most = _MOST_SHARE * most_of_wedge(path.n, terms_of(path), path.d_s, path.d_r, path.sin_beta, k)
    return path.taper * most * most * INV_4PI < heard or path_strength(path, k) < heard


@part
def single_path(
    scene: EdgesOfScene,
    e: int,
    a: WedgeCoordinates,
    b: WedgeCoordinates,
    pair: EdgePair,
    heard: float,
) -> tuple[bool, DiffractedPath, Vec3]:
    """(Whether there is a path by one edge, it, its apex), of ends at these coordinates; in the shadow none of less
    energy than `heard` at the lowest frequencies."""
    wedges, lit = scene.wedges, pair.lit
    s, r = in_order(a, b)
    path = path_about(wedges, e, s, r, off_boundary(s, r, lit))
    at = apex_point(wedges, e, path)
    if contradicts(wedges, e, s, r, lit) or path.taper <= 0.0:
        return False, path, at
    if lit and path.d_s + path.d_r - distance(pair.p.at, pair.q.at) > MAX_DETOUR:
        return False, path, at
    if heard > 0.0 and not lit and _not_heard(path, scene.lowest, heard):
        return False, path, at
    clear_legs = sees(scene.sight, pair.p, at) and sees(scene.sight, pair.q, at)
    return clear_legs, path, at


@part
def past_others(
    scene: EdgesOfScene,
    e: int,
    path: DiffractedPath,
    pair: EdgePair,
    heard: float,
    quadrature: Quadrature,
    scratch: PassedScratch,
) -> bool:
    """The field (b, g) of the path by `e` past other edges, into `scratch.field[0]`; False if one hides it.

    Paths by both edges fade where they have less energy than `BESIDE` times `heard`, or than 1e-4 of its own.
    """
    field, total = scratch.field[0], path.d_s + path.d_r
    weight, terms = math.sqrt(path.taper), terms_of(path)
    for b in range(field.shape[0]):
        for g in range(field.shape[1]):
            field[b, g] = weight * path_field(path, terms, quadrature.k[b, g], 1.0)
    clear(scratch.before)
    clear(scratch.after)
    own = field[0, 0].real ** 2 + field[0, 0].imag ** 2
    least = max(ADDED * own * INV_4PI, BESIDE * heard)
    for m in range(scene.mutual.start[e], scene.mutual.start[e + 1]):
        f = scene.mutual.wedge[m]
        for side in range(2):
            if (pair.row_q[f] if side == 0 else pair.row_p[f]) < 0:
                continue
            if not scene.strip[m] and _least_length(scene.wedges, f, pair) > total + MAX_DETOUR:
                continue
            near, hidden, x = _passes(scene, e, f, total, pair, (side == 0, least))
            if hidden:
                return False
            if near:
                both = pair.row_p[x.f] >= 0, pair.row_q[x.e] >= 0
                _add_beside(scene, x, both, total, (side == 0, False), least, quadrature, scratch)
    for m in range(scene.mirrored.start[e], scene.mirrored.start[e + 1]):
        for side in range(2):
            near, x = passes_mirrored(scene, e, m, pair, (side == 0, least), scratch.through)
            if near:
                both = side == 1, side == 0
                _add_beside(scene, x, both, total, (side == 0, True), least, quadrature, scratch)
    for b in range(field.shape[0]):
        for g in range(field.shape[1]):
            field[b, g] *= both_sides(mean_ratio(scratch.before, b, g), mean_ratio(scratch.after, b, g))
    return True


@part
def _add_beside(
    scene: EdgesOfScene,
    x: TwoEdgePath,
    sees: tuple[bool, bool],
    total: float,
    which: tuple[bool, bool],
    least: float,
    quadrature: Quadrature,
    scratch: PassedScratch,
) -> None:
    """Weigh the ratio of a path by two edges to that by one, `total` m long. `sees`: whether p sees the second edge
    and q the first. `which`: whether the other edge comes after the one, and whether it is a mirror image."""
    field, other, over = scratch.field[0], scratch.field[1], path_length(x) - total
    counts = two_edge_field(scene.wedges, x, sees, over, least, quadrature, scratch.double, other)
    if counts <= 0.0:
        return
    for b in range(field.shape[0]):
        share = counts * math.sqrt(scratch.through[0, b]) if which[1] else counts
        for g in range(field.shape[1]):
            if field[b, g] != 0j:
                weigh(
                    share * other[b, g] / field[b, g],
                    b,
                    g,
                    scratch.after if which[0] else scratch.before,
                )


@part(forceinline=True)
def _least_length(wedges: Wedges, f: int, pair: EdgePair) -> float:
    """Of a path by edge f and any other, m: at least that by edge f alone."""
    z_p, r_p = line_coordinates(wedges, f, pair.p.at)
    z_q, r_q = line_coordinates(wedges, f, pair.q.at)
    z = z_p + (z_q - z_p) * (r_p / max(r_p + r_q, _LEAST_RADIUS))
    z = min(max(z, 0.0), wedges.length[f])
    return math.sqrt(r_p * r_p + (z - z_p) ** 2) + math.sqrt(r_q * r_q + (z - z_q) ** 2)


@part
def _passes(
    scene: EdgesOfScene, e: int, f: int, total: float, pair: EdgePair, beside: tuple[bool, float]
) -> tuple[bool, bool, TwoEdgePath]:
    """(Whether the path by `e`, `total` m long, passes edge `f` closely, and that by both is heard; whether `f`
    hides it; the path by both). `beside`: whether `f` comes after `e`, and the least energy of a path by both."""
    wedges, (after, least) = scene.wedges, beside
    first, second = (e, f) if after else (f, e)
    # Along a plate with two free edges: on the side of the end that sees both.
    by = (0.0, 1.0) if after else (1.0, 0.0)
    reach = reach_beyond(pair.p, pair.q)
    inside, x = two_edge_path(wedges, first, second, pair.p.at, pair.q.at, by, reach)
    if not inside:
        return False, False, x
    lit = x.lit_q if after else x.lit_p
    if not lit:
        hidden = meets_both(wedges, x) and legs_clear(scene.sight, wedges, x, pair.p, pair.q)
        return False, hidden, x
    detour = path_length(x) - total
    if detour > MAX_DETOUR and not is_strip(wedges, x):
        return False, False, x
    # in the light at both ends it belongs to the path by the edge of the smaller number
    if (x.lit_p if after else x.lit_q) and e > f:
        return False, False, x
    if most_energy(wedges, x, scene.lowest) <= least:
        return False, False, x
    return legs_clear(scene.sight, wedges, x, pair.p, pair.q), False, x


@part
def passes_mirrored(
    scene: EdgesOfScene,
    e: int,
    m: int,
    pair: EdgePair,
    beside: tuple[bool, float],
    share: np.ndarray,
) -> tuple[bool, TwoEdgePath]:
    """`_passes` of a mirror image of `e`, row `m` of `MirroredEdges`, with what planes take of it in `share`.

    What an end in the light of both edges sends by both, to another such end, stays before the face: no path.
    """
    wedges, (after, least) = scene.wedges, beside
    f, plane = len(scene.mirrored.start) - 1 + m, scene.mirrored.plane[m]
    first, second = (e, f) if after else (f, e)
    by = (0.0, 1.0) if after else (1.0, 0.0)
    reach = reach_beyond(pair.p, pair.q)
    inside, x = two_edge_path(wedges, first, second, pair.p.at, pair.q.at, by, reach)
    if not (inside and x.lit_p != x.lit_q and x.lit_q == after and is_strip(wedges, x)):
        return False, x
    if most_energy(wedges, x, scene.lowest) <= least:
        return False, x
    end, other = (pair.q, pair.p) if after else (pair.p, pair.q)
    z, phi = ((x.z_f, x.z_e), x.phi_f) if after else ((x.z_e, x.z_f), x.phi_e)
    if not sees(scene.sight, other, met_point(wedges, e, z[1])):
        return False, x
    return sees_mirrored(scene.sight, wedges, (e, plane), end, z, phi, share), x
