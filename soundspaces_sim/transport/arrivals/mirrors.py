"""Early specular reflections by image sources: paths of one or two grouped planes, or there and back.

The sequences of planes that are worth trying for a pair are those that rays from either end meet (`sequences`).
Each is solved by images (`images`), checked by rays, and stored as an arrival with its exact delay and direction:
its energy is R_a(theta_a) R_b(theta_b) / (4 pi r²), r the distance from the last image. A path there and back
meets a second plane between two reflections by the first, as sound between a floor and a table top does. Specular
subpaths leave exactly this class of paths out, so nothing is counted twice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, subtract
from soundspaces_sim.scene.rays.geometry import material_met, unoccluded
from soundspaces_sim.transport.arrivals.cover import THERE, cover_at
from soundspaces_sim.transport.arrivals.images import (
    View,
    bounce,
    image_of,
    reflection_point,
    signed_distance,
)
from soundspaces_sim.transport.arrivals.specular_planes import SpecularPlanes
from soundspaces_sim.transport.bsdf.surface import specular_reflectance

ORDER = 2  # planes on a path; longer specular paths but for those there and back are left to `specular`
_LEAST_LEG = 1e-12  # m
_EXACT = 1e-3  # m, of a plane's margin: rays from both ends find the same


@part(forceinline=True)
def by_images(reflections: int, back: bool) -> bool:
    """Whether image sources make a path that planes alone have mirrored so often; `back`: by the first one again
    after the second."""
    return reflections <= ORDER or back


Met = tuple[int, int, int]  # planes that a path meets in order, -1 for none


class SpecularPath(NamedTuple):
    """A path from p by up to three planes to q. Where there are fewer, the last place counts for those missing."""

    met: Met
    p: Vec3
    x: Vec3
    y: Vec3
    z: Vec3
    q: Vec3


@part(forceinline=True)
def _last(path: SpecularPath) -> Vec3:
    return path.x if path.met[1] < 0 else (path.y if path.met[2] < 0 else path.z)


@part(forceinline=True)
def unfold(planes: SpecularPlanes, met: Met, p: Vec3, q: Vec3) -> tuple[bool, SpecularPath]:
    """The path from p by planes to q as the images have it; whether the line from the last image crosses the planes
    in order."""
    a, b, c = met
    one = image_of(planes, a, p)
    two = image_of(planes, b, one) if b >= 0 else one
    three = image_of(planes, c, two) if c >= 0 else two
    ok, x, y, z = True, q, q, q
    if c >= 0:
        ok, z = reflection_point(planes, c, three, q)
    if ok and b >= 0:
        ok, y = reflection_point(planes, b, two, z)
    if ok:
        ok, x = reflection_point(planes, a, one, y)
    return ok, SpecularPath(met, p, x, y, z, q)


@part(forceinline=True)
def on_planes(view: View, path: SpecularPath) -> bool:
    """Whether there are triangles at the points of reflection."""
    a, b, c = path.met
    return (
        cover_at(view.cover, a, path.x) >= THERE
        and (b < 0 or cover_at(view.cover, b, path.y) >= THERE)
        and (c < 0 or cover_at(view.cover, c, path.z) >= THERE)
    )


@part
def trace_mirrors(view: View, path: SpecularPath, length: float, energy: np.ndarray) -> tuple[bool, Met]:
    """(Whether rays follow a path, the groups of what reflects); its |P|² over a length, m, into `energy` (b,)."""
    if length <= 0.0 or distance(path.x, path.p) <= 0.0 or distance(_last(path), path.q) <= 0.0:
        return False, (-1, -1, -1)
    a, b, c = path.met
    margin = view.planes.margin
    exact = max(margin[a], margin[b] if b >= 0 else 0.0, margin[c] if c >= 0 else 0.0) < _EXACT
    whole = 1.0 / (length * length)
    energy[:] = 0.0
    forward, groups = _add_energy(view, path, whole if exact else 0.5 * whole, energy)
    if exact:
        return forward, groups
    backward, of_reversed = _add_energy(view, _reversed(path), 0.5 * whole, energy)
    return forward or backward, groups if forward else of_reversed


@part
def _reversed(path: SpecularPath) -> SpecularPath:
    """The path from q to p."""
    a, b, c = path.met
    if b < 0:
        return SpecularPath(path.met, path.q, path.x, path.y, path.z, path.p)
    if c < 0:
        return SpecularPath((b, a, -1), path.q, path.y, path.x, path.x, path.p)
    return SpecularPath((c, b, a), path.q, path.z, path.y, path.x, path.p)


@part(forceinline=True)
def _cosine(planes: SpecularPlanes, a: int, x: Vec3, at: Vec3) -> float:
    """Of incidence at a place in plane `a`, from or to a point."""
    return abs(signed_distance(planes, a, x)) / max(distance(x, at), _LEAST_LEG)


@part
def _add_energy(view: View, path: SpecularPath, scale: float, energy: np.ndarray) -> tuple[bool, Met]:
    """Add `scale` of what the planes reflect of sound along a path to `energy` (b,); False if rays do not get
    through, and the groups of what reflects. Where a plane's triangles are not quite in it, rays from one end may
    and those from the other not: hence half of the energy for either direction."""
    geometry, surfaces, planes = view.geometry, view.surfaces, view.planes
    a, b, c = path.met
    first, lifted = bounce(geometry, planes, a, path.p, path.x)
    second = third = first
    if first >= 0 and b >= 0:
        second, lifted = bounce(geometry, planes, b, lifted, path.y)
    if second >= 0 and c >= 0:
        third, lifted = bounce(geometry, planes, c, lifted, path.z)
    if min(first, second, third) < 0 or not unoccluded(geometry, lifted, path.q):
        return False, (-1, -1, -1)
    cos_a = _cosine(planes, a, path.p, path.x)
    cos_b = _cosine(planes, b, path.q if c < 0 else path.x, path.y) if b >= 0 else 1.0
    cos_c = _cosine(planes, c, path.q, path.z) if c >= 0 else 1.0
    of_a = material_met(geometry, first, subtract(path.x, path.p))
    of_b = material_met(geometry, second, subtract(path.y, path.x)) if b >= 0 else of_a
    of_c = material_met(geometry, third, subtract(path.z, path.y)) if c >= 0 else of_a
    for band in range(len(energy)):
        left = specular_reflectance(surfaces, of_a, cos_a, band)
        if b >= 0:
            left *= specular_reflectance(surfaces, of_b, cos_b, band)
        if c >= 0:
            left *= specular_reflectance(surfaces, of_c, cos_c, band)
        energy[band] += scale * left
    group = surfaces.group
    return True, (group[of_a], group[of_b] if b >= 0 else -1, group[of_c] if c >= 0 else -1)


@part
def straight_path(planes: SpecularPlanes, met: Met, p: Vec3, q: Vec3) -> tuple[float, Vec3, Vec3]:
    """Length, m, of the path from p by planes to q, and the directions in which it leaves p and comes to q."""
    a, b, c = met
    image, of_q = image_of(planes, a, p), q
    if b >= 0:
        image = image_of(planes, b, image)
    if c >= 0:
        image, of_q = image_of(planes, c, image), image_of(planes, c, of_q)
    if b >= 0:
        of_q = image_of(planes, b, of_q)
    of_q = image_of(planes, a, of_q)
    length = distance(image, q)
    r = max(length, _LEAST_LEG)
    return length, divide(subtract(of_q, p), r), divide(subtract(image, q), r)
