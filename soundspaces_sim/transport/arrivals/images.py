"""Image sources: geometry of paths by specular planes (Allen & Berkley 1979, Image method for efficiently
simulating small-room acoustics, JASA 65 (4); for planes in any position Borish 1984, JASA 75 (6)).

The image of a source behind a plane is the source reflected in it; the path by the plane is the straight line from
the image. Rays check that the surface is there and that nothing is in the way.

Early reflections meet one or two grouped planes, or go there and back: a second plane between two reflections by
the first, as sound between a floor and a table top does. Specular subpaths leave exactly this class of paths out,
so nothing is counted twice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import (
    Vec3,
    along,
    cross,
    distance,
    divide,
    dot,
    length,
    normalize,
    row,
    subtract,
)
from soundspaces_sim.scene.rays.geometry import (
    Geometry,
    cast_ray,
    material_met,
    surface_point,
    unoccluded,
)
from soundspaces_sim.transport.arrivals.specular_planes import THERE, Cover, SpecularPlanes, cover_at
from soundspaces_sim.transport.bsdf.surface import Surfaces, attenuate_specular, specular_reflectance

_PARALLEL = 0.1  # sine of an angle: less is none
_COSINES = 16  # of angles of incidence
_BESIDE = 3.0  # of how far rays start off a surface


@part
def signed_distance(planes: SpecularPlanes, a: int, x: Vec3) -> float:
    """Of a point from plane `a`, m, positive on the side of its normal."""
    return dot(row(planes.normal, a), x) - planes.offset[a]


@part
def image_of(planes: SpecularPlanes, a: int, x: Vec3) -> Vec3:
    """A point reflected in plane `a`."""
    k = 2.0 * signed_distance(planes, a, x)
    n = row(planes.normal, a)
    return x[0] - k * n[0], x[1] - k * n[1], x[2] - k * n[2]


@part
def reflection_point(planes: SpecularPlanes, a: int, image: Vec3, q: Vec3) -> tuple[bool, Vec3]:
    """Where the line from an image behind plane `a` to q goes through the plane; whether it does."""
    s_image, s_q = -signed_distance(planes, a, image), signed_distance(planes, a, q)
    if s_image * s_q <= 0.0:  # the image lies on the far side, so equal signs mean the same side
        return False, (0.0, 0.0, 0.0)
    t = s_image / (s_image + s_q)
    return True, along(image, t, subtract(q, image))


@part
def beside_edge(
    geometry: Geometry, planes: SpecularPlanes, met: tuple[int, int], p: Vec3, q: Vec3
) -> Vec3:
    """q, or a place beside it where the path from p by two planes to q meets the edge between them.

    At a right-angled edge both orders have one image and one path: rounding would tell whether it is there once,
    twice, or not at all, as from a place to itself. To a place beside q it is by one of both orders.
    """
    a, b = met
    image = image_of(planes, b, image_of(planes, a, p))
    ok, y = reflection_point(planes, b, image, q)
    edge = cross(row(planes.normal, min(a, b)), row(planes.normal, max(a, b)))
    least = geometry.epsilon + max(planes.margin[a], planes.margin[b])
    if not ok or length(edge) < _PARALLEL or min(distance(y, p), distance(y, q)) <= least:
        return q
    along_path = normalize(subtract(q, image))
    aside = cross(along_path, edge)
    off = signed_distance(planes, a, y) * dot(row(planes.normal, b), along_path)
    if abs(off) > least or length(aside) < _PARALLEL * length(edge):
        return q
    return along(q, _BESIDE * least, normalize(aside))


@part
def bounce(
    geometry: Geometry, planes: SpecularPlanes, a: int, origin: Vec3, target: Vec3
) -> tuple[int, Vec3]:
    """(Triangle, point lifted off the plane) where a ray to a reflection point meets plane `a`; the triangle is
    -1 if it meets something else first."""
    direction = subtract(target, origin)
    r = length(direction)
    if r <= 0.0:
        return -1, target
    direction = divide(direction, r)
    t, triangle = cast_ray(geometry, origin, direction, math.inf)
    if triangle < 0 or geometry.plane[triangle] != a:
        return -1, target
    x, n = surface_point(geometry, triangle, origin, direction, t)
    return triangle, along(x, geometry.epsilon + planes.margin[a], n)


class View(NamedTuple):
    """What rays meet, and the planes that reflect."""

    geometry: Geometry
    surfaces: Surfaces
    planes: SpecularPlanes
    boxes: np.ndarray  # (P, 2, 3) m, bounds of each plane's triangles
    cover: Cover
    reflects: np.ndarray  # (P, b) most energy that a plane reflects at any angle
    large: np.ndarray  # (P,) planes in which points have images


class End(NamedTuple):
    """`at`: where sound seems to come from; `point`: the point itself; `plane` that reflects it, -1 for none."""

    at: Vec3
    point: Vec3
    plane: int


@part(forceinline=True)
def end_at(view: View, plane: int, p: Vec3) -> End:
    """A point, or its image in a plane."""
    return End(image_of(view.planes, plane, p) if plane >= 0 else p, p, plane)


@part
def sees_by_plane(view: View, end: End, target: Vec3) -> tuple[int, Vec3]:
    """(Triangle by which a point, whose image is given, sees a place; the place of reflection); the triangle is -1
    if it does not."""
    ok, x = reflection_point(view.planes, end.plane, end.at, target)
    if not ok or cover_at(view.cover, end.plane, x) < THERE:
        return -1, x
    triangle, lifted = bounce(view.geometry, view.planes, end.plane, end.point, x)
    if triangle < 0 or not unoccluded(view.geometry, lifted, target):
        return -1, x
    return triangle, x


class Leg(NamedTuple):
    """How sound gets from an end to a place."""

    free: bool
    towards: Vec3  # where it goes first
    triangle: int  # by which, -1 for none


@part
def leg_to(view: View, end: End, target: Vec3) -> Leg:
    """From an end to a place."""
    if end.plane < 0:
        return Leg(unoccluded(view.geometry, end.point, target), target, -1)
    triangle, x = sees_by_plane(view, end, target)
    return Leg(triangle >= 0, x, triangle)


@part
def moved_to(view: View, end: End, leg: Leg, target: Vec3) -> Leg:
    """A leg to a place beside the one to which rays have found it free."""
    if end.plane < 0:
        return Leg(leg.free, target, leg.triangle)
    found, x = reflection_point(view.planes, end.plane, end.at, target)
    return Leg(leg.free, x if found else leg.towards, leg.triangle)


@part
def reflected(view: View, end: End, leg: Leg, energy: np.ndarray) -> tuple[Vec3, int]:
    """(Unit vector in which sound leaves an end, group of what reflects it), after what that takes from energies
    (b,)."""
    along, group = subtract(leg.towards, end.point), -1
    if end.plane >= 0:
        material = material_met(view.geometry, leg.triangle, along)
        cos = min(abs(signed_distance(view.planes, end.plane, end.point)) / length(along), 1.0)
        attenuate_specular(view.surfaces, material, cos, energy)
        group = view.surfaces.group[material]
    return divide(along, length(along)), group


@kernel
def _most_of_material(first: int, last: int, surfaces: Surfaces, most: np.ndarray) -> None:
    """Fill rows (m, b) of the most that each row of Surfaces reflects."""
    for m in range(first, last):
        for b in range(most.shape[1]):
            most[m, b] = 0.0
            for step in range(1, _COSINES + 1):
                most[m, b] = max(most[m, b], specular_reflectance(surfaces, m, step / _COSINES, b))


def most_reflected(surfaces: Surfaces, geometry: Geometry, planes: int, bands: int) -> np.ndarray:
    """(P, b) most energy that any triangle of each plane reflects, of its angles of incidence."""
    used = geometry.plane >= 0
    rows, out = np.unique(geometry.material[used]), np.zeros((planes, bands))
    of_row = np.zeros((int(rows.max(initial=0)) + 1, bands))
    for m in rows:
        _most_of_material(m, m + 1, surfaces, of_row)
    for side in range(2):
        np.maximum.at(out, geometry.plane[used], of_row[geometry.material[used, side]])
    return out


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
