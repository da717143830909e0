"""All that arrives discretely between two points: candidates, geometry, field, one sum.

An *end* is a point or its image in a plane. Between two ends go the direct sound or the reflections off planes, the
waves by every edge that both see, and those by two edges. What a wave may have at most is estimated first, from
tables (`sight`); what might be heard is solved, checked by rays and computed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, row
from soundspaces_sim.echogram.echogram import EDGE_KINDS, MIRRORS, MIRRORS_AND_BACK, REVERSE_KIND
from soundspaces_sim.scene.rays.geometry import unoccluded
from soundspaces_sim.transport.arrivals.double_wedge import DoubleWedgeScratch
from soundspaces_sim.transport.arrivals.field import (
    MOST_SHARE,
    EdgePath,
    Spectrum,
    field_at,
    front_of,
    most_of_edge,
    most_share,
    terms_of,
)
from soundspaces_sim.transport.arrivals.for_each_pair import FoundPath, PathSlots, store
from soundspaces_sim.transport.arrivals.images import End, View, beside_edge, reflected, sees
from soundspaces_sim.transport.arrivals.mirrors import in_boxes, straight_path, trace_mirrors, unfold
from soundspaces_sim.transport.arrivals.scene_edges import Edges
from soundspaces_sim.transport.arrivals.sight import (
    Seen,
    SeenEnd,
    Sight,
    coordinates_in,
    seen_image,
    seen_point,
)
from soundspaces_sim.transport.arrivals.two_edges import (
    BEYOND,
    TwoEdgePath,
    estimate,
    meets_both,
    path_length,
    two_edge_field,
    two_edge_path,
)
from soundspaces_sim.transport.arrivals.waves import Path, Waves, add_wave, energy_of, fade, join, smooth
from soundspaces_sim.transport.arrivals.wedges import (
    BOUNDARY_OFFSET,
    WedgeCoordinates,
    Wedges,
    boundary_tolerance,
    cosine_taper,
    cuts_of,
    in_order,
    met_point,
)
from soundspaces_sim.transport.bsdf.surface import specular_reflectance

_KINDS = np.array(EDGE_KINDS)
_DIRECT = -1  # kind of the direct sound
_HEARD = 1e-3  # of the energy that a pair has: what is diffracted fades in from so much on, in any band
_HEARD_IMAGES = 3e-3  # the same where an end is an image
_SAFE = 1.1  # times an estimate of a pressure
_LITTLE = 1e-12  # of the energy
_MAX_BEYOND = 0.5  # m, detour by an end of an edge beyond which the apex lies, up to which it counts
_MAX_DETOUR = 2.0  # m, by two edges over what goes straight, up to which they count in the light


class Context(NamedTuple):
    """What the kernel reads, and `joined`, which it fills."""

    sight: View
    edges: Edges
    spectrum: Spectrum
    a: Sight
    b: Sight
    walls: np.ndarray  # (A, B) between the points; 0: they see each other
    direct: np.ndarray  # (A, B, b) J/m², without air
    joined: np.ndarray  # (A, B, b) the same with what joins it


class Scratch(NamedTuple):
    """What a thread works in."""

    waves: Waves
    field: np.ndarray  # (b, g) complex
    energy: np.ndarray  # (b,)
    heard: np.ndarray  # (b,) least |P|² of a wave that counts
    least: np.ndarray  # (b,) the same of the ends at hand, before what planes take
    mirror: np.ndarray  # (2, b)
    link: (
        np.ndarray
    )  # (n,) rows of the second end's links, by `MutualVisibility` from the first end; -1 for none
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
        same = waves.planes[i, 0] == planes[0] and waves.planes[i, 1] == planes[1]
        if same and waves.kind[i] != _DIRECT and back == (waves.kind[i] == MIRRORS_AND_BACK):
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
def _add_mirrors(context: Context, a: Sight, b: Sight, i: int, j: int, scratch: Scratch) -> None:
    """Reflections off planes, by the sequences that rays from either end meet."""
    own, other = a.sequences, b.sequences
    p, q = row(a.points, i), row(b.points, j)
    last = own.seen.shape[1]
    for n in range(own.start[i], own.start[i + 1]):
        one, two = own.planes[n, 0], own.planes[n, 1]
        _add_mirror(context, (one, two, -1), p, q, scratch)
        if two >= 0:
            _add_mirror(context, (one, two, one), p, q, scratch)
    for n in range(other.start[j], other.start[j + 1]):
        two, one = other.planes[n, 0], other.planes[n, 1]
        if one < 0:
            one, two = two, -1
        if not own.seen[i, one, two if two >= 0 else last]:
            _add_mirror(context, (one, two, -1), p, q, scratch)
        if two >= 0 and not own.seen[i, two, one]:
            _add_mirror(context, (two, one, two), p, q, scratch)


@part
def _add_mirror(context: Context, met: tuple[int, int, int], p: Vec3, q: Vec3, scratch: Scratch) -> None:
    sight, energy = context.sight, scratch.energy
    a, b, c = met
    end = beside_edge(sight.geometry, sight.planes, (a, b), p, q) if c < 0 <= b else q
    found, path = unfold(sight.planes, met, p, end)
    if not (found and in_boxes(sight, path)):
        return
    length, at_p, at_q = straight_path(sight.planes, met, p, q)
    found, groups = trace_mirrors(sight, path, length, energy)
    if not found:
        return
    kind = MIRRORS_AND_BACK if c >= 0 else MIRRORS
    scratch.field[:, :] = 1.0
    add_wave(
        scratch.waves,
        Path(length, at_p, at_q, (a, b), kind, (-1, -1), groups),
        scratch.field,
        energy,
        False,
    )


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
def _on_side(
    context: Context,
    ends: _Ends,
    e: int,
    s: WedgeCoordinates,
    r: WedgeCoordinates,
    path: EdgePath,
    waves: Waves,
) -> EdgePath:
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
def _set_mirror(
    context: Context,
    e: int,
    s: WedgeCoordinates,
    r: WedgeCoordinates,
    path: EdgePath,
    mirror: np.ndarray,
) -> None:
    """Amplitudes (2, b) that both faces reflect between two ends; edges are rigid in the shadow."""
    surfaces, edges = context.sight.surfaces, context.edges
    if path.minus >= math.pi:
        mirror[:, :] = 1.0
        return
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


@part(forceinline=True)
def _by_ends(
    k: float,
    length: float,
    legs: tuple[float, float],
    z: tuple[float, float],
    total: float,
    beyond: float,
) -> float:
    """Bound of the part of a field that comes from between the ends of an edge; 0 where the path is farther beyond
    one of them than `beyond`, m."""
    apex = z[0] + (z[1] - z[0]) * legs[0] / (legs[0] + legs[1])
    left = length - z[0], length - z[1]
    start = math.sqrt(legs[0] ** 2 + z[0] ** 2) + math.sqrt(legs[1] ** 2 + z[1] ** 2) - total
    end = math.sqrt(legs[0] ** 2 + left[0] ** 2) + math.sqrt(legs[1] ** 2 + left[1] ** 2) - total
    start, end = max(start, 0.0), max(end, 0.0)
    if (apex < 0.0 and start > beyond) or (apex > length and end > beyond):
        return 0.0
    return most_share(k, start, end)


@part
def _add_singles(context: Context, ends: _Ends, scratch: Scratch) -> None:
    """Waves by every edge that both ends see."""
    seen_p, seen_q = ends.p.seen, ends.q.seen
    n, stop_n = seen_p.start[ends.p.row], seen_p.start[ends.p.row + 1]
    m, stop_m = seen_q.start[ends.q.row], seen_q.start[ends.q.row + 1]
    while n < stop_n and m < stop_m:
        e, f = seen_p.wedge[n], seen_q.wedge[m]
        if e == f and _single_may_be_heard(context, seen_p, seen_q, n, m, scratch.least):
            _add_single(context, ends, e, coordinates_in(seen_p, n), coordinates_in(seen_q, m), scratch)
        n += e <= f
        m += f <= e


@part(forceinline=True)
def _over(a: float, b: float) -> float:
    return a / b if abs(b) > _LITTLE else a / _LITTLE


@part
def _single_may_be_heard(context: Context, a: Seen, b: Seen, n: int, m: int, least: np.ndarray) -> bool:
    """Whether the wave by a wedge, row n of what one end sees and row m of the other, is worth computing: by the
    four terms of (T30) far from their boundaries, which are 2 sin(pi/n) / (cos((phi_r ± phi_s)/n) - cos(pi/n))
    two by two, and never more than half of the geometrical wave each."""
    wedges, e = context.edges.wedges, a.wedge[n]
    index, k = wedges.n[e], context.spectrum.k
    legs, z = a.r[n] + b.r[m], (a.z[n], b.z[m])
    total = math.sqrt(legs * legs + (z[1] - z[0]) ** 2)
    share = _by_ends(k[0, 0], wedges.length[e], (a.r[n], b.r[m]), z, total, _MAX_BEYOND)
    if wedges.stands[e, 0] or wedges.stands[e, 1]:
        share = MOST_SHARE
    if share <= 0.0:
        return False
    both, cross = a.cos[n] * b.cos[m], a.sin[n] * b.sin[m]
    edge, size = context.edges.turn[e, 0], 2.0 * context.edges.turn[e, 1]
    first, second = _over(size, both + cross - edge), _over(size, both - cross - edge)
    sum_of, spread = abs(first + second), a.r[n] * b.r[m] / legs
    for band in range(len(least)):
        front = 2.0 * index * math.sqrt(2.0 * math.pi * k[band, 0] * spread)
        most = share * min(_SAFE * sum_of / front, 1.0) / total
        if most * most > least[band]:
            return True
    return False


@part
def _add_single(
    context: Context, ends: _Ends, e: int, a: WedgeCoordinates, b: WedgeCoordinates, scratch: Scratch
) -> None:
    s, r = in_order(a, b)
    wedges, spectrum = context.edges.wedges, context.spectrum
    ok, path = _edge_path(wedges, e, s, r)
    if not ok:
        return
    path = _on_side(context, ends, e, s, r, path, scratch.waves)
    terms, field, least = terms_of(path), scratch.field, scratch.least
    loudest, most = 0, 0.0
    for k in range(len(least)):
        bound = most_of_edge(path, terms, spectrum.k[k, 0]) ** 2
        if bound > most * least[k]:
            loudest, most = k, bound / max(least[k], _LITTLE)
    if most <= 1.0:
        return
    front = front_of(path, terms)
    _set_mirror(context, e, s, r, path, scratch.mirror)
    mirror = scratch.mirror[0, loudest], scratch.mirror[1, loudest]
    first = field_at(path, front, spectrum.k[loudest, 0], mirror)
    if first.real**2 + first.imag**2 <= least[loudest]:
        return
    at = met_point(wedges, e, path.apex)
    p, q = ends.p.end, ends.q.end
    if not (sees(context.sight, p, at) and sees(context.sight, q, at)):
        return
    for k in range(len(least)):
        mirror = scratch.mirror[0, k], scratch.mirror[1, k]
        for g in range(field.shape[1]):
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
def _add_by_edges(
    context: Context,
    ends: _Ends,
    edges: tuple[int, int],
    at: tuple[Vec3, Vec3],
    length: float,
    scratch: Scratch,
) -> None:
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
    add_wave(
        scratch.waves, Path(length, at_p, at_q, planes, kind, edges, groups), scratch.field, energy, True
    )


@part
def _may_be_heard(
    context: Context, ends: _Ends, n: int, m: int, straight: float, least: np.ndarray
) -> bool:
    """Whether the wave by both wedges of a link, row n of the first end and row m of the second, is worth
    computing: by the product of both coefficients in the plane across."""
    p, q, wedges, links = ends.p.seen, ends.q.seen, context.edges.wedges, context.edges.links
    a, b, at = p.link_row[n], q.link_row[m], p.link[n]
    e, f = p.wedge[a], q.wedge[b]
    r_p, w, r_q = p.r[a], links.width[at], q.r[b]
    across, rest, k = r_p + w + r_q, w + r_q, context.spectrum.k[0, 0]
    total, share = max(across, straight), 1.0
    if links.sense[at] != 0.0:
        z = p.z[a], links.sense[at] * q.z[b] + links.shift[at]
        total = math.sqrt(across * across + (z[1] - z[0]) ** 2)
        z_f = links.sense[at] * (z[0] - links.shift[at]), q.z[b]
        share = _by_ends(k, wedges.length[e], (r_p, rest), z, total, BEYOND)
        share = min(share, _by_ends(k, wedges.length[f], (r_p + w, r_q), z_f, total, BEYOND))
    if share <= 0.0 or (ends.lit and total - straight > _MAX_DETOUR):
        return False
    common = 0.5 if links.strip[at] else 1.0
    for band in range(len(least)):
        front = 2.0 * math.sqrt(2.0 * math.pi * context.spectrum.k[band, 0])
        first = min(p.link_cot[n] / (wedges.n[e] * front) / math.sqrt(r_p * rest * across), 1.0 / across)
        second = min(q.link_cot[m] / (wedges.n[f] * front) / math.sqrt(w * r_q * rest), 1.0 / rest)
        u = common * share * rest * first * second * across / total
        if 2.0 * u * u > least[band]:
            return True
    return False


@part
def _add_doubles(context: Context, ends: _Ends, others: bool, straight: float, scratch: Scratch) -> None:
    """Waves by two edges: those of one face or, into the shadow at both of them or nearly, `others`."""
    mutual, p, q, link = context.edges.mutual, ends.p.seen, ends.q.seen, scratch.link
    i, j = ends.p.row, ends.q.row
    begin = q.link_split[j] if others else q.link_start[j]
    end = q.link_start[j + 1] if others else q.link_split[j]
    for m in range(begin, end):
        link[mutual.reverse[q.link[m]]] = m
    for n in range(
        p.link_split[i] if others else p.link_start[i],
        p.link_start[i + 1] if others else p.link_split[i],
    ):
        m = link[p.link[n]]
        if m < 0 or (others and not (p.link_shadow[n] and q.link_shadow[m])):
            continue
        if _may_be_heard(context, ends, n, m, straight, scratch.least):
            _add_double(context, ends, p.wedge[p.link_row[n]], q.wedge[q.link_row[m]], straight, scratch)
    for m in range(begin, end):
        link[mutual.reverse[q.link[m]]] = -1


@part
def _clear(context: Context, x: TwoEdgePath, p: End, q: End) -> bool:
    """Whether nothing is in the way of a path by two edges."""
    wedges, view = context.edges.wedges, context.sight
    at_e, at_f = met_point(wedges, x.e, x.z_e), met_point(wedges, x.f, x.z_f)
    return sees(view, p, at_e) and sees(view, q, at_f) and unoccluded(view.geometry, at_e, at_f)


@part
def _add_double(
    context: Context, ends: _Ends, e: int, f: int, straight: float, scratch: Scratch
) -> None:
    wedges, spectrum, p, q = context.edges.wedges, context.spectrum, ends.p.end, ends.q.end
    inside, x = two_edge_path(wedges, e, f, p.at, q.at)
    if not inside:
        return
    length, loud = path_length(x), False
    if ends.lit and length - straight > _MAX_DETOUR:
        return
    most, lowest = estimate(wedges, x, spectrum.k[0, 0]), spectrum.k[0, 0]
    for b in range(len(scratch.least)):  # each edge takes one over the root of the wave number
        loud = loud or most * (lowest / spectrum.k[b, 0]) ** 2 > scratch.least[b]
    if not loud or not _clear(context, x, p, q):
        return
    if not two_edge_field(wedges, x, spectrum, scratch.least, scratch.double, scratch.field):
        return
    on_edges = meets_both(wedges, x)
    met_e, met_f = met_point(wedges, e, x.z_e), met_point(wedges, f, x.z_f)
    at_e = x.at_e if on_edges and p.plane < 0 else met_e
    at_f = x.at_f if on_edges and q.plane < 0 else met_f
    if not on_edges:
        longer = distance(p.at, at_e) + distance(at_e, at_f) + distance(at_f, q.at)
        length = _turned(scratch.field, spectrum, length, longer)
    _add_by_edges(context, ends, (e, f), (at_e, at_f), length, scratch)


@part
def _set_least(context: Context, p: End, q: End, scratch: Scratch) -> None:
    """`Scratch.least` of two ends."""
    for b in range(len(scratch.least)):
        left = 1.0
        if p.plane >= 0:
            left *= context.sight.reflects[p.plane, b]
        if q.plane >= 0:
            left *= context.sight.reflects[q.plane, b]
        scratch.least[b] = scratch.heard[b] / max(left, _LITTLE)


@part
def _add_edges(context: Context, p: SeenEnd, q: SeenEnd, lit: bool, scratch: Scratch) -> None:
    """Waves by one edge and by two edges of a face, between two ends."""
    if p.seen.start[p.row + 1] == p.seen.start[p.row] or q.seen.start[q.row + 1] == q.seen.start[q.row]:
        return
    ends = _Ends(p, q, lit)
    _set_least(context, p.end, q.end, scratch)
    _add_singles(context, ends, scratch)
    _add_doubles(context, ends, False, distance(p.end.at, q.end.at), scratch)


@part
def _add_images(context: Context, a: Sight, b: Sight, i: int, j: int, scratch: Scratch) -> None:
    """Waves by edges of images: of either end with the other point, of both in one plane."""
    view, waves, p, q = context.sight, scratch.waves, seen_point(a, i), seen_point(b, j)
    for u in range(a.image_start[i], a.image_start[i + 1]):
        image = seen_image(view, a, i, u)
        _add_edges(context, image, q, _has(waves, (image.end.plane, -1), False), scratch)
        for v in range(b.image_start[j], b.image_start[j + 1]):
            if b.plane[v] == image.end.plane:
                _add_edges(context, image, seen_image(view, b, j, v), False, scratch)
    for v in range(b.image_start[j], b.image_start[j + 1]):
        image = seen_image(view, b, j, v)
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
def find_arrivals(
    first: int, last: int, context: Context, pairs: np.ndarray, slots: PathSlots, scratch: Scratch
) -> None:
    """The arrivals of pairs, solved from the end of the smaller key, so that both directions have the same bits."""
    waves, energy = scratch.waves, scratch.energy
    for k in range(first, last):
        i, j = pairs[k]
        swapped = context.a.keys[i] > context.b.keys[j]
        a, b, of_a, of_b = context.a, context.b, i, j
        if swapped:
            a, b, of_a, of_b = b, a, j, i
        p, q = seen_point(a, of_a), seen_point(b, of_b)
        waves.number[0] = 0
        straight, lit = distance(p.end.at, q.end.at), context.walls[i, j] == 0
        scratch.field[:, :] = 1.0
        for n in range(len(energy)):
            energy[n] = 4.0 * math.pi * context.direct[i, j, n]
        zero = (0.0, 0.0, 0.0)
        add_wave(
            waves,
            Path(straight, zero, zero, (-1, -1), _DIRECT, (-1, -1), (-1, -1, -1)),
            scratch.field,
            energy,
            False,
        )
        _add_mirrors(context, a, b, of_a, of_b, scratch)
        if straight > context.sight.geometry.epsilon and len(context.edges.wedges.length) > 0:
            _set_heard(scratch, _HEARD)
            _add_edges(context, p, q, lit, scratch)
            if not lit:
                _set_heard(scratch, _HEARD)
                _set_least(context, p.end, q.end, scratch)
                _add_doubles(context, _Ends(p, q, lit), True, straight, scratch)
            _set_heard(scratch, _HEARD_IMAGES)
            _add_images(context, a, b, of_a, of_b, scratch)
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
