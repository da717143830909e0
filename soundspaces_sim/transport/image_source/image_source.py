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

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, row, subtract
from soundspaces_sim.echogram.echogram import MIRRORS, MIRRORS_AND_BACK
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry, material_met, unoccluded
from soundspaces_sim.transport.bsdf.surface import Surfaces, specular_reflectance
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.image_source.images import (
    beside_edge,
    bounce,
    image_of,
    reflection_point,
    signed_distance,
)
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.sequences import Sequences, plane_sequences
from soundspaces_sim.transport.image_source.specular_planes import SpecularPlanes
from soundspaces_sim.transport.path_table import FoundPath, PathSlots, PathTable, store
from soundspaces_sim.transport.tile import Tile

ORDER = 2  # planes on a path; longer specular paths but for those there and back are left to `specular`
_LEAST_LEG = 1e-12  # m


class _Scene(NamedTuple):
    geometry: Geometry
    surfaces: Surfaces
    planes: SpecularPlanes


class _Context(NamedTuple):
    """What the kernel reads."""

    scene: _Scene
    points_a: np.ndarray  # (A, 3) m
    points_b: np.ndarray  # (B, 3) m
    given_a: np.ndarray  # (A, 3) m, before they were brought into general position
    given_b: np.ndarray  # (B, 3) m
    keys_a: np.ndarray  # (A,) of `point_keys`: the smaller one's point is solved from
    keys_b: np.ndarray  # (B,)
    sequences_a: Sequences
    sequences_b: Sequences


@part(forceinline=True)
def by_images(reflections: int, back: bool) -> bool:
    """Whether image sources make a path that planes alone have mirrored so often; `back`: by the first one again
    after the second."""
    return reflections <= ORDER or back


Met = tuple[int, int, int]  # planes that a path meets in order, -1 for none


class _SpecularPath(NamedTuple):
    """A path from p by up to three planes to q. Where there are fewer, the last place counts for those missing."""

    met: Met
    p: Vec3
    x: Vec3
    y: Vec3
    z: Vec3
    q: Vec3


@part(forceinline=True)
def _last(path: _SpecularPath) -> Vec3:
    return path.x if path.met[1] < 0 else (path.y if path.met[2] < 0 else path.z)


@part(forceinline=True)
def _unfold(planes: SpecularPlanes, met: Met, p: Vec3, q: Vec3) -> tuple[bool, _SpecularPath]:
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
    return ok, _SpecularPath(met, p, x, y, z, q)


@part
def _trace(scene: _Scene, path: _SpecularPath, length: float, energy: np.ndarray) -> tuple[bool, Met]:
    """(Whether rays follow a path, the groups of what reflects); its energies over a length, m, into `energy` (b,),
    without air."""
    if length <= 0.0 or distance(path.x, path.p) <= 0.0 or distance(_last(path), path.q) <= 0.0:
        return False, (-1, -1, -1)
    half = 0.5 * INV_4PI / (length * length)
    energy[:] = 0.0
    forward, groups = _add_energy(scene, path, half, energy)
    backward, of_reversed = _add_energy(scene, _reversed(path), half, energy)
    return forward or backward, groups if forward else of_reversed


@part
def _reversed(path: _SpecularPath) -> _SpecularPath:
    """The path from q to p."""
    a, b, c = path.met
    if b < 0:
        return _SpecularPath(path.met, path.q, path.x, path.y, path.z, path.p)
    if c < 0:
        return _SpecularPath((b, a, -1), path.q, path.y, path.x, path.x, path.p)
    return _SpecularPath((c, b, a), path.q, path.z, path.y, path.x, path.p)


@part(forceinline=True)
def _cosine(planes: SpecularPlanes, a: int, x: Vec3, at: Vec3) -> float:
    """Of incidence at a place in plane `a`, from or to a point."""
    return abs(signed_distance(planes, a, x)) / max(distance(x, at), _LEAST_LEG)


@part
def _add_energy(
    scene: _Scene, path: _SpecularPath, scale: float, energy: np.ndarray
) -> tuple[bool, Met]:
    """Add `scale` of what the planes reflect of sound along a path to `energy` (b,); False if rays do not get
    through, and the groups of what reflects. Where a plane's triangles are not quite in it, rays from one end may
    and those from the other not: hence half of the energy for either direction."""
    geometry, surfaces, planes = scene.geometry, scene.surfaces, scene.planes
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
def _straight(planes: SpecularPlanes, met: Met, p: Vec3, q: Vec3) -> tuple[float, Vec3, Vec3]:
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


@part(forceinline=True)
def _sequence(context: _Context, i: int, j: int, s: int) -> tuple[int, int]:
    """Sequence `s` of a pair, in order from a, (plane, plane or -1): those that a's rays meet, then those that b's
    rays meet; (-1, -1) if a's have met it."""
    of_a, of_b = context.sequences_a, context.sequences_b
    own = of_a.start[i + 1] - of_a.start[i]
    if s < own:
        n = of_a.start[i] + s
        return of_a.planes[n, 0], of_a.planes[n, 1]
    n = of_b.start[j] + s - own
    one, two = of_b.planes[n, 0], of_b.planes[n, 1]
    a, b = (one, two) if two < 0 else (two, one)
    if of_a.seen[i, a, b if b >= 0 else of_a.seen.shape[1]]:
        a, b = -1, -1
    return a, b


@part(forceinline=True)
def _there_and_back(context: _Context, i: int, j: int, s: int) -> tuple[int, int]:
    """The planes of sequence `s` of a pair, by which a path comes to the first, the second and the first again;
    (-1, -1) for one plane, or if a's rays have met the sequence before."""
    of_a, of_b = context.sequences_a, context.sequences_b
    own = of_a.start[i + 1] - of_a.start[i]
    if s < own:
        n = of_a.start[i] + s
        a, b = of_a.planes[n, 0], of_a.planes[n, 1]
        return (a, b) if b >= 0 else (-1, -1)
    n = of_b.start[j] + s - own
    a, b = of_b.planes[n, 0], of_b.planes[n, 1]
    return (-1, -1) if b < 0 or of_a.seen[i, a, b] else (a, b)


@part
def _solve(context: _Context, i: int, j: int, met: Met, energy: np.ndarray) -> tuple[bool, FoundPath]:
    """The path between point i of side a and j of side b by planes in order from a, solved from that of the smaller
    key."""
    swap = context.keys_a[i] > context.keys_b[j]
    a, b, c = met
    if swap and c < 0 <= b:
        a, b = b, a
    ends = row(context.points_a, i), row(context.points_b, j)
    given = row(context.given_a, i), row(context.given_b, j)
    if swap:
        ends, given = (ends[1], ends[0]), (given[1], given[0])
    planes = context.scene.planes
    end = beside_edge(context.scene.geometry, planes, (a, b), *ends) if c < 0 <= b else ends[1]
    found, unfolded = _unfold(planes, (a, b, c), ends[0], end)
    groups, length, at_p, at_q = (-1, -1, -1), 0.0, ends[0], ends[1]
    if found:
        length, at_p, at_q = _straight(planes, (a, b, c), *given)
        found, groups = _trace(context.scene, unfolded, length, energy)
    at_b, at_a = (at_p, at_q) if swap else (at_q, at_p)
    kind = MIRRORS_AND_BACK if c >= 0 else MIRRORS
    return found, FoundPath(length, at_b, at_a, (met[0], met[1]), kind, (-1, -1), groups)


@kernel
def _specular_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, energy: np.ndarray
) -> None:
    """Early specular paths of pairs, solved from the end of the smaller key, so that both directions have the same
    bits."""
    of_a, of_b = context.sequences_a, context.sequences_b
    for k in range(first, last):
        i, j = pairs[k]
        for s in range(of_a.start[i + 1] - of_a.start[i] + of_b.start[j + 1] - of_b.start[j]):
            a, b = _sequence(context, i, j, s)
            if a >= 0:
                found, path = _solve(context, i, j, (a, b, -1), energy)
                if found:
                    store(slots, k, path, energy)
            a, b = _there_and_back(context, i, j, s)
            if a >= 0:
                found, path = _solve(context, i, j, (a, b, a), energy)
                if found:
                    store(slots, k, path, energy)


def connect(tile: Tile) -> PathTable | None:
    """Early specular paths of every pair."""
    world, a, b = tile.model.world, tile.a.ends, tile.b.ends
    planes = tile.model.prepared.part(prepare_planes)
    context = _Context(
        scene=_Scene(world.geometry, world.surfaces, planes),
        points_a=a.points,
        points_b=b.points,
        given_a=tile.a.given - tile.model.scene.center,
        given_b=tile.b.given - tile.model.scene.center,
        keys_a=a.keys,
        keys_b=b.keys,
        sequences_a=tile.a.once(plane_sequences),
        sequences_b=tile.b.once(plane_sequences),
    )
    bands = world.air.shape[1]
    pairs = tile.pairs if len(planes.offset) else np.empty((0, 2), np.int64)
    return for_each_pair(tile, _specular_paths, context, pairs, lambda: np.empty(bands))
