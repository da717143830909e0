"""The ends of paths by edges: a point, or its image in a specular plane, from which sound comes by that plane."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, subtract
from soundspaces_sim.echogram.echogram import EDGE_KINDS
from soundspaces_sim.scene.rays.geometry import Geometry, material_met, unoccluded
from soundspaces_sim.transport.bsdf.surface import Surfaces, attenuate_specular
from soundspaces_sim.transport.image_source.images import image_of, sees_by_plane, signed_distance
from soundspaces_sim.transport.image_source.specular_planes import SpecularPlanes
from soundspaces_sim.transport.path_table import FoundPath

_KINDS = np.array(EDGE_KINDS)
_BEYOND = 0.2  # m, most detour by the end beyond which the apex of a path by two edges lies


class View(NamedTuple):
    """What rays meet, and the planes that reflect."""

    geometry: Geometry
    surfaces: Surfaces
    planes: SpecularPlanes
    boxes: np.ndarray  # (P, 2, 3) m, bounds of each plane's triangles


class End(NamedTuple):
    """`at`: where sound seems to come from; `point`: the point itself; `plane` that reflects it, -1 for none."""

    at: Vec3
    point: Vec3
    plane: int


@part(forceinline=True)
def point_end(p: Vec3) -> End:
    """A point itself."""
    return End(p, p, -1)


@part(forceinline=True)
def image_end(view: View, plane: int, p: Vec3) -> End:
    """A point's image in a plane."""
    return End(image_of(view.planes, plane, p), p, plane)


@part(forceinline=True)
def reach_beyond(p: End, q: End) -> float:
    """Detour by the end of an edge, m, up to which the apex of a path by two edges may be beyond it; of images
    none, as they would take twice the time."""
    return _BEYOND


@part
def sees(view: View, end: End, target: Vec3) -> bool:
    """Whether sound gets from an end to a place."""
    if end.plane < 0:
        return unoccluded(view.geometry, end.point, target)
    triangle, _ = sees_by_plane(
        view.geometry, view.planes, view.boxes, end.plane, end.point, end.at, target
    )
    return triangle >= 0


@part
def reflected(view: View, end: End, target: Vec3, energy: np.ndarray) -> tuple[Vec3, int]:
    """(Unit vector in which sound leaves an end for a place, group of what reflects it), after what that takes from
    energies (b,)."""
    towards, group = target, -1
    if end.plane >= 0:
        triangle, towards = sees_by_plane(
            view.geometry, view.planes, view.boxes, end.plane, end.point, end.at, target
        )
        material = material_met(view.geometry, triangle, subtract(towards, end.point))
        far = distance(end.point, towards)
        cos = min(abs(signed_distance(view.planes, end.plane, end.point)) / far, 1.0)
        attenuate_specular(view.surfaces, material, cos, energy)
        group = view.surfaces.group[material]
    along = subtract(towards, end.point)
    return divide(along, distance(towards, end.point)), group


@part
def edge_path(
    view: View,
    ends: tuple[End, End],
    swapped: bool,
    edges: tuple[int, int],
    at: tuple[Vec3, Vec3],
    length: float,
    energy: np.ndarray,
) -> FoundPath:
    """The path from an end by one edge or two, which it meets `at` two places, to another, its energies (b,) less
    what planes take. `swapped`: the second end is of side a."""
    at_p, group_p = reflected(view, ends[0], at[0], energy)
    at_q, group_q = reflected(view, ends[1], at[1], energy)
    planes, groups = (ends[0].plane, ends[1].plane), (group_p, group_q)
    if swapped:
        planes, groups, edges = (planes[1], planes[0]), (group_q, group_p), (edges[1], edges[0])
        at_p, at_q = at_q, at_p
    kind = _KINDS[
        1 if min(edges[0], edges[1]) >= 0 else 0, 1 if planes[0] >= 0 else 0, 1 if planes[1] >= 0 else 0
    ]
    if edges[0] < 0:
        edges = edges[1], edges[0]
    if planes[0] < 0:
        planes, groups = (planes[1], planes[0]), (groups[1], groups[0])
    return FoundPath(length, at_q, at_p, planes, kind, edges, (groups[0], groups[1], -1))
