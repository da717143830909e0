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
from soundspaces_sim.transport.diffraction.ends import reach_beyond
from soundspaces_sim.transport.diffraction.energy import (
    Interference,
    add_field,
    clear,
    copy_field,
    detour_taper,
    merged_share,
    scale_field,
    weigh,
)
from soundspaces_sim.transport.diffraction.passed_edges import (
    EdgePair,
    EdgesOfScene,
    PassedScratch,
    passes_mirrored,
)
from soundspaces_sim.transport.diffraction.paths import cosine_taper, faded_in
from soundspaces_sim.transport.diffraction.reflector_geometry import below_face, reflection_in_face
from soundspaces_sim.transport.diffraction.sides_of_faces import BY_BOTH, common_face
from soundspaces_sim.transport.diffraction.spectrum import Quadrature
from soundspaces_sim.transport.diffraction.two_edge_path import (
    TwoEdgePath,
    is_strip,
    path_length,
    two_edge_path,
)
from soundspaces_sim.transport.diffraction.two_edge_sight import legs_clear
from soundspaces_sim.transport.diffraction.two_edges import most_energy, two_edge_field

_BEYOND = 0.15  # m, up to this detour by its end an edge bounds a strip beside which the apex lies
_WEAK = 0.05  # of the strongest edge's ratio: by its fourth power less has no weight, four times larger either


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
    straight, reach = distance(pair.p.at, pair.q.at), reach_beyond(pair.p, pair.q)
    scratch.moved[:] = 0.0
    _add_mirrored(scene, m, pair, quadrature, faint, scratch)
    for row in range(scene.mutual.start[e], scene.mutual.start[e + 1]):
        f, strip, below = scene.mutual.wedge[row], False, False
        if not scene.strip[row] or (pair.row_p[f] < 0 and pair.row_q[f] < 0):
            continue
        phi, other, met, open_way = (0.0, 0.0), scratch.position[f], False, False
        weight = 1.0
        if other >= 0:  # whether or not paths by both edges meet them between their ends
            strip, phi = common_face(wedges, (e, f), (pair.p.at, pair.q.at))
            weight = cosine_taper(max(scratch.beyond[m], scratch.beyond[other]) / _BEYOND)
        for order in range(2):
            first, second = (e, f) if order == 0 else (f, e)
            if pair.row_p[first] < 0 or pair.row_q[second] < 0:
                continue
            inside, x = two_edge_path(wedges, first, second, pair.p.at, pair.q.at, BY_BOTH, reach)
            if not (inside and is_strip(wedges, x)):
                continue
            key = row if order == 0 else scene.mutual.reverse[row]
            found, strips = _strip_field(scene, key, x, pair, quadrature, strips, faint, scratch)
            met, open_way = True, open_way or found
            if not found:
                continue
            if other < 0:
                strip, phi = True, (x.phi_f, x.phi_e) if order == 0 else (x.phi_e, x.phi_f)
                below = below_face(wedges, e, phi[0], pair)
            if below:
                _add_below(scratch.lit[2], straight, m, quadrature, scratch)
            else:
                add_field(scratch.lit[2], straight, scratch.lit[1])
        if not strip or (met and not open_way) or (other < 0 and not below):
            continue
        _move_reflection(m, phi[0], weight, below, quadrature, scratch)
        if not below and weight > 0.0:
            _add_other(scene, (m, other), phi, pair, weight, quadrature, scratch)
    return strips


@part
def _add_mirrored(
    scene: EdgesOfScene,
    m: int,
    pair: EdgePair,
    quadrature: Quadrature,
    faint: float,
    scratch: PassedScratch,
) -> None:
    """`_add_strips` of the mirror images of edge `m`."""
    e, straight, field = scratch.edge[m], distance(pair.p.at, pair.q.at), scratch.lit[2]
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
            _move_reflection(m, x.phi_f if after else x.phi_e, 1.0, True, quadrature, scratch)


@part
def _move_reflection(
    m: int, phi: float, weight: float, below: bool, quadrature: Quadrature, scratch: PassedScratch
) -> None:
    """Let what the face of edge `m` at `phi` reflects count with the strip that the face is, up to a weight in all
    of the strips that it is part of. `below`: an end is below its plane."""
    face = 1 if phi <= 0.0 else 2
    left, ratio = weight - scratch.moved[face - 1], scratch.ratio[face, m]
    if not left > 0.0:
        return
    scratch.moved[face - 1] = weight
    add_field(ratio, -left, scratch.lit[3])
    if below:
        _add_below(ratio, left, m, quadrature, scratch)
    else:
        add_field(ratio, left, scratch.lit[1])


@part
def _add_other(
    scene: EdgesOfScene,
    noted: tuple[int, int],
    phi: tuple[float, float],
    pair: EdgePair,
    weight: float,
    quadrature: Quadrature,
    scratch: PassedScratch,
) -> None:
    """Add with a weight, to what the first edge of `noted` does, that of the second one, with which it bounds a
    face at angles `phi` about each other, and where it is one with the direct sound the reflection between them."""
    (m, other), wedges = noted, scene.wedges
    e, f = scratch.edge[m], scratch.edge[other]
    add_field(scratch.ratio[0, other], weight, scratch.lit[0])
    face = 1 if phi[1] <= 0.0 else 2
    add_field(scratch.ratio[face, other], weight, scratch.lit[1])
    rest = scratch.ratio[3 - face, other]
    if below_face(wedges, f, math.pi * wedges.n[f] if face == 1 else 0.0, pair):
        _add_below(rest, weight, other, quadrature, scratch)
    else:
        add_field(rest, weight * scratch.share[other], scratch.lit[0])
    straight = distance(pair.p.at, pair.q.at)
    length, met = reflection_in_face(wedges, e, phi[0], pair)
    met = met and reflection_in_face(wedges, f, phi[1], pair)[1]
    _merge((straight, length - straight), met, noted, weight, quadrature, scratch)


@part
def _merge(
    lengths: tuple[float, float],
    met: bool,
    noted: tuple[int, int],
    weight: float,
    quadrature: Quadrature,
    scratch: PassedScratch,
) -> None:
    """How far two edges that were noted are one with the direct sound, and, if the strip's reflection is `met`, its
    part in it; of a strip that ends as much as of its edges' waves. `lengths`: of the way straight, and by how much
    that of the reflection is longer, m."""
    (m, other), (straight, later) = noted, lengths
    detour = max(scratch.detour[m], scratch.detour[other])
    for b in range(quadrature.k.shape[0]):
        for h in range(quadrature.k.shape[1]):
            k = quadrature.k[b, h]
            merged = weight * merged_share(k, later, detour)
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
