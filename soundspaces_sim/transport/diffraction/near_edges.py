"""Edges of planes that a pair's reflections pass closely: those of finite reflectors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport.diffraction.ends import View
from soundspaces_sim.transport.diffraction.paths import MAX_DETOUR, in_order
from soundspaces_sim.transport.diffraction.plane_edges import PlaneEdges, face_of
from soundspaces_sim.transport.diffraction.reflector_geometry import (
    face_between,
    is_behind,
    least_detour,
    path_beside,
    reflection_by,
    turn_by,
)
from soundspaces_sim.transport.diffraction.seen_ends import (
    SeenEnd,
    clear_rows,
    fewer_wedges,
    set_rows,
)
from soundspaces_sim.transport.diffraction.spectrum import Spectrum
from soundspaces_sim.transport.diffraction.visible_wedges import coordinates_in
from soundspaces_sim.transport.diffraction.wedges import Wedges

_ROUNDING = 1e-9  # m


class ReflectorEdges(NamedTuple):
    """The edges of a scene's planes."""

    sight: View
    wedges: Wedges
    plane_edges: PlaneEdges
    spectrum: Spectrum


class NearEdges(NamedTuple):
    """Edges of planes that reflections of a pair pass closely, at most all E of the scene."""

    row_p: np.ndarray  # (E,) of what the first end sees
    row_q: np.ndarray  # (E,) of what the second end sees
    plane: np.ndarray  # (E,)
    piece: np.ndarray  # (E,) of the plane: the reflector
    detour: np.ndarray  # (E,) m, by the edge over the path by the endless plane
    beside: np.ndarray  # (E,) rad, by which that path misses the plane; negative: it meets it
    length: np.ndarray  # (E,) m, of that path
    row: np.ndarray  # (E,) of what an end sees, by wedge: -1 between pairs


class Pair(NamedTuple):
    """The ends at hand, points or images; `lit`: they see each other, or there is the reflection between them."""

    p: SeenEnd
    q: SeenEnd
    lit: bool


@part
def find_near_edges(edges: ReflectorEdges, pair: Pair, near: NearEdges) -> int:
    """How many edges of planes the reflections between two ends pass closely; fills as many rows."""
    wedges, plane_edges = edges.wedges, edges.plane_edges
    visible_a, visible_b, found = pair.p.visible, pair.q.visible, 0
    images = max(pair.p.end.plane, pair.q.end.plane) >= 0
    first, seen, begin, end = fewer_wedges(pair.p, pair.q)
    more = pair.q if first else pair.p
    set_rows(more, near.row)
    for n in range(begin, end):
        e = seen[n]
        own, other = (n, near.row[e]) if first else (near.row[e], n)
        if near.row[e] < 0 or (plane_edges.plane[e, 0] < 0 and plane_edges.plane[e, 1] < 0):
            continue
        s, r = in_order(coordinates_in(visible_a, own), coordinates_in(visible_b, other))
        face, sector = face_between(wedges, e, s, r), math.pi * wedges.n[e]
        plane = plane_edges.plane[e, face]
        if plane < 0 or r.phi - s.phi >= math.pi or (images and is_behind(sector, s, r, face)):
            continue
        if least_detour(s, r, turn_by(wedges, e, s, r, face)) > MAX_DETOUR + _ROUNDING:
            continue
        reflection, dz = reflection_by(wedges, e, s, r), r.z - s.z
        detour = math.sqrt((s.r + r.r) ** 2 + dz * dz) - reflection.length
        if detour < MAX_DETOUR:
            near.row_p[found], near.row_q[found], near.plane[found] = own, other, plane
            near.piece[found] = plane_edges.piece[e, face]
            near.detour[found], near.beside[found] = detour, reflection.beside
            near.length[found] = reflection.length
            found += 1
    clear_rows(more, near.row)
    return found


@part
def tapers_in_line(
    edges: ReflectorEdges, pair: Pair, n: int, face: int, first: int, count: int, near: NearEdges
) -> float:
    """Of the edges in line with that of row n, as between shelves: the sum of their amplitudes' tapers, at least 1.
    Each has the field of a whole line, as others across it tell where the reflector ends."""
    line, wedges, total = edges.plane_edges.line, edges.wedges, 0.0
    own = line[pair.p.visible.wedge[near.row_p[n]], face]
    if own < 0:
        return 1.0
    for m in range(first, count):
        e = pair.p.visible.wedge[near.row_p[m]]
        if (
            near.piece[m] == near.piece[n]
            and line[e, face_of(edges.plane_edges, e, near.plane[m])] == own
        ):
            a = coordinates_in(pair.p.visible, near.row_p[m])
            b = coordinates_in(pair.q.visible, near.row_q[m])
            s, r = in_order(a, b)
            total += math.sqrt(path_beside(wedges, e, s, r, near.beside[m]).taper)
    return max(total, 1.0)
