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
from soundspaces_sim.echogram.echogram import EDGE_KINDS, EDGES, MIRRORS, MIRRORS_AND_BACK, REVERSE_KIND
from soundspaces_sim.scene.rays.geometry import unoccluded
from soundspaces_sim.transport.arrivals.double_wedge import DoubleWedgeScratch
from soundspaces_sim.transport.arrivals.field import (
    MOST_SHARE,
    EdgePath,
    Front,
    Spectrum,
    Turn,
    beyond_end,
    detours_of_ends,
    field_at,
    front_of,
    most_of_edge,
    most_share,
    off_reflection,
    terms_by_turns,
    terms_of,
)
from soundspaces_sim.transport.arrivals.for_each_pair import FoundPath, PathSlots, store
from soundspaces_sim.transport.arrivals.images import (
    End,
    Leg,
    View,
    beside_edge,
    end_at,
    image_of,
    leg_to,
    moved_to,
    on_planes,
    reflected,
    reflection_point,
    straight_path,
    trace_mirrors,
    unfold,
)
from soundspaces_sim.transport.arrivals.scene_edges import Edges
from soundspaces_sim.transport.arrivals.sight import (
    Seen,
    Sequences,
    Sight,
    coordinates_in,
    meets,
    row_of,
)
from soundspaces_sim.transport.arrivals.specular_planes import NEAR, SpecularPlanes, cover_at
from soundspaces_sim.transport.arrivals.two_edges import (
    BEYOND,
    estimate,
    meets_both,
    path_length,
    shares_of,
    two_edge_field,
    two_edge_path,
)
from soundspaces_sim.transport.arrivals.waves import (
    Path,
    Waves,
    add_wave,
    energy_of,
    fade,
    join,
    smooth,
)
from soundspaces_sim.transport.arrivals.ways import (
    WayScratch,
    are_linked,
    choose_ways,
    set_way,
    solve_way,
    way_field,
)
from soundspaces_sim.transport.arrivals.wedges import (
    BOUNDARY_OFFSET,
    ON_FACE,
    WedgeCoordinates,
    boundary_tolerance,
    cosine_taper,
    cuts_of,
    edge_point,
    met_edge,
    met_point,
    wedge_coordinates,
)
from soundspaces_sim.transport.bsdf.surface import Surfaces, specular_reflectance

_KINDS = np.array(EDGE_KINDS)
_DIRECT = -1  # kind of the direct sound
_HEARD = 1e-3  # of the energy that a pair has: what is diffracted fades in from so much on, in any band
_HEARD_IMAGES = 3e-3  # the same where an end is an image
_ALONG_FACE = 0.5  # rad, from a face: sound within it runs along the face
_SAFE = 1.1  # times an estimate of a pressure
_LITTLE = 1e-12  # of the energy
_MAX_BEYOND = 0.5  # m, detour by an end of an edge beyond which the apex lies, up to which it counts
_MAX_DETOUR = 2.0  # m, by two edges over what goes straight, up to which they count in the light


class Surroundings(NamedTuple):
    """What is there, and the wave numbers of all bands."""

    sight: View
    edges: Edges
    spectrum: Spectrum


class Context(NamedTuple):
    """What the kernel reads, and `joined`, which it fills."""

    scene: Surroundings
    a: Sight
    b: Sight
    walls: np.ndarray  # (A, B) between the points; 0: they see each other
    direct: np.ndarray  # (A, B, b) J/m², without air
    joined: np.ndarray  # (A, B, b) the same with what joins it


class Pair(NamedTuple):
    """What a thread has of the pair at hand."""

    waves: Waves
    field: np.ndarray  # (b, g) complex, of the wave at hand
    energy: np.ndarray  # (b,)
    heard: np.ndarray  # (b,) least |P|² of a wave that counts
    least: np.ndarray  # (b,) the same of the ends at hand, before what planes take
    images: np.ndarray  # (b, 2) what the images in an edge's faces have of those in rigid ones (T32)


class Marked(NamedTuple):
    """Rows of what an end sees, -1 for none."""

    wedge: np.ndarray  # (w,) by wedge
    link: np.ndarray  # (n,) of its links, by row of `Links`


class Scratch(NamedTuple):
    """What a thread works in."""

    pair: Pair
    marked: Marked
    double: DoubleWedgeScratch
    way: WayScratch


class _Ends(NamedTuple):
    """Two ends in their order."""

    p: End
    q: End
    u: int  # rows of what they see
    v: int
    lit: bool  # they see each other, or there is the reflection between them


class _Least(NamedTuple):
    """|P|² below which nothing is heard in any band, of waves that fall differently with the wave number k."""

    flat: float  # least of all bands
    falls: float  # the same times k


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
def _add_mirrors(
    view: View, own: Sequences, other: Sequences, i: int, j: int, p: Vec3, q: Vec3, pair: Pair
) -> None:
    """Reflections off planes, by the sequences that rays from either end, rows i and j, meet."""
    none = len(view.planes.offset)
    for n in range(own.start[i], own.start[i + 1]):
        one, two = own.planes[n, 0], own.planes[n, 1]
        if two == none:
            _add_mirror(view, (one, -1, -1), p, q, pair)
        else:
            _add_mirror(view, (one, two, -1), p, q, pair)
            _add_mirror(view, (one, two, one), p, q, pair)
    for n in range(other.start[j], other.start[j + 1]):
        two, one = other.planes[n, 0], other.planes[n, 1]
        if one == none:
            if not meets(own, i, two, none):
                _add_mirror(view, (two, -1, -1), p, q, pair)
        else:
            if not meets(own, i, one, two):
                _add_mirror(view, (one, two, -1), p, q, pair)
            if not meets(own, i, two, one):
                _add_mirror(view, (two, one, two), p, q, pair)


@part
def _add_mirror(view: View, met: tuple[int, int, int], p: Vec3, q: Vec3, pair: Pair) -> None:
    a, b, c = met
    end = q
    if c < 0 <= b:
        image = image_of(view.planes, b, image_of(view.planes, a, p))
        if not reflection_point(view.planes, b, image, q)[0]:
            return
        end = beside_edge(view.geometry, view.planes, (a, b), p, q)
    found, path = unfold(view.planes, met, p, end)
    if not (found and on_planes(view, path)):
        return
    length, at_p, at_q = straight_path(view.planes, met, p, q)
    found, groups = trace_mirrors(view, path, length, pair.energy)
    if not found:
        return
    kind = MIRRORS_AND_BACK if c >= 0 else MIRRORS
    pair.field[:, :] = 1.0
    add_wave(
        pair.waves,
        Path(length, at_p, at_q, (a, b), kind, (-1, -1), groups),
        pair.field,
        pair.energy,
        False,
    )


@part
def _set_heard(pair: Pair, share: float) -> None:
    """`Pair.heard`: a share of the energy of the waves that there are."""
    waves, heard = pair.waves, pair.heard
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
    edges: Edges,
    planes: SpecularPlanes,
    ends: _Ends,
    e: int,
    s: WedgeCoordinates,
    r: WedgeCoordinates,
    waves: Waves,
) -> tuple[bool, EdgePath]:
    """The path by an edge between two ends about it, in order; its angles are on the side of each boundary on which
    rays have found sound."""
    wedges = edges.wedges
    length, n, stands = wedges.length[e], wedges.n[e], wedges.stands
    total = math.sqrt((s.r + r.r) ** 2 + (r.z - s.z) ** 2)
    sin_beta = (s.r + r.r) / total
    apex = s.z + (r.z - s.z) * (s.r / (s.r + r.r))
    start, end = detours_of_ends(length, (s.r, r.r), (s.z, r.z), total)
    taper = 1.0
    if apex < 0.0 or apex > length:
        taper = cosine_taper(min(start, end) / _MAX_BEYOND)
    # Between two images in the surface that an edge stands on: it is in the path between the points themselves.
    ok = not ((stands[e, 0] and max(s.z, r.z) < 0.0) or (stands[e, 1] and min(s.z, r.z) > length))
    cut_start, cut_end = cuts_of(wedges, e, s.z, r.z)
    tolerance, spread = boundary_tolerance(wedges, e, s, r), 1.0 / s.r + 1.0 / r.r
    minus, plus = _verdict(r.phi - s.phi, tolerance, ends.lit), s.phi + r.phi
    other = 2.0 * math.pi * n - plus
    a, b = edges.plane[e, 0], edges.plane[e, 1]
    if a >= 0:
        near = tolerance + planes.margin[a] * spread
        if abs(plus - math.pi) <= near:
            plus = _verdict(plus, near, _mirrors(waves, ends.p, ends.q, a))
    if b >= 0:
        near = tolerance + planes.margin[b] * spread
        if abs(other - math.pi) <= near:
            other = _verdict(other, near, _mirrors(waves, ends.p, ends.q, b))
    path = EdgePath(
        n=n,
        minus=minus,
        plus=plus,
        other=other,
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


class _Leaves(NamedTuple):
    """Where sound that runs along a face of an edge leaves it by the side, at right angles to the edge."""

    detour: float  # m, by that side over the straight path
    weight: float  # 1 along the face; 0 off it, near boundaries, or where a path by two edges takes over


@part
def _leaves(edges: Edges, e: int, apex: float, to: float, c: WedgeCoordinates, on: float) -> _Leaves:
    """Of one end about an edge, beyond either end of that, where the way from the apex goes to the angle `to`. What
    leaves the face by a parallel edge stays, so far as a path by both edges takes over, `on` of it."""
    wedges, links = edges.wedges, edges.links
    sector, length = math.pi * wedges.n[e], wedges.length[e]
    phi = min(c.phi, sector - c.phi)
    before, after = c.z < 0.0 and not wedges.stands[e, 0], c.z > length and not wedges.stands[e, 1]
    if phi >= _ALONG_FACE or not (before or after):
        return _Leaves(0.0, 0.0)
    side = 0.0 if before else length
    rise, up, away = abs(c.z - side), c.r * math.sin(phi), c.r * math.cos(phi)
    along = abs(min(max(apex, 0.0), length) - side)
    weight = cosine_taper(phi / _ALONG_FACE) * cosine_taper(math.atan2(up, rise) / _ALONG_FACE)
    for boundary in (abs(c.phi - to), c.phi + to, 2.0 * sector - c.phi - to):
        weight *= 1.0 - cosine_taper(abs(boundary - math.pi) / _ALONG_FACE)
    width, plate = math.inf, sector > 2.0 * math.pi - ON_FACE
    for m in range(links.start[e], links.start[e + 1]):
        if plate or (links.phi[m, 0] > 0.5 * sector) == (c.phi > 0.5 * sector):
            width = min(width, links.width[m])
    if away > 0.5 * width:
        by_corner = math.hypot(along, width) + math.hypot(rise, away - width)
        left = math.sqrt(cosine_taper((by_corner - math.hypot(along + rise, away)) / BEYOND))
        passes = away * along > width * (along + rise)
        weight *= 1.0 - on * (1.0 if passes else left * smooth(2.0 * away / width - 1.0))
    straight = math.sqrt((along + rise) ** 2 + up**2 + away**2)
    by_side = math.hypot(along + math.hypot(rise, up), away)
    return _Leaves(max(by_side - straight, 0.0), weight)


@part(forceinline=True)
def _stays(k: float, leaves: _Leaves) -> float:
    """What is left of a wave: nothing at the boundary of the shadow of the face's side, beyond which it is not."""
    if leaves.weight <= 0.0:
        return 1.0
    b = beyond_end(k, leaves.detour)
    return 1.0 - 2.0 * leaves.weight * math.sqrt(b.real**2 + b.imag**2)


@part(forceinline=True)
def _cosines(path: EdgePath, turns: tuple[Turn, Turn, Turn]) -> tuple[float, float]:
    """Of the angles of incidence on both faces: that of the end nearer to each, sin(beta) sin(phi_s) and sin(beta)
    sin(n pi - phi_r)."""
    of_s, of_r, edge = turns
    sin_s, sin_r = 2.0 * of_s.half_sin * of_s.half_cos, 2.0 * of_r.half_sin * of_r.half_cos
    second = edge.half_sin * (1.0 - 2.0 * of_r.half_sin**2) - edge.half_cos * sin_r
    return max(path.sin_beta * sin_s, 0.0), max(path.sin_beta * second, 0.0)


@part
def _set_images(
    edges: Edges, surfaces: Surfaces, e: int, path: EdgePath, cos: tuple[float, float], out: np.ndarray
) -> None:
    """(T32) of both faces, into `out` (b, 2); `cos` of the angles of incidence."""
    off = off_reflection(path, path.plus), off_reflection(path, path.other)
    for face in range(2):
        near = off[face] < 1.0 and edges.plane[e, face] >= 0
        for b in range(len(out)):
            mirrors = 0.0
            if near:
                material = edges.material[e, face]
                mirrors = math.sqrt(specular_reflectance(surfaces, material, cos[face], b))
            out[b, face] = off[face] * edges.reflects[e, face, b] + (1.0 - off[face]) * mirrors


@part
def _of_rigid(edges: Edges, e: int, phi: float, towards: float, band: int) -> tuple[float, float]:
    """((T34b): share of a rigid edge's field, from an end at `phi` along a face towards another edge; the amplitude
    that this face reflects)."""
    n = edges.wedges.n[e]
    face = 0 if towards < 0.5 * math.pi * n else 1
    own, outer = edges.reflects[e, face, band], edges.reflects[e, 1 - face, band]
    turn = abs(towards - phi)
    less, more = (math.pi - turn) / (2.0 * n), (math.pi + turn) / (2.0 * n)
    lost = (1.0 - own) * math.cos(less) * math.sin(more) + (1.0 - outer) * math.cos(more) * math.sin(
        less
    )
    return 1.0 - lost / (2.0 * math.sin(math.pi / n)), own


class _Gap(NamedTuple):
    """Where a path of an edge goes between the edge's ends, or beyond one."""

    detours: tuple[float, float]  # m, by both ends; infinite where the edge goes on
    beyond: bool
    taper: float  # of the energy: 0 far beyond an end


@part(forceinline=True)
def _gap_of(
    length: float, legs: tuple[float, float], z: tuple[float, float], total: float, beyond: float
) -> _Gap:
    """Of a path that passes an edge, up to `beyond` m longer by its end than by its line."""
    apex = z[0] + (z[1] - z[0]) * legs[0] / (legs[0] + legs[1])
    detours = detours_of_ends(length, legs, z, total)
    if 0.0 <= apex <= length:
        return _Gap(detours, False, 1.0)
    return _Gap(detours, True, cosine_taper((detours[0] if apex < 0.0 else detours[1]) / beyond))


@part(forceinline=True)
def _share_in(k: float, gap: _Gap) -> float:
    """Most of an endless edge's energy that comes from between the ends at a wave number."""
    return most_share(k, gap.detours, gap.beyond) ** 2 * gap.taper


@part
def _mark(seen: Seen, end: int, marked: Marked, there: bool) -> None:
    """Set the rows of an end, or take them away."""
    for n in range(seen.start[end], seen.start[end + 1]):
        marked.wedge[seen.wedge[n]] = n if there else -1
    for n in range(seen.link_start[end], seen.link_start[end + 1]):
        marked.link[seen.link[n]] = n if there else -1


class _About(NamedTuple):
    """Where an end is about an edge."""

    at: WedgeCoordinates
    turn: Turn


@part(forceinline=True)
def _about(seen: Seen, n: int) -> _About:
    """A row of what is seen."""
    turn = seen.turn
    return _About(coordinates_in(seen, n), Turn(turn[n, 0], turn[n, 1], turn[n, 2], turn[n, 3]))


@part
def _add_singles(
    scene: Surroundings, a: Seen, b: Seen, ends: _Ends, least: _Least, marked: np.ndarray, pair: Pair
) -> None:
    """Waves by every edge that both ends see, of which the second is marked."""
    for n in range(a.start[ends.u], a.start[ends.u + 1]):
        e = a.wedge[n]
        m = marked[e]
        if m < 0:
            continue
        s, r = _about(a, n), _about(b, m)
        if _single_may_be_heard(scene.edges, scene.spectrum, e, s, r, least, pair.least):
            if not _in_order(s.at, r.at):
                s, r = r, s
            _add_single(scene, ends, e, s, r, pair)


@part(forceinline=True)
def _over(a: float, b: float) -> float:
    return a / b if abs(b) > _LITTLE else a / _LITTLE


@part
def _single_may_be_heard(
    edges: Edges, spectrum: Spectrum, e: int, p: _About, q: _About, least: _Least, heard: np.ndarray
) -> bool:
    """Whether the wave by a wedge between two ends, p and q about it, is worth computing: by the
    four terms of (T30) far from their boundaries, which are sin(pi/n) / (cos²((phi_r ± phi_s)/2n) - cos²(pi/2n))
    two by two, and never more than half of the geometrical wave each. Where these cancel, what |F(x) - 1| <= 1 / 2x
    and faces that absorb leave of each counts."""
    wedges, k, (a, of_a), (b, of_b) = edges.wedges, spectrum.k[0, 0], p, q
    legs, along = a.r + b.r, b.z - a.z
    squared = legs * legs + along * along
    if least.flat * squared >= MOST_SHARE**2:
        return False
    both, cross = of_a.cos * of_b.cos, of_a.sin * of_b.sin
    cos, size = edges.turn[e, 0] ** 2, 2.0 * edges.turn[e, 0] * edges.turn[e, 1]
    minus, plus = _over(size, (both + cross) ** 2 - cos), _over(size, (both - cross) ** 2 - cos)
    both, cross = of_a.half_cos * of_b.half_cos, of_a.half_sin * of_b.half_sin
    total, product = math.sqrt(squared), a.r * b.r
    near = 0.25 * total / product
    near *= abs(_over(minus, (both + cross) ** 2)) + abs(_over(plus, (both - cross) ** 2))
    most = abs(minus) + abs(plus)
    far = abs(minus + plus) + edges.lost[e] * abs(plus)
    scale = _SAFE**2 * legs / (8.0 * math.pi * wedges.n[e] ** 2 * product)
    if MOST_SHARE**2 * scale * min(most, far + near / k) ** 2 <= least.falls * squared:
        return False
    z = a.z, b.z
    gap = _gap_of(wedges.length[e], (a.r, b.r), z, total, _MAX_BEYOND)
    if gap.taper <= 0.0:
        return False
    goes_on = cuts_of(wedges, e, z[0], z[1])
    start = gap.detours[0] if goes_on[0] > 0.0 else math.inf
    end = gap.detours[1] if goes_on[1] > 0.0 else math.inf
    gap = _Gap((start, end), gap.beyond, gap.taper)
    for band in range(len(heard)):
        k = spectrum.k[band, 0]
        falls = scale * min(most, far + near / k) ** 2
        if min(_share_in(k, gap) * falls, k * MOST_SHARE**2) > heard[band] * squared * k:
            return True
    return False


@part
def _is_heard(
    path: EdgePath, front: Front, k: np.ndarray, images: np.ndarray, least: np.ndarray
) -> bool:
    """Whether the path's wave is above `least` in any band, of those where a bound of it is."""
    for b in range(len(least)):
        mirror = images[b, 0], images[b, 1]
        if most_of_edge(path, front.terms, k[b, 0], mirror) ** 2 > least[b]:
            p = field_at(path, front, k[b, 0], mirror)
            if p.real**2 + p.imag**2 > least[b]:
                return True
    return False


@part(forceinline=True)
def _in_order(a: WedgeCoordinates, b: WedgeCoordinates) -> bool:
    """Whether an end comes before another one: that at the smaller angle."""
    if a.phi != b.phi:
        return a.phi < b.phi
    return a.r < b.r if a.r != b.r else a.z <= b.z


@part
def _add_single(
    scene: Surroundings, ends: _Ends, e: int, first: _About, second: _About, pair: Pair
) -> None:
    """The wave by an edge between two ends about it, that at the smaller angle first."""
    (s, of_s), (r, of_r), turn = first, second, scene.edges.turn
    of_edge = Turn(turn[e, 0], turn[e, 1], turn[e, 2], turn[e, 3])
    wedges, spectrum = scene.edges.wedges, scene.spectrum
    ok, path = _edge_path(scene.edges, scene.sight.planes, ends, e, s, r, pair.waves)
    if not ok:
        return
    field, least = pair.field, pair.least
    plus = s.phi + r.phi
    exact, terms = terms_by_turns(path, of_s, of_r, of_edge)
    exact &= path.minus == r.phi - s.phi and path.plus == plus
    if not (exact and path.other == 2.0 * math.pi * path.n - plus):
        terms = terms_of(path)  # an angle was moved to the other side of its boundary
    front, cos, images = front_of(path, terms), _cosines(path, (of_s, of_r, of_edge)), pair.images
    _set_images(scene.edges, scene.sight.surfaces, e, path, cos, images)
    if not _is_heard(path, front, spectrum.k, images, least):
        return
    at, p, q = met_point(wedges, e, path.apex), ends.p, ends.q
    from_p = leg_to(scene.sight, p, at)
    if not from_p.free:
        return
    from_q = leg_to(scene.sight, q, at)
    if not from_q.free:
        return
    at = met_edge(wedges, e, path.apex)
    from_p, from_q = moved_to(scene.sight, p, from_p, at), moved_to(scene.sight, q, from_q, at)
    beyond = path.start if path.apex < 0.0 else (path.end if path.apex > path.length else 0.0)
    on = math.sqrt(cosine_taper(beyond / BEYOND))
    leave_s = _leaves(scene.edges, e, path.apex, r.phi, s, on)
    leave_r = _leaves(scene.edges, e, path.apex, s.phi, r, on)
    for b in range(len(least)):
        mirror = images[b, 0], images[b, 1]
        for g in range(field.shape[1]):
            k = spectrum.k[b, g]
            field[b, g] = field_at(path, front, k, mirror) * _stays(k, leave_s) * _stays(k, leave_r)
    length = path.d_s + path.d_r
    if not 0.0 < path.apex < path.length:
        length = _turned(field, spectrum, length, distance(p.at, at) + distance(at, q.at))
    _add_by_edges(scene.sight, ends, (e, -1), (from_p, from_q), length, False, pair)


@part
def _turned(field: np.ndarray, spectrum: Spectrum, length: float, longer: float) -> float:
    """Let a field be that of a longer path: the sound is the same. Its length."""
    for b in range(field.shape[0]):
        for g in range(field.shape[1]):
            phase = spectrum.k[b, g] * (longer - length)
            field[b, g] *= complex(math.cos(phase), math.sin(phase))
    return longer


@part
def _fades_in(pair: Pair) -> float:
    """Share of the energy of what is diffracted that counts: from nothing at `heard` in every band to all at three
    times that."""
    most = 0.0
    for b in range(len(pair.heard)):
        p = pair.field[b, 0]
        own = pair.energy[b] * (p.real * p.real + p.imag * p.imag)
        if own > pair.heard[b]:
            most = max(most, own / pair.heard[b] if pair.heard[b] > 0.0 else 3.0)
    return smooth(0.5 * (most - 1.0))


@part
def _add_by_edges(
    view: View,
    ends: _Ends,
    edges: tuple[int, int],
    legs: tuple[Leg, Leg],
    length: float,
    more: bool,
    pair: Pair,
) -> None:
    """Add the wave whose field is at hand, less what planes take of it; `more` edges than two."""
    p, q, energy = ends.p, ends.q, pair.energy
    energy[:] = 1.0
    at_p, group_p = reflected(view, p, legs[0], energy)
    at_q, group_q = reflected(view, q, legs[1], energy)
    share = _fades_in(pair)
    if share <= 0.0:
        return
    for b in range(len(energy)):
        energy[b] *= share
    kind = _KINDS[1 if edges[1] >= 0 else 0, 1 if p.plane >= 0 else 0, 1 if q.plane >= 0 else 0]
    if more:
        kind = EDGES
    planes, groups = (p.plane, q.plane), (group_p, group_q, -1)
    if p.plane < 0:
        planes, groups = (q.plane, -1), (group_q, -1, -1)
    add_wave(pair.waves, Path(length, at_p, at_q, planes, kind, edges, groups), pair.field, energy, True)


@part
def _double_may_be_heard(
    edges: Edges,
    spectrum: Spectrum,
    a: Seen,
    b: Seen,
    n: int,
    m: int,
    straight: float,
    lit: bool,
    least: np.ndarray,
) -> bool:
    """Whether the wave by both wedges of a link, row n of the first end's links and row m of the second's, is worth
    computing: by the product of both coefficients in the plane across, which are never more than a free field."""
    wedges, links = edges.wedges, edges.links
    at = a.link[n]
    i, j = a.link_row[n], b.link_row[m]
    e, f, r_p, w, r_q = a.wedge[i], b.wedge[j], a.r[i], links.width[at], b.r[j]
    across, rest = r_p + w + r_q, w + r_q
    along = links.sense[at] * b.z[j] + links.shift[at] - a.z[i]
    squared = across * across + along * along
    if lit and squared > (straight + _MAX_DETOUR) ** 2:
        return False
    first, second = a.link_size[n] * across / rest, b.link_size[m] * rest / w
    # A quarter, as the face's image is in both, and twice that, as it is off by some dB.
    scale = 0.5 / squared
    if not _is_above(first, second, scale, spectrum, least):
        return False
    total = math.sqrt(squared)
    z = a.z[i], a.z[i] + along
    by_e = _gap_of(wedges.length[e], (r_p, rest), z, total, BEYOND)
    if by_e.taper <= 0.0:
        return False
    z = links.sense[at] * (a.z[i] - links.shift[at]), b.z[j]
    by_f = _gap_of(wedges.length[f], (r_p + w, r_q), z, total, BEYOND)
    if by_f.taper <= 0.0:
        return False
    for band in range(len(least)):
        k = spectrum.k[band, 0]
        share = min(_share_in(k, by_e), _share_in(k, by_f))
        if share * scale * min(first, k) * min(second, k) > least[band] * k * k:
            return True
    return False


@part(forceinline=True)
def _is_above(first: float, second: float, scale: float, spectrum: Spectrum, least: np.ndarray) -> bool:
    """Whether scale * min(first / k, 1) * min(second / k, 1), and what an edge of finite length may add to that, is
    above `least` in any band."""
    for b in range(len(least)):
        k = spectrum.k[b, 0]
        if MOST_SHARE**2 * scale * min(first, k) * min(second, k) > least[b] * k * k:
            return True
    return False


@part
def _add_doubles(
    scene: Surroundings, a: Seen, b: Seen, ends: _Ends, straight: float, scratch: Scratch
) -> None:
    """Waves by two edges of one face; the second end is marked."""
    edges, least, lit = scene.edges, scratch.pair.least, ends.lit
    for n in range(a.link_start[ends.u], a.link_start[ends.u + 1]):
        m = scratch.marked.link[edges.links.reverse[a.link[n]]]
        if m >= 0 and _double_may_be_heard(edges, scene.spectrum, a, b, n, m, straight, lit, least):
            e, f = a.wedge[a.link_row[n]], b.wedge[b.link_row[m]]
            _add_double(scene, ends, e, f, straight, scratch.pair, scratch.double)


@part
def _add_double(
    scene: Surroundings,
    ends: _Ends,
    e: int,
    f: int,
    straight: float,
    pair: Pair,
    scratch: DoubleWedgeScratch,
) -> None:
    wedges, spectrum, view, p, q = scene.edges.wedges, scene.spectrum, scene.sight, ends.p, ends.q
    inside, x = two_edge_path(wedges, e, f, p.at, q.at)
    if not inside:
        return
    length, loud = path_length(x), False
    if ends.lit and length - straight > _MAX_DETOUR:
        return
    shares, lowest = shares_of(wedges, x), spectrum.k[0, 0]
    most = estimate(wedges, x, shares, lowest)
    for b in range(len(pair.least)):  # each edge takes one over the root of the wave number
        loud = loud or most * (lowest / spectrum.k[b, 0]) ** 2 > pair.least[b]
    if not loud:
        return
    met_e, met_f = met_point(wedges, e, x.z_e), met_point(wedges, f, x.z_f)
    from_p = leg_to(view, p, met_e)
    if not from_p.free:
        return
    from_q = leg_to(view, q, met_f)
    if not (from_q.free and unoccluded(view.geometry, met_e, met_f)):
        return
    if not two_edge_field(wedges, x, shares, spectrum, pair.least, scratch, pair.field):
        return
    leave_p = _leaves(scene.edges, e, x.z_e, x.phi_f, wedge_coordinates(wedges, e, p.at), 1.0)
    leave_q = _leaves(scene.edges, f, x.z_f, x.phi_e, wedge_coordinates(wedges, f, q.at), 1.0)
    for b in range(len(pair.least)):
        of_e, face = _of_rigid(scene.edges, e, x.phi_p, x.phi_f, b)
        of_f, _ = _of_rigid(scene.edges, f, x.phi_q, x.phi_e, b)
        for g in range(pair.field.shape[1]):
            k = spectrum.k[b, g]
            of_sides = _stays(k, leave_p) * _stays(k, leave_q)
            pair.field[b, g] *= 2.0 * of_e * of_f / (1.0 + face) * of_sides
    met_e, met_f = met_edge(wedges, e, x.z_e), met_edge(wedges, f, x.z_f)
    if not meets_both(wedges, x):
        longer = distance(p.at, met_e) + distance(met_e, met_f) + distance(met_f, q.at)
        length = _turned(pair.field, spectrum, length, longer)
    legs = moved_to(view, p, from_p, met_e), moved_to(view, q, from_q, met_f)
    _add_by_edges(view, ends, (e, f), legs, length, False, pair)


@part
def _add_way(
    scene: Surroundings, a: Sight, b: Sight, i: int, j: int, ends: _Ends, pair: Pair, way: WayScratch
) -> None:
    """Add the wave of the shortest way round several edges that is free, of the ways of either point to edges that
    the other one sees; by one edge, or two of a face, it is there."""
    edges, p, q = scene.edges, ends.p.at, ends.q.at
    of_q, of_p = row_of(b.seen, ends.v), row_of(a.seen, ends.u)
    from_p = choose_ways(edges.wedges, a.ways, i, of_q, b.seen.wedge, b.seen.phi, q, 0, way)
    from_q = choose_ways(edges.wedges, b.ways, j, of_p, a.seen.wedge, a.seen.phi, p, 1, way)
    m = n = count = 0
    length = 0.0
    while count == 0 and (m < from_p or n < from_q):
        if n == from_q or (m < from_p and way.total[0, m] <= way.total[1, n]):
            count = set_way(a.ways, i, way.last[0, m], False, way)
            m += 1
        else:
            count = set_way(b.ways, j, way.last[1, n], True, way)
            n += 1
        count, length = solve_way(scene.sight, edges, count, p, q, way)
    if count < 2:
        return
    e, f = way.edge[0], way.edge[count - 1]
    if count == 2 and are_linked(edges.links, e, f):
        return
    if way_field(length, distance(p, q), scene.spectrum, pair.least, pair.field):
        to_e = Leg(True, edge_point(edges.wedges, e, way.z[0]), -1)
        to_f = Leg(True, edge_point(edges.wedges, f, way.z[count - 1]), -1)
        _add_by_edges(scene.sight, ends, (e, f), (to_e, to_f), length, count > 2, pair)


@part
def _set_least(reflects: np.ndarray, k: np.ndarray, p: int, q: int, pair: Pair) -> _Least:
    """`Pair.least` of ends in two planes, of which each reflects so much at most (P, b), at wave numbers k (b, g),
    and the least of it."""
    flat = falls = math.inf
    for b in range(len(pair.least)):
        left = 1.0
        if p >= 0:
            left *= reflects[p, b]
        if q >= 0:
            left *= reflects[q, b]
        least = max(pair.heard[b] / max(left, _LITTLE), _LITTLE**2)
        pair.least[b] = least
        flat, falls = min(flat, least), min(falls, least * k[b, 0])
    return _Least(flat, falls)


@part
def _mirrors_near(view: View, plane: int, p: Vec3, q: Vec3) -> bool:
    """Whether there are triangles of a plane near the place of reflection between two points."""
    found, x = reflection_point(view.planes, plane, image_of(view.planes, plane, p), q)
    return found and cover_at(view.cover, plane, x) >= NEAR


@part
def _add_edges(
    scene: Surroundings, a: Sight, b: Sight, i: int, j: int, lit: bool, scratch: Scratch
) -> None:
    """Waves by edges: between both points, of either's images with the other point, and of both in one plane."""
    at_p, at_q, view, of_points = row(a.points, i), row(b.points, j), scene.sight, True
    pair = scratch.pair
    _set_heard(pair, _HEARD)
    for v in range(b.ends[j], b.ends[j + 1]):
        _mark(b.seen, v, scratch.marked, True)
        for u in range(a.ends[i], a.ends[i + 1]):
            plane_p, plane_q = a.plane[u], b.plane[v]
            if min(plane_p, plane_q) >= 0 and plane_p != plane_q:
                continue
            plane, reached = max(plane_p, plane_q), lit
            if plane >= 0:
                if lit and not _mirrors_near(view, plane, at_p, at_q):
                    continue
                if of_points:
                    _set_heard(pair, _HEARD_IMAGES)
                of_points = False
                reached = min(plane_p, plane_q) < 0 and _has(pair.waves, (plane, -1), False)
            p, q = end_at(view, plane_p, at_p), end_at(view, plane_q, at_q)
            ends = _Ends(p, q, u, v, reached)
            least = _set_least(view.reflects, scene.spectrum.k, plane_p, plane_q, pair)
            _add_singles(scene, a.seen, b.seen, ends, least, scratch.marked.wedge, pair)
            _add_doubles(scene, a.seen, b.seen, ends, distance(p.at, q.at), scratch)
            if plane < 0 and not lit:
                _add_way(scene, a, b, i, j, ends, pair, scratch.way)
        _mark(b.seen, v, scratch.marked, False)


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
    scene, pair = context.scene, scratch.pair
    waves, energy = pair.waves, pair.energy
    for k in range(first, last):
        i, j = pairs[k]
        swapped = context.a.keys[i] > context.b.keys[j]
        a, b, of_a, of_b = context.a, context.b, i, j
        if swapped:
            a, b, of_a, of_b = b, a, j, i
        waves.number[0] = 0
        p, q = row(a.points, of_a), row(b.points, of_b)
        straight = distance(p, q)
        pair.field[:, :] = 1.0
        for n in range(len(energy)):
            energy[n] = 4.0 * math.pi * context.direct[i, j, n]
        zero = (0.0, 0.0, 0.0)
        add_wave(
            waves,
            Path(straight, zero, zero, (-1, -1), _DIRECT, (-1, -1), (-1, -1, -1)),
            pair.field,
            energy,
            False,
        )
        _add_mirrors(scene.sight, a.sequences, b.sequences, of_a, of_b, p, q, pair)
        if straight > scene.sight.geometry.epsilon and len(scene.edges.wedges.length) > 0:
            _add_edges(scene, a, b, of_a, of_b, context.walls[i, j] == 0, scratch)
        if waves.number[0] > len(waves.length):
            slots.number[k] = -waves.number[0]
            continue
        join(waves, scene.spectrum)
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
