"""A third edge on a path by two: one of the other face of the first edge, before it, or of the second, after it.

The field of a path by edges e and f of one face is multiplied by 1 + u_ge / u_e and 1 + u_fh / u_f, the ratios of
`passed_edges` for a path that goes straight on along the face: where an end crosses the plane of the face, they are
those of the path by one edge, so that the sum of both stays continuous. Where that other face stands on a plane,
the third edge is the mirror image of the first, or of the second (`mirrored_edges`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, length, subtract
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.ends import End, reach_beyond, sees
from soundspaces_sim.transport.diffraction.energy import (
    Interference,
    both_sides,
    clear,
    mean_ratio,
    weigh,
)
from soundspaces_sim.transport.diffraction.mirrored_edges import sees_mirrored
from soundspaces_sim.transport.diffraction.passed_edges import (
    ADDED,
    BESIDE,
    EdgesOfScene,
    PassedScratch,
)
from soundspaces_sim.transport.diffraction.paths import (
    DiffractedPath,
    in_order,
    met_point,
    off_boundary,
    path_about,
    path_field,
    terms_of,
)
from soundspaces_sim.transport.diffraction.sides_of_faces import BY_BOTH, face_normal
from soundspaces_sim.transport.diffraction.spectrum import Quadrature
from soundspaces_sim.transport.diffraction.two_edge_path import (
    TwoEdgePath,
    is_strip,
    path_length,
    two_edge_path,
)
from soundspaces_sim.transport.diffraction.two_edges import most_energy, two_edge_field
from soundspaces_sim.transport.diffraction.wedges import Wedges, wedge_coordinates

_LIFT = 1e-6  # of its distance, by which a place on a face is off it


@part
def _straight_on(wedges: Wedges, e: int, phi: float, at: tuple[Vec3, Vec3], further: float) -> Vec3:
    """A place on a face of edge e, at the angle `phi`: from one place on through another, and `further` m."""
    way = subtract(at[1], at[0])
    scale = 1.0 + further / length(way)
    lift = _LIFT * scale * length(way)
    return along(along(at[0], scale, way), lift, face_normal(wedges, e, phi))


class _Way(NamedTuple):
    """From an end by the first of two edges."""

    e: int
    f: int
    end: End
    seen: np.ndarray  # (E,) row of each wedge that the end sees, -1 for others
    target: Vec3  # m, where the path by the first edge alone goes
    reach: float  # m, `reach_beyond` of both ends


@part
def _add_thirds(
    scene: EdgesOfScene,
    way: _Way,
    heard: float,
    quadrature: Quadrature,
    scratch: PassedScratch,
    sums: Interference,
) -> None:
    """Add the ratios of third edges g between the end and the first edge of a way to sums (b, g)."""
    wedges, e, f, end, seen, target = scene.wedges, way.e, way.f, way.end, way.seen, way.target
    s, r = in_order(wedge_coordinates(wedges, e, end.at), wedge_coordinates(wedges, e, target))
    path = path_about(wedges, e, s, r, off_boundary(s, r, False))
    own = path_field(path, terms_of(path), scene.lowest, 1.0)
    least = max(ADDED * (own.real * own.real + own.imag * own.imag) * INV_4PI, BESIDE * heard)
    for m in range(scene.mutual.start[e], scene.mutual.start[e + 1]):
        g = scene.mutual.wedge[m]
        if scene.strip[m] and g != f and seen[g] >= 0:
            _add_third(scene, way, (g, -1), path, least, quadrature, scratch, sums)
    count = len(scene.mirrored.start) - 1
    for m in range(scene.mirrored.start[e], scene.mirrored.start[e + 1]):
        third = count + m, scene.mirrored.plane[m]
        _add_third(scene, way, third, path, least, quadrature, scratch, sums)


@part
def _add_third(
    scene: EdgesOfScene,
    way: _Way,
    third: tuple[int, int],
    path: DiffractedPath,
    least: float,
    quadrature: Quadrature,
    scratch: PassedScratch,
    sums: Interference,
) -> None:
    """Add the ratio of one third edge, (edge, plane in which it is the mirror image of the first, -1 for none), to
    `path` by the first edge."""
    wedges, other, (g, plane) = scene.wedges, scratch.field[1], third
    inside, x = two_edge_path(wedges, g, way.e, way.end.at, way.target, BY_BOTH, way.reach)
    if not (inside and x.lit_p and not x.lit_q and is_strip(wedges, x)):
        return
    if most_energy(wedges, x, scene.lowest) <= least:
        return
    if plane < 0:
        if not sees(scene.sight, way.end, met_point(wedges, g, x.z_e)):
            return
    else:
        mirrored, z = (way.e, plane), (x.z_e, x.z_f)
        if not sees_mirrored(scene.sight, wedges, mirrored, way.end, z, x.phi_e, scratch.through):
            return
    over = path_length(x) - path.d_s - path.d_r
    counts = two_edge_field(wedges, x, (True, False), over, least, quadrature, scratch.double, other)
    if counts <= 0.0:
        return
    terms = terms_of(path)
    for b in range(other.shape[0]):
        share = counts if plane < 0 else counts * math.sqrt(scratch.through[0, b])
        for n in range(other.shape[1]):
            field = path_field(path, terms, quadrature.k[b, n], 1.0)
            if field != 0j:
                weigh(share * other[b, n] / field, b, n, sums)


@part
def with_third_edges(
    scene: EdgesOfScene,
    x: TwoEdgePath,
    ends: tuple[End, End],
    heard: float,
    quadrature: Quadrature,
    scratch: PassedScratch,
) -> None:
    """Multiply the field (b, g) of a path across a face, in `scratch.field[0]`, by what third edges add."""
    if not is_strip(scene.wedges, x):
        return
    field, before, after = scratch.field[0], scratch.before, scratch.after
    reach = reach_beyond(ends[0], ends[1])
    clear(before)
    clear(after)
    beyond = _straight_on(scene.wedges, x.e, x.phi_f, (x.at_e, x.at_f), x.d_q)
    way = _Way(x.e, x.f, ends[0], scratch.row_a, beyond, reach)
    _add_thirds(scene, way, heard, quadrature, scratch, before)
    beyond = _straight_on(scene.wedges, x.f, x.phi_e, (x.at_f, x.at_e), x.d_p)
    way = _Way(x.f, x.e, ends[1], scratch.row_b, beyond, reach)
    _add_thirds(scene, way, heard, quadrature, scratch, after)
    for b in range(field.shape[0]):
        for g in range(field.shape[1]):
            field[b, g] *= both_sides(mean_ratio(before, b, g), mean_ratio(after, b, g))
