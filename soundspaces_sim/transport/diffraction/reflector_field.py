"""The field of a finite reflector over that of an endless plane: sums over its edges, by their directions.

Theory: `finite_reflectors`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, dot, row
from soundspaces_sim.transport.diffraction.ends import sees
from soundspaces_sim.transport.diffraction.energy import (
    Wave,
    bounded,
    detour_taper,
    make_wave,
    merged_share,
    write_wave,
)
from soundspaces_sim.transport.diffraction.near_edges import (
    NearEdges,
    Pair,
    ReflectorEdges,
    tapers_in_line,
)
from soundspaces_sim.transport.diffraction.paths import (
    BOUNDARY_OFFSET,
    DiffractedPath,
    apex_point,
    boundary_tolerance,
    in_order,
)
from soundspaces_sim.transport.diffraction.plane_edges import face_of
from soundspaces_sim.transport.diffraction.reflector_geometry import (
    path_beside,
)
from soundspaces_sim.transport.diffraction.reflector_ratio import Taken, add_ratio, taken_of
from soundspaces_sim.transport.diffraction.spectrum import Quadrature, Spectrum
from soundspaces_sim.transport.diffraction.utd import share_beyond_end
from soundspaces_sim.transport.diffraction.visible_wedges import coordinates_in
from soundspaces_sim.transport.diffraction.wedges import WedgeCoordinates, Wedges

_MAX_GROUPS = 4  # directions of a reflector's edges
_PARALLEL = 0.999  # cosine between edges
_SAME_DIRECTION = math.cos(math.radians(30.0))  # edges within it are of one direction
MIN_FIELD = (
    0.04  # of an endless plane's reflection: a reflector that a ray misses needs more to be tried
)


class _Groups(NamedTuple):
    """Edges of a reflector by direction: its field is the product over them of what they add up to."""

    ratio: np.ndarray  # (_MAX_GROUPS, b, h) complex, sums of r = p_d / p_mirror
    edge: np.ndarray  # (_MAX_GROUPS,) that gives the direction
    detour: np.ndarray  # (_MAX_GROUPS,) m, of the nearest edge
    inside: np.ndarray  # (_MAX_GROUPS,) 1 where the path meets the reflector, by that edge, else 0


class ReflectorScratch(NamedTuple):
    """What a thread works in."""

    near: NearEdges
    groups: _Groups
    wave: Wave  # the mean of |field|² and its wave


def make_reflector_scratch(edges: int, spectrum: Spectrum) -> ReflectorScratch:
    """For so many edges."""
    bands, points = spectrum.lit.k.shape
    near = NearEdges(
        *np.empty((4, edges), np.int64), *np.empty((3, edges)), np.full(edges, -1, np.int64)
    )
    ratio, edge = np.empty((_MAX_GROUPS, bands, points), np.complex128), np.empty(_MAX_GROUPS, np.int64)
    groups = _Groups(ratio, edge, np.empty(_MAX_GROUPS), np.empty(_MAX_GROUPS))
    return ReflectorScratch(near, groups, make_wave(bands))


class ReflectorField(NamedTuple):
    """What `reflector_field` finds: whether the reflector acts; the nearest edge that the path misses, -1 for
    none, the point on it, and the length of the path by the endless plane, m."""

    acts: bool
    edge: int
    at: Vec3
    length: float


@part
def _group_of(wedges: Wedges, e: int, groups: _Groups, count: int) -> tuple[int, int]:
    """(Group of an edge's direction, how many groups there are with it)."""
    best, at = -1.0, 0
    for g in range(count):
        cos = abs(dot(row(wedges.along, e), row(wedges.along, groups.edge[g])))
        if cos > best:
            best, at = cos, g
    if best > _SAME_DIRECTION or count == _MAX_GROUPS:
        return at, count
    groups.edge[count], groups.detour[count] = e, math.inf
    return count, count + 1


@part
def _misses(groups: _Groups, count: int) -> bool:
    """Whether the path misses the reflector, by the nearest edge of one of so many directions. If it meets it and
    there is no specular path, something is in its way, or it is by another piece, as triangles of a plane stray."""
    for g in range(count):
        if groups.inside[g] == 0.0:
            return True
    return False


@part
def may_be_heard(
    edges: ReflectorEdges,
    pair: Pair,
    first: int,
    count: int,
    least: np.ndarray,
    scratch: ReflectorScratch,
) -> bool:
    """Whether the reflector of near edge `first` may be heard beside its reflection, with more in some band than
    the energies `least` (b,) of that by an endless plane: by Kirchhoff's approximation, with all edges in sight."""
    near, groups, spectrum = scratch.near, scratch.groups, edges.spectrum
    found = 0
    groups.ratio[:, :, 0] = 0.0
    for n in range(first, count):
        if near.piece[n] != near.piece[first]:
            continue
        g, found = _group_of(edges.wedges, pair.p.visible.wedge[near.row_p[n]], groups, found)
        if near.detour[n] < groups.detour[g]:
            groups.detour[g], groups.inside[g] = near.detour[n], 1.0 if near.beside[n] < 0.0 else 0.0
        sign = -1.0 if near.beside[n] < 0.0 else 1.0
        for b in range(groups.ratio.shape[1]):
            k = spectrum.shadow.k[b, 1]
            taper = detour_taper(near.detour[n], k)
            groups.ratio[g, b, 0] += sign * taper * share_beyond_end(k, near.detour[n])
    if not _misses(groups, found):
        return False
    for b in range(groups.ratio.shape[1]):
        field = 1.0
        for g in range(found):
            value = groups.ratio[g, b, 0] + groups.inside[g]
            field *= value.real * value.real + value.imag * value.imag
        if field > least[b]:
            return True
    return False


@part
def _about(pair: Pair, n: int, near: NearEdges) -> tuple[int, WedgeCoordinates, WedgeCoordinates]:
    """(The edge of row n, both ends about it in order)."""
    s, r = in_order(
        coordinates_in(pair.p.visible, near.row_p[n]), coordinates_in(pair.q.visible, near.row_q[n])
    )
    return pair.p.visible.wedge[near.row_p[n]], s, r


@part
def _is_within(
    edges: ReflectorEdges,
    n: int,
    e: int,
    about: tuple[WedgeCoordinates, WedgeCoordinates],
    specular: bool,
    near: NearEdges,
) -> bool:
    """Whether the path meets the reflector, by the edge of row n."""
    s, r = about
    tolerance = boundary_tolerance(edges.wedges, e, s, r)
    if specular:  # found by an image in the plane of many triangles, which stray from it
        tolerance += edges.sight.planes.margin[near.plane[n]] * (1.0 / s.r + 1.0 / r.r)
    return near.beside[n] < (tolerance if specular else -tolerance)


@part
def _path_by(
    wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates, beside: float, within: bool
) -> tuple[DiffractedPath, Vec3]:
    """The path by an edge, on its side of the boundary of the reflection, and its apex."""
    target = min(beside, -BOUNDARY_OFFSET) if within else max(beside, BOUNDARY_OFFSET)
    path = path_beside(wedges, e, s, r, target)
    return path, apex_point(wedges, e, path)


@part
def _both_see(edges: ReflectorEdges, pair: Pair, at: Vec3) -> bool:
    return sees(edges.sight, pair.p.end, at) and sees(edges.sight, pair.q.end, at)


@part
def _seen_missed(edges: ReflectorEdges, pair: Pair, first: int, count: int, near: NearEdges) -> int:
    """The first row of an edge that both ends see and by which the path misses the reflector of near edge `first`;
    `count` for none."""
    for n in range(first, count):
        if near.piece[n] != near.piece[first]:
            continue
        e, s, r = _about(pair, n, near)
        if _is_within(edges, n, e, (s, r), False, near):
            continue
        path, at = _path_by(edges.wedges, e, s, r, near.beside[n], False)
        if path.taper > 0.0 and _both_see(edges, pair, at):
            return n
    return count


@part
def reflector_field(
    edges: ReflectorEdges, pair: Pair, first: int, count: int, specular: bool, scratch: ReflectorScratch
) -> ReflectorField:
    """The field of the reflector of near edge `first` over that of an endless one: |field|² into `scratch.wave`.

    `specular`: there is a specular path, which takes the factor. Otherwise the reflector acts if the path misses
    it, by an edge that both ends see.
    """
    near, groups, wedges = scratch.near, scratch.groups, edges.wedges
    found, edge, best, length, where = 0, -1, math.inf, 0.0, (0.0, 0.0, 0.0)
    seen = first if specular else _seen_missed(edges, pair, first, count, near)
    if seen == count:
        return ReflectorField(False, edge, where, length)
    straight = distance(pair.p.end.at, pair.q.end.at)
    quadrature = edges.spectrum.lit if specular else edges.spectrum.shadow
    groups.ratio[:, :, :] = 0.0
    for n in range(first, count):
        if near.piece[n] != near.piece[first]:
            continue
        e, s, r = _about(pair, n, near)
        within = _is_within(edges, n, e, (s, r), specular, near)
        path, at = _path_by(wedges, e, s, r, near.beside[n], within)
        missed = not (specular or within)  # `_seen_missed` has found the first that is seen
        if path.taper <= 0.0 or (missed and n < seen):
            continue
        if not (missed and n == seen) and not _both_see(edges, pair, at):
            continue
        g, found = _group_of(wedges, e, groups, found)
        if near.detour[n] < groups.detour[g]:
            groups.detour[g], groups.inside[g] = near.detour[n], 1.0 if within else 0.0
        if not within and near.detour[n] < best:
            edge, best, length, where = e, near.detour[n], near.length[n], at
        face = face_of(edges.plane_edges, e, near.plane[n])
        taken = Taken(0.0, math.inf, False, 0.0)
        if pair.lit:
            taken = taken_of((wedges, edges.plane_edges), e, (s, r), path, face, straight)
        weight = math.sqrt(path.taper) / tapers_in_line(edges, pair, n, face, first, count, near)
        add_ratio(path, quadrature.k, near.length[n], face, weight, taken, groups.ratio[g])
    if found == 0 or not (specular or (edge >= 0 and _misses(groups, found))):
        return ReflectorField(False, edge, where, length)
    later = near.length[first] - straight
    over = _merging_detour(edges, pair, first, count, scratch) if pair.lit else math.inf
    ahead = length - straight_by(pair, where) if not specular else 0.0
    _write_factor(groups, found, quadrature, specular, (later, over, ahead), scratch.wave)
    return ReflectorField(True, edge, where, length)


@part
def _merging_detour(
    edges: ReflectorEdges, pair: Pair, first: int, count: int, scratch: ReflectorScratch
) -> float:
    """By how much the direct sound is shorter than the path by an edge of the strip that the reflector is, m:
    what of its reflection is one with the direct sound belongs to that (`passed_edges`); inf for no strip.

    A strip has two parallel edges near the path; if one end is below its plane, one.
    """
    near, wedges, over = scratch.near, edges.wedges, math.inf
    straight = distance(pair.p.end.at, pair.q.end.at)
    for n in range(first, count):
        if near.piece[n] != near.piece[first]:
            continue
        e, detour, below = _passed_directly(edges, pair, near, n, straight)
        if below:
            if edges.plane_edges.strip[e, face_of(edges.plane_edges, e, near.plane[n])]:
                over = min(over, detour)
            continue
        for m in range(n + 1, count):
            if near.piece[m] != near.piece[first]:
                continue
            f, other, _ = _passed_directly(edges, pair, near, m, straight)
            if abs(dot(row(wedges.along, e), row(wedges.along, f))) > _PARALLEL:
                over = min(over, max(detour, other))
    return over


@part
def _passed_directly(
    edges: ReflectorEdges, pair: Pair, near: NearEdges, n: int, straight: float
) -> tuple[int, float, bool]:
    """(Edge, detour of the direct sound by it, m, whether an end is below the plane of its face)."""
    e = pair.p.visible.wedge[near.row_p[n]]
    a = coordinates_in(pair.p.visible, near.row_p[n])
    b = coordinates_in(pair.q.visible, near.row_q[n])
    dz, phi = a.z - b.z, max(a.phi, b.phi)
    if face_of(edges.plane_edges, e, near.plane[n]) == 1:
        phi = math.pi * edges.wedges.n[e] - min(a.phi, b.phi)
    return e, math.sqrt((a.r + b.r) ** 2 + dz * dz) - straight, phi > math.pi


@part(forceinline=True)
def straight_by(pair: Pair, at: Vec3) -> float:
    """Length of the way by a place, m."""
    return distance(pair.p.end.at, at) + distance(at, pair.q.end.at)


@part
def _write_factor(
    groups: _Groups,
    found: int,
    quadrature: Quadrature,
    specular: bool,
    merging: tuple[float, float, float],
    wave: Wave,
) -> None:
    """The mean over each band of |field|², the product over so many groups, without what is one with the direct
    sound, and its wave. `merging`, m: by how much later it comes, the detour by its edges, and by how much the
    path by the endless plane is longer than the arrival."""
    total = groups.ratio[0]
    for b in range(len(wave.energy)):
        for h in range(len(quadrature.weight)):
            k = quadrature.k[b, h]
            field = (1.0 - merged_share(k, merging[0], merging[1])) + 0j
            for g in range(found):
                field *= groups.ratio[g, b, h] + (1.0 if specular else groups.inside[g])
            total[b, h] = bounded(field) * complex(math.cos(k * merging[2]), -math.sin(k * merging[2]))
    write_wave(total, quadrature, wave)
