"""All that arrives discretely between two points: candidates, geometry, field, one sum. The kernel of a tile's pairs.

An end is a point or its image in a plane. Between two ends go the direct sound or the reflections off further planes,
the waves by every edge that both see, and those by two edges.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, row, subtract
from soundspaces_sim.echogram.echogram import EDGE_KINDS, MIRRORS, MIRRORS_AND_BACK, REVERSE_KIND
from soundspaces_sim.transport.arrivals.field import (
    EdgePath,
    Spectrum,
    field_at,
    front_of,
    most_of_edge,
    terms_of,
)
from soundspaces_sim.transport.arrivals.waves import Path, Waves, add_wave, energy_of, fade, join, smooth
from soundspaces_sim.transport.bsdf.surface import specular_reflectance
from soundspaces_sim.transport.diffraction.double_wedge import DoubleWedgeScratch
from soundspaces_sim.transport.diffraction.ends import End, View, reach_beyond, reflected, sees
from soundspaces_sim.transport.diffraction.image_wedges import ImageSide, seen_image
from soundspaces_sim.transport.diffraction.mutual_visibility import MutualVisibility
from soundspaces_sim.transport.diffraction.paths import (
    BOUNDARY_OFFSET,
    boundary_tolerance,
    cosine_taper,
    cuts_of,
    in_order,
    met_point,
)
from soundspaces_sim.transport.diffraction.points import seen_point
from soundspaces_sim.transport.diffraction.seen_ends import SeenEnd, clear_rows, mark, set_rows
from soundspaces_sim.transport.diffraction.sides_of_faces import BY_BOTH
from soundspaces_sim.transport.diffraction.two_edge_path import meets_both, path_length, two_edge_path
from soundspaces_sim.transport.diffraction.two_edge_sight import legs_clear
from soundspaces_sim.transport.diffraction.two_edges import most_energy, two_edge_field
from soundspaces_sim.transport.diffraction.visible_wedges import coordinates_in
from soundspaces_sim.transport.diffraction.wedges import WedgeCoordinates, Wedges
from soundspaces_sim.transport.image_source.image_source import (
    _SpecularPath,
    _straight,
    _trace,
    _unfold,
)
from soundspaces_sim.transport.image_source.images import beside_edge
from soundspaces_sim.transport.image_source.sequences import Sequences
from soundspaces_sim.transport.path_table import FoundPath, PathSlots, store

_KINDS = np.array(EDGE_KINDS)
_DIRECT = -1  # kind of the direct sound
_HEARD = 1e-3  # of the energy that a pair has: what is diffracted fades in from so much on, in any band
_HEARD_IMAGES = 3e-3  # the same where an end is an image
_MAX_BEYOND = 0.5  # m, detour by an end of an edge beyond which the apex lies, up to which it counts
_MAX_DETOUR = 2.0  # m, by two edges over what goes straight, up to which they count in the light


class Edges(NamedTuple):
    """A scene's edges."""

    wedges: Wedges
    plane: np.ndarray  # (E, 2) that mirrors early sound, of each face; -1 for none
    material: np.ndarray  # (E, 2) row of Surfaces, of each face
    mutual: MutualVisibility
    strip: np.ndarray  # (n,) which rows of it are of two edges of one face


class Context(NamedTuple):
    """What the kernel reads, and `joined`, which it fills."""

    sight: View
    edges: Edges
    spectrum: Spectrum
    a: ImageSide
    b: ImageSide
    sequences_a: Sequences
    sequences_b: Sequences
    walls: np.ndarray  # (A, B) between the points; 0: they see each other
    direct: np.ndarray  # (A, B, b) J/m², without air
    joined: np.ndarray  # (A, B, b) the same with what joins it


class Scratch(NamedTuple):
    """What a thread works in."""

    waves: Waves
    field: np.ndarray  # (b, g) complex
    energy: np.ndarray  # (b,)
    heard: np.ndarray  # (b,) least |P|² of a wave that is looked at
    mirror: np.ndarray  # (2, b)
    row_p: np.ndarray  # (E,) rows of what the first end sees, by wedge; -1 for none
    row_q: np.ndarray  # (E,)
    continues: np.ndarray  # (n,) flags of rows of `MutualVisibility`
    double: DoubleWedgeScratch


class _Ends(NamedTuple):
    """Two ends in their order."""

    p: SeenEnd
    q: SeenEnd
    lit: bool  # they see each other, or there is the reflection between them


@part
def _has(waves: Waves, planes: tuple[int, int], back: bool) -> bool:
    """Whether sound comes by these planes in order from p."""
    for i in range(min(waves.number[0], len(waves.length))):
        if waves.moves[i]:
            continue
        if waves.planes[i, 0] == planes[0] and waves.planes[i, 1] == planes[1]:
            if back == (waves.kind[i] == MIRRORS_AND_BACK) and waves.kind[i] != _DIRECT:
                return True
    return False


@part
def _mirrors(waves: Waves, p: End, q: End, plane: int) -> bool:
    """Whether sound is reflected off a plane between two ends."""
    if p.plane >= 0 and q.plane >= 0:
        return _has(waves, (p.plane, plane), True)
    if p.plane >= 0:
        return _has(waves, (p.plane, plane), False)
    if q.plane >= 0:
        return _has(waves, (plane, q.plane), False)
    return _has(waves, (plane, -1), False)


@part
def _add_mirrors(context: Context, i: int, j: int, p: Vec3, q: Vec3, swapped: bool, scratch: Scratch) -> None:
    """Reflections off planes, by the sequences that rays from either end meet."""
    own, other = context.sequences_a, context.sequences_b
    if swapped:
        own, other = other, own
        i, j = j, i
    last = own.seen.shape[1]
    for n in range(own.start[i], own.start[i + 1]):
        a, b = own.planes[n, 0], own.planes[n, 1]
        _add_mirror(context, (a, b, -1), p, q, scratch)
        if b >= 0:
            _add_mirror(context, (a, b, a), p, q, scratch)
    for n in range(other.start[j], other.start[j + 1]):
        b, a = other.planes[n, 0], other.planes[n, 1]
        if a < 0:
            a, b = b, -1
        if not own.seen[i, a, b if b >= 0 else last]:
            _add_mirror(context, (a, b, -1), p, q, scratch)
        if b >= 0 and not own.seen[i, b, a]:
            _add_mirror(context, (b, a, b), p, q, scratch)


@part
def _add_mirror(context: Context, met: tuple[int, int, int], p: Vec3, q: Vec3, scratch: Scratch) -> None:
    sight, energy = context.sight, scratch.energy
    a, b, c = met
    end = beside_edge(sight.geometry, sight.planes, (a, b), p, q) if c < 0 <= b else q
    found, path = _unfold(sight.planes, met, p, end)
    if not found:
        return
    length, at_p, at_q = _straight(sight.planes, met, p, q)
    found, groups = _trace(sight, path, length, energy)
    if not found:
        return
    kind = MIRRORS_AND_BACK if c >= 0 else MIRRORS
    for k in range(len(energy)):
        energy[k] *= 4.0 * math.pi
    scratch.field[:, :] = 1.0
    add_wave(scratch.waves, Path(length, at_p, at_q, (a, b), kind, (-1, -1), groups), scratch.field, energy, False)


@part
def _set_heard(scratch: Scratch, share: float) -> None:
    """`Scratch.heard`: a share of the energy of the waves that there are."""
    waves, heard = scratch.waves, scratch.heard
    heard[:] = 0.0
    for i in range(min(waves.number[0], len(waves.length))):
        for b in range(len(heard)):
            p = waves.field[i, b, 0]
            heard[b] += share * (p.real * p.real + p.imag * p.imag)


@part(forceinline=True)
def _verdict(turn: float, tolerance: float, lit: bool) -> float:
    """An angle whose boundary is at pi, on the side that rays have found where angles cannot tell."""
    if abs(turn - math.pi) > tolerance:
        return turn
    return min(turn, math.pi - BOUNDARY_OFFSET) if lit else max(turn, math.pi + BOUNDARY_OFFSET)


@part
def _edge_path(
    wedges: Wedges, e: int, s: WedgeCoordinates, r: WedgeCoordinates
) -> tuple[bool, EdgePath]:
    """The path by an edge between two ends about it, in order."""
    length, n = wedges.length[e], wedges.n[e]
    total = math.sqrt((s.r + r.r) ** 2 + (r.z - s.z) ** 2)
    sin_beta = (s.r + r.r) / total
    apex = s.z + (r.z - s.z) * (s.r / (s.r + r.r))
    start = math.sqrt(s.r * s.r + s.z * s.z) + math.sqrt(r.r * r.r + r.z * r.z) - total
    xs, xr = length - s.z, length - r.z
    end = math.sqrt(s.r * s.r + xs * xs) + math.sqrt(r.r * r.r + xr * xr) - total
    start, end, taper = max(start, 0.0), max(end, 0.0), 1.0
    if apex < 0.0 or apex > length:
        taper = cosine_taper(min(start, end) / _MAX_BEYOND)
    stands = wedges.stands
    # Between two images in the surface that an edge stands on: it is in the path between the points themselves.
    ok = not ((stands[e, 0] and max(s.z, r.z) < 0.0) or (stands[e, 1] and min(s.z, r.z) > length))
    cut_start, cut_end = cuts_of(wedges, e, s.z, r.z)
    plus = s.phi + r.phi
    path = EdgePath(
        n=n,
        minus=r.phi - s.phi,
        plus=plus,
        other=2.0 * math.pi * n - plus,
        d_s=s.r / sin_beta,
        d_r=r.r / sin_beta,
        sin_beta=sin_beta,
        apex=apex,
        length=length,
        start=start if cut_start > 0.0 else math.inf,
        end=end if cut_end > 0.0 else math.inf,
        taper=taper,
    )
    return ok and taper > 0.0, path


@part
def _on_side(context: Context, ends: _Ends, e: int, s: WedgeCoordinates, r: WedgeCoordinates, path: EdgePath, waves: Waves) -> EdgePath:
    """The path with its angles on the side of each boundary on which rays have found sound."""
    wedges, planes = context.edges.wedges, context.sight.planes
    tolerance = boundary_tolerance(wedges, e, s, r)
    minus = _verdict(path.minus, tolerance, ends.lit)
    plus, other = path.plus, path.other
    a, b = context.edges.plane[e, 0], context.edges.plane[e, 1]
    spread = 1.0 / s.r + 1.0 / r.r
    if a >= 0:
        near = tolerance + planes.margin[a] * spread
        if abs(plus - math.pi) <= near:
            plus = _verdict(plus, near, _mirrors(waves, ends.p.end, ends.q.end, a))
    if b >= 0:
        near = tolerance + planes.margin[b] * spread
        if abs(other - math.pi) <= near:
            other = _verdict(other, near, _mirrors(waves, ends.p.end, ends.q.end, b))
    return EdgePath(
        path.n, minus, plus, other, path.d_s, path.d_r, path.sin_beta, path.apex, path.length,
        path.start, path.end, path.taper,
    )  # fmt: skip


@part
def _set_mirror(context: Context, e: int, s: WedgeCoordinates, r: WedgeCoordinates, path: EdgePath, mirror: np.ndarray) -> None:
    """Amplitudes (2, b) that both faces reflect between two ends."""
    surfaces, edges = context.sight.surfaces, context.edges
    for face in range(2):
        if edges.plane[e, face] < 0:
            mirror[face, :] = 0.0
            continue
        sector = math.pi * path.n
        phi_s, phi_r = (s.phi, r.phi) if face == 0 else (sector - s.phi, sector - r.phi)
        cos = (s.r * math.sin(phi_s) + r.r * math.sin(phi_r)) / (path.d_s + path.d_r)
        cos = min(max(cos, 0.0), 1.0)
        for b in range(mirror.shape[1]):
            mirror[face, b] = math.sqrt(specular_reflectance(surfaces, edges.material[e, face], cos, b))


@part
def _add_singles(context: Context, ends: _Ends, scratch: Scratch) -> None:
    """Waves by every edge that both ends see."""
    seen_p, seen_q = ends.p.visible, ends.q.visible
    n, stop_n = seen_p.start[ends.p.row], seen_p.start[ends.p.row + 1]
    m, stop_m = seen_q.start[ends.q.row], seen_q.start[ends.q.row + 1]
    while n < stop_n and m < stop_m:
        e, f = seen_p.wedge[n], seen_q.wedge[m]
        if e == f:
            _add_single(context, ends, e, coordinates_in(seen_p, n), coordinates_in(seen_q, m), scratch)
        n += e <= f
        m += f <= e


@part
def _add_single(context: Context, ends: _Ends, e: int, a: WedgeCoordinates, b: WedgeCoordinates, scratch: Scratch) -> None:
    s, r = in_order(a, b)
    wedges, spectrum, heard = context.edges.wedges, context.spectrum, scratch.heard
    ok, path = _edge_path(wedges, e, s, r)
    if not ok:
        return
    path = _on_side(context, ends, e, s, r, path, scratch.waves)
    terms, loud = terms_of(path), False
    for k in range(len(heard)):
        loud = loud or most_of_edge(path, terms, spectrum.k[k, 0]) ** 2 > heard[k]
    if not loud:
        return
    if path.minus < math.pi:
        _set_mirror(context, e, s, r, path, scratch.mirror)
    else:
        scratch.mirror[:, :] = 1.0
    front, field, loud = front_of(path, terms), scratch.field, False
    for k in range(len(heard)):
        mirror = scratch.mirror[0, k], scratch.mirror[1, k]
        field[k, 0] = field_at(path, front, spectrum.k[k, 0], mirror)
        loud = loud or field[k, 0].real ** 2 + field[k, 0].imag ** 2 > heard[k]
    if not loud:
        return
    at = met_point(wedges, e, path.apex)
    p, q = ends.p.end, ends.q.end
    if not (sees(context.sight, p, at) and sees(context.sight, q, at)):
        return
    for k in range(len(heard)):
        mirror = scratch.mirror[0, k], scratch.mirror[1, k]
        for g in range(1, field.shape[1]):
            field[k, g] = field_at(path, front, spectrum.k[k, g], mirror)
    length = path.d_s + path.d_r
    if not 0.0 < path.apex < path.length:
        length = _turned(field, spectrum, length, distance(p.at, at) + distance(at, q.at))
    _add_by_edges(context, ends, (e, -1), (at, at), length, scratch)


@part
def _turned(field: np.ndarray, spectrum: Spectrum, length: float, longer: float) -> float:
    """Let a field be that of a longer path: the sound is the same. Its length."""
    for b in range(field.shape[0]):
        for g in range(field.shape[1]):
            phase = spectrum.k[b, g] * (longer - length)
            field[b, g] *= complex(math.cos(phase), math.sin(phase))
    return longer


@part
def _fades_in(scratch: Scratch) -> float:
    """Share of the energy of what is diffracted that counts: from nothing at `heard` in every band to all at three
    times that."""
    most = 0.0
    for b in range(len(scratch.heard)):
        p = scratch.field[b, 0]
        own = scratch.energy[b] * (p.real * p.real + p.imag * p.imag)
        if own > scratch.heard[b]:
            most = max(most, own / scratch.heard[b] if scratch.heard[b] > 0.0 else 3.0)
    return smooth(0.5 * (most - 1.0))


@part
def _add_by_edges(context: Context, ends: _Ends, edges: tuple[int, int], at: tuple[Vec3, Vec3], length: float, scratch: Scratch) -> None:
    """Add the wave whose field is in the scratch, less what planes take of it."""
    p, q, energy = ends.p.end, ends.q.end, scratch.energy
    energy[:] = 1.0
    at_p, group_p = reflected(context.sight, p, at[0], energy)
    at_q, group_q = reflected(context.sight, q, at[1], energy)
    share = _fades_in(scratch)
    if share <= 0.0:
        return
    for b in range(len(energy)):
        energy[b] *= share
    kind = _KINDS[1 if edges[1] >= 0 else 0, 1 if p.plane >= 0 else 0, 1 if q.plane >= 0 else 0]
    planes, groups = (p.plane, q.plane), (group_p, group_q, -1)
    if p.plane < 0:
        planes, groups = (q.plane, -1), (group_q, -1, -1)
    add_wave(scratch.waves, Path(length, at_p, at_q, planes, kind, edges, groups), scratch.field, energy, True)


@part
def _add_strips(context: Context, ends: _Ends, straight: float, scratch: Scratch) -> None:
    """Waves by both edges of a face."""
    edges, seen = context.edges, ends.p.visible
    set_rows(ends.q, scratch.row_q)
    for n in range(seen.start[ends.p.row], seen.start[ends.p.row + 1]):
        e = seen.wedge[n]
        for m in range(edges.mutual.start[e], edges.mutual.start[e + 1]):
            f = edges.mutual.wedge[m]
            if edges.strip[m] and scratch.row_q[f] >= 0:
                _add_double(context, ends, e, f, straight, scratch)
    clear_rows(ends.q, scratch.row_q)


@part
def _add_doubles(context: Context, ends: _Ends, scratch: Scratch) -> None:
    """Waves by two edges of different bodies, of ends out of sight: into the shadow at one of them at least."""
    edges = context.edges
    mutual, strip = edges.mutual, edges.strip
    set_rows(ends.p, scratch.row_p)
    set_rows(ends.q, scratch.row_q)
    onward = ends.p.onward
    for n in range(onward.start[ends.p.row], onward.start[ends.p.row + 1]):
        m = onward.row[n]
        scratch.continues[m] = True
        f = mutual.wedge[m]
        if not strip[m] and scratch.row_q[f] >= 0:
            _add_double(context, ends, mutual.wedge[mutual.reverse[m]], f, math.inf, scratch)
    onward = ends.q.onward
    for n in range(onward.start[ends.q.row], onward.start[ends.q.row + 1]):
        m = mutual.reverse[onward.row[n]]
        e = mutual.wedge[onward.row[n]]
        if not strip[m] and not scratch.continues[m] and scratch.row_p[e] >= 0:
            _add_double(context, ends, e, mutual.wedge[m], math.inf, scratch)
    onward = ends.p.onward
    for n in range(onward.start[ends.p.row], onward.start[ends.p.row + 1]):
        scratch.continues[onward.row[n]] = False
    clear_rows(ends.p, scratch.row_p)
    clear_rows(ends.q, scratch.row_q)


@part
def _add_double(context: Context, ends: _Ends, e: int, f: int, straight: float, scratch: Scratch) -> None:
    wedges, spectrum, p, q = context.edges.wedges, context.spectrum, ends.p.end, ends.q.end
    inside, x = two_edge_path(wedges, e, f, p.at, q.at, BY_BOTH, reach_beyond(p, q))
    if not inside:
        return
    length = path_length(x)
    if ends.lit and length - straight > _MAX_DETOUR:
        return
    loud = False
    most = 4.0 * math.pi * most_energy(wedges, x, spectrum.k[0, 0])
    for b in range(len(scratch.heard)):
        loud = loud or most > scratch.heard[b]
    if not loud or not legs_clear(context.sight, wedges, x, p, q):
        return
    two_edge_field(wedges, x, (x.lit_p, x.lit_q), 0.0, 0.0, spectrum, scratch.double, scratch.field)
    on_edges = meets_both(wedges, x)
    met_e, met_f = met_point(wedges, e, x.z_e), met_point(wedges, f, x.z_f)
    at_e = x.at_e if on_edges and p.plane < 0 else met_e
    at_f = x.at_f if on_edges and q.plane < 0 else met_f
    if not on_edges:
        longer = distance(p.at, at_e) + distance(at_e, at_f) + distance(at_f, q.at)
        length = _turned(scratch.field, spectrum, length, longer)
    _add_by_edges(context, ends, (e, f), (at_e, at_f), length, scratch)


@part
def _add_edges(context: Context, p: SeenEnd, q: SeenEnd, lit: bool, scratch: Scratch) -> None:
    """Waves by one edge and by two edges of a face, between two ends."""
    if p.visible.start[p.row + 1] == p.visible.start[p.row]:
        return
    if q.visible.start[q.row + 1] == q.visible.start[q.row]:
        return
    ends = _Ends(p, q, lit)
    _add_singles(context, ends, scratch)
    _add_strips(context, ends, distance(p.end.at, q.end.at), scratch)


@part
def _add_images(context: Context, a: ImageSide, b: ImageSide, p: SeenEnd, q: SeenEnd, scratch: Scratch) -> None:
    """Waves by edges of images: of either end with the other point, of both in one plane."""
    sight, waves = context.sight, scratch.waves
    for u in range(a.images.start[p.row], a.images.start[p.row + 1]):
        image = seen_image(sight, a.images, u)
        _add_edges(context, image, q, _has(waves, (image.end.plane, -1), False), scratch)
        for v in range(b.images.start[q.row], b.images.start[q.row + 1]):
            if b.images.plane[v] == image.end.plane:
                _add_edges(context, image, seen_image(sight, b.images, v), False, scratch)
    for v in range(b.images.start[q.row], b.images.start[q.row + 1]):
        image = seen_image(sight, b.images, v)
        _add_edges(context, p, image, _has(waves, (image.end.plane, -1), False), scratch)


@part
def _store(slots: PathSlots, k: int, waves: Waves, i: int, swapped: bool, energy: np.ndarray) -> None:
    """Store wave i of the pair in row k of the slots."""
    at_p, at_q, kind = row(waves.at_p, i), row(waves.at_q, i), waves.kind[i]
    planes = waves.planes[i, 0], waves.planes[i, 1]
    wedges = waves.wedges[i, 0], waves.wedges[i, 1]
    if swapped:
        at_p, at_q = at_q, at_p
        if planes[1] >= 0 and kind != MIRRORS_AND_BACK:
            planes = planes[1], planes[0]
        if wedges[1] >= 0:
            wedges = wedges[1], wedges[0]
        kind = REVERSE_KIND[kind]
    groups = waves.groups[i, 0], waves.groups[i, 1], waves.groups[i, 2]
    store(slots, k, FoundPath(waves.length[i], at_q, at_p, planes, kind, wedges, groups), energy)


@kernel
def find_arrivals(first: int, last: int, context: Context, pairs: np.ndarray, slots: PathSlots, scratch: Scratch) -> None:
    """The arrivals of pairs, solved from the end of the smaller key, so that both directions have the same bits."""
    waves, energy = scratch.waves, scratch.energy
    for k in range(first, last):
        i, j = pairs[k]
        swapped = context.a.points.keys[i] > context.b.points.keys[j]
        a, b = context.a, context.b
        p, q = seen_point(a.points, i), seen_point(b.points, j)
        if swapped:
            a, b, p, q = b, a, q, p
        waves.number[0] = 0
        straight, lit = distance(p.end.at, q.end.at), context.walls[i, j] == 0
        scratch.field[:, :] = 1.0
        for n in range(len(energy)):
            energy[n] = 4.0 * math.pi * context.direct[i, j, n]
        zero = (0.0, 0.0, 0.0)
        add_wave(waves, Path(straight, zero, zero, (-1, -1), _DIRECT, (-1, -1), (-1, -1, -1)), scratch.field, energy, False)
        _add_mirrors(context, i, j, p.end.at, q.end.at, swapped, scratch)
        if straight > context.sight.geometry.epsilon and len(context.edges.wedges.length) > 0:
            _set_heard(scratch, _HEARD)
            _add_edges(context, p, q, lit, scratch)
            if not lit:
                _set_heard(scratch, _HEARD)
                _add_doubles(context, _Ends(p, q, lit), scratch)
            _set_heard(scratch, _HEARD_IMAGES)
            _add_images(context, a, b, p, q, scratch)
        if waves.number[0] > len(waves.length):
            slots.number[k] = -waves.number[0]
            continue
        join(waves, context.spectrum)
        fade(waves, energy)
        for n in range(len(energy)):
            context.joined[i, j, n] = energy_of(waves, 0, n)
        for m in range(1, waves.number[0]):
            most = 0.0
            for n in range(len(energy)):
                energy[n] = energy_of(waves, m, n)
                most = max(most, energy[n])
            if most > 0.0 or not waves.moves[m]:
                _store(slots, k, waves, m, swapped, energy)
