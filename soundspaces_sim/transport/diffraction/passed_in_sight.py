"""Edges that the direct sound passes, and the ratios of their fields to its own.

Two edges of one face count together, with the paths by both and, where it is one with the direct sound, the
reflection between them: the field of a wall's top is that of all.
"""

from __future__ import annotations

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import distance
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.energy import (
    Interference,
    add_field,
    clear,
    copy_field,
    detour_taper,
    merged_share,
    reflected_share,
    scale_field,
    weigh,
)
from soundspaces_sim.transport.diffraction.passed_edges import (
    EdgePair,
    EdgesOfScene,
    PassedScratch,
    passes_mirrored,
)
from soundspaces_sim.transport.diffraction.paths import (
    DiffractedPath,
    edge_share,
    faded_in,
    terms_of,
)
from soundspaces_sim.transport.diffraction.reflector_geometry import below_face, reflection_in_face
from soundspaces_sim.transport.diffraction.sides_of_faces import BY_BOTH
from soundspaces_sim.transport.diffraction.spectrum import Quadrature
from soundspaces_sim.transport.diffraction.two_edge_sight import legs_clear
from soundspaces_sim.transport.diffraction.two_edges import (
    TwoEdgePath,
    is_strip,
    most_energy,
    path_length,
    two_edge_field,
    two_edge_path,
)
from soundspaces_sim.transport.diffraction.utd import WedgeTerms, wedge_fields

_WEAK = 0.05  # of the strongest edge's ratio: by its fourth power less has no weight, four times larger either


@part
def add_passed(
    e: int,
    path: DiffractedPath,
    quadrature: Quadrature,
    straight: float,
    scratch: PassedScratch,
    found: int,
) -> int:
    """Note an edge that the direct sound of `straight` m passes, after `found` others, or where there is no more
    room in place of the weakest; how many there are then."""
    detour, most, at = path.d_s + path.d_r - straight, 0.0, found
    terms = terms_of(path)
    for b in range(quadrature.k.shape[0]):
        ratio, of_length = scratch.ratio[:, found, b], scratch.of_length[found, b]
        most = max(most, _set_ratio(path, terms, b, quadrature, straight, ratio, of_length))
    if found == len(scratch.edge):
        at = 0
        for m in range(1, found):
            if scratch.size[m] < scratch.size[at]:
                at = m
        if most <= scratch.size[at]:
            return found
        scratch.position[scratch.edge[at]] = -1
        copy_field(scratch.of_length[found], scratch.of_length[at])
        for t in range(3):
            copy_field(scratch.ratio[t, found], scratch.ratio[t, at])
    scratch.edge[at], scratch.share[at], scratch.detour[at] = e, reflected_share(path), detour
    scratch.position[e], scratch.size[at] = at, most
    return min(found + 1, len(scratch.edge))


@part
def _set_ratio(
    path: DiffractedPath,
    terms: WedgeTerms,
    b: int,
    quadrature: Quadrature,
    straight: float,
    ratio: np.ndarray,
    of_length: np.ndarray,
) -> float:
    """Ratios (3, h) of an edge's three terms to the direct sound in a band, and what its length leaves (h) of them;
    the largest sum of their sizes."""
    detour, most = path.d_s + path.d_r - straight, 0.0
    ratio[:, :], of_length[:] = 0j, 0j
    if detour_taper(detour, quadrature.k[b, 0]) <= 0.0:
        return most
    for n in range(quadrature.node.shape[1]):
        fields = wedge_fields(path.n, terms, path.d_s, path.d_r, path.sin_beta, quadrature.node[b, n])
        for h in range(quadrature.k.shape[1]):
            share = quadrature.between[b, h, n]
            for t in range(3):
                ratio[t, h] += share * fields[t]
    for h in range(quadrature.k.shape[1]):
        k, total = quadrature.k[b, h], 0.0
        size = straight * detour_taper(detour, k)
        of_length[h] = math.sqrt(path.taper) * edge_share(path, k)
        phase = complex(size * math.cos(k * detour), -size * math.sin(k * detour)) * of_length[h]
        for t in range(3):
            ratio[t, h] *= phase
            total += abs(ratio[t, h])
        most = max(most, total)
    return most


@part
def interference(
    scene: EdgesOfScene,
    pair: EdgePair,
    quadrature: Quadrature,
    found: int,
    faint: float,
    scratch: PassedScratch,
    sums: Interference,
) -> None:
    """Sums over the edges that were noted: of each, with the other edges of its faces. What those add fades where
    they or the edge are below the energy `faint`, J/m², or the edge has no weight beside the strongest one."""
    clear(sums)
    total, reflected, rest, merged = scratch.lit[0], scratch.lit[1], scratch.lit[3], scratch.merged
    strongest, strips = 0.0, 0
    for m in range(found):
        strongest = max(strongest, scratch.size[m])
    floor = math.sqrt(faint / INV_4PI) * distance(pair.p.at, pair.q.at)
    least = max(floor, _WEAK * strongest)
    for m in range(found):
        counts = faded_in(scratch.size[m] ** 2, least * least)
        for b in range(total.shape[0]):
            for h in range(total.shape[1]):
                total[b, h], merged[b, h] = scratch.ratio[0, m, b, h], 0.0
                reflected[b, h] = 0.0
                rest[b, h] = scratch.ratio[1, m, b, h] + scratch.ratio[2, m, b, h]
        if counts > 0.0:
            strips = _add_strips(scene, m, pair, quadrature, strips, faint, scratch)
        for b in range(total.shape[0]):
            for h in range(total.shape[1]):
                share = max(scratch.share[m], merged[b, h])
                ratio = total[b, h] + share * reflected[b, h] + scratch.share[m] * rest[b, h]
                if counts < 1.0:
                    last = scratch.ratio[1, m, b, h] + scratch.ratio[2, m, b, h]
                    alone = scratch.ratio[0, m, b, h] + scratch.share[m] * last
                    ratio = alone + counts * (ratio - alone)
                weigh(ratio, b, h, sums)
    for m in range(found):
        scratch.position[scratch.edge[m]] = -1


@part
def _strip_field(
    scene: EdgesOfScene,
    row: int,
    x: TwoEdgePath,
    pair: EdgePair,
    quadrature: Quadrature,
    strips: int,
    faint: float,
    scratch: PassedScratch,
) -> tuple[bool, int]:
    """(Whether the legs of a path across a strip are clear, how many strips are known then); its field goes into
    `scratch.lit[2]`, fading below the energy `faint`, J/m². Row `row` of `MutualVisibility` is that of its
    edges."""
    known = -1
    for n in range(strips):
        if scratch.strip[n] == row:
            known = n
    if known >= 0:
        copy_field(scratch.of_strip[known], scratch.lit[2])
        return scratch.clear[known], strips
    found, counts = legs_clear(scene.sight, scene.wedges, x, pair.p, pair.q), 0.0
    if found and most_energy(scene.wedges, x, scene.lowest) > faint:
        over, field = path_length(x) - distance(pair.p.at, pair.q.at), scratch.lit[2]
        sees = pair.row_p[x.f] >= 0, pair.row_q[x.e] >= 0
        counts = two_edge_field(scene.wedges, x, sees, over, faint, quadrature, scratch.double, field)
    scale_field(scratch.lit[2], counts)
    if strips < len(scratch.strip):
        scratch.strip[strips], scratch.clear[strips] = row, found
        copy_field(scratch.lit[2], scratch.of_strip[strips])
        strips += 1
    return found, strips


@part
def _add_strips(
    scene: EdgesOfScene,
    m: int,
    pair: EdgePair,
    quadrature: Quadrature,
    strips: int,
    faint: float,
    scratch: PassedScratch,
) -> int:
    """Add to what edge `m` does that of each other edge of its faces and the paths by both; how many strips are
    known then, of `strips` before."""
    e, wedges = scratch.edge[m], scene.wedges
    straight = distance(pair.p.at, pair.q.at)
    done_first, done_second = _add_mirrored(scene, m, pair, quadrature, faint, scratch)
    for row in range(scene.mutual.start[e], scene.mutual.start[e + 1]):
        f, strip, below = scene.mutual.wedge[row], False, False
        if not scene.strip[row] or (pair.row_p[f] < 0 and pair.row_q[f] < 0):
            continue
        phi, other = (0.0, 0.0), scratch.position[f]
        for order in range(2):
            first, second = (e, f) if order == 0 else (f, e)
            if pair.row_p[first] < 0 or pair.row_q[second] < 0:
                continue
            inside, x = two_edge_path(wedges, first, second, pair.p.at, pair.q.at, BY_BOTH)
            if not (inside and is_strip(wedges, x)):
                continue
            key = row if order == 0 else scene.mutual.reverse[row]
            found, strips = _strip_field(scene, key, x, pair, quadrature, strips, faint, scratch)
            if not found:
                continue
            strip, phi = True, (x.phi_f, x.phi_e) if order == 0 else (x.phi_e, x.phi_f)
            below = other < 0 and below_face(wedges, e, phi[0], pair)
            if below:
                _add_below(scratch.lit[2], straight, m, quadrature, scratch)
            else:
                add_field(scratch.lit[2], straight, scratch.lit[1])
        if not strip or (other < 0 and not below):
            continue
        face = 1 if phi[0] <= 0.0 else 2
        if not (done_first if face == 1 else done_second):  # the strip's own reflection is with it
            add_field(scratch.ratio[face, m], -1.0, scratch.lit[3])
            if below:
                _add_below(scratch.ratio[face, m], 1.0, m, quadrature, scratch)
            else:
                add_field(scratch.ratio[face, m], 1.0, scratch.lit[1])
            done_first, done_second = done_first or face == 1, done_second or face == 2
        if not below:
            _add_other(scene, m, other, phi, pair, quadrature, scratch)
    return strips


@part
def _add_mirrored(
    scene: EdgesOfScene,
    m: int,
    pair: EdgePair,
    quadrature: Quadrature,
    faint: float,
    scratch: PassedScratch,
) -> tuple[bool, bool]:
    """`_add_strips` of the mirror images of edge `m`; which of its two faces stand on a plane."""
    e, straight, field = scratch.edge[m], distance(pair.p.at, pair.q.at), scratch.lit[2]
    done_first = done_second = False
    for row in range(scene.mirrored.start[e], scene.mirrored.start[e + 1]):
        for side in range(2):
            after, before = side == 0, side == 1
            near, x = passes_mirrored(scene, e, row, pair, (after, 0.0), scratch.through)
            if not near:
                continue
            over, both = path_length(x) - straight, (before, after)
            counts = two_edge_field(
                scene.wedges, x, both, over, faint, quadrature, scratch.double, field
            )
            for b in range(field.shape[0]):
                scale_field(field[b : b + 1], counts * math.sqrt(scratch.through[0, b]))
            _add_below(field, straight, m, quadrature, scratch)
            face = 1 if (x.phi_f if after else x.phi_e) <= 0.0 else 2
            if not (done_first if face == 1 else done_second):
                add_field(scratch.ratio[face, m], -1.0, scratch.lit[3])
                _add_below(scratch.ratio[face, m], 1.0, m, quadrature, scratch)
                done_first, done_second = done_first or face == 1, done_second or face == 2
    return done_first, done_second


@part
def _add_other(
    scene: EdgesOfScene,
    m: int,
    other: int,
    phi: tuple[float, float],
    pair: EdgePair,
    quadrature: Quadrature,
    scratch: PassedScratch,
) -> None:
    """Add to what edge `m` does that of another edge of a face that is passed as well, at angles `phi` about each
    other, and where it is one with the direct sound the reflection between them."""
    e, f, wedges = scratch.edge[m], scratch.edge[other], scene.wedges
    add_field(scratch.ratio[0, other], 1.0, scratch.lit[0])
    face = 1 if phi[1] <= 0.0 else 2
    add_field(scratch.ratio[face, other], 1.0, scratch.lit[1])
    rest = scratch.ratio[3 - face, other]
    if below_face(wedges, f, math.pi * wedges.n[f] if face == 1 else 0.0, pair):
        _add_below(rest, 1.0, other, quadrature, scratch)
    else:
        add_field(rest, scratch.share[other], scratch.lit[0])
    straight = distance(pair.p.at, pair.q.at)
    length, met = reflection_in_face(wedges, e, phi[0], pair)
    met = met and reflection_in_face(wedges, f, phi[1], pair)[1]
    _merge(straight, length - straight, met, (m, other), quadrature, scratch)


@part
def _merge(
    straight: float,
    later: float,
    met: bool,
    edges: tuple[int, int],
    quadrature: Quadrature,
    scratch: PassedScratch,
) -> None:
    """How far two edges that were noted are one with the direct sound, and, if the strip's reflection is `met`, its
    part in it, `later` than what comes straight; of a strip that ends as much as of its edges' waves."""
    m, other = edges
    detour = max(scratch.detour[m], scratch.detour[other])
    for b in range(quadrature.k.shape[0]):
        for h in range(quadrature.k.shape[1]):
            k = quadrature.k[b, h]
            merged = merged_share(k, later, detour)
            scratch.merged[b, h] = max(scratch.merged[b, h], merged)
            if met:
                size = merged * straight / (straight + later)
                of_length = 0.5 * (scratch.of_length[m, b, h] + scratch.of_length[other, b, h])
                phase = complex(size * math.cos(k * later), -size * math.sin(k * later))
                scratch.lit[0][b, h] += of_length * phase


@part
def _add_below(
    field: np.ndarray, weight: float, m: int, quadrature: Quadrature, scratch: PassedScratch
) -> None:
    """Add what a strip reflects below whose plane an end is: near the edge it is one with the direct sound."""
    for b in range(field.shape[0]):
        for h in range(field.shape[1]):
            share = max(scratch.share[m], detour_taper(scratch.detour[m], quadrature.k[b, h]))
            scratch.lit[0][b, h] += weight * share * field[b, h]
