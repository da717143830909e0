"""Early specular reflections by image sources: paths of one or two grouped planes, one arrival each.

The sequences of planes that are worth trying for a pair are those that rays from either end meet (`sequences`).
Each is solved by images (`images`), checked by rays, and stored with its exact delay and direction: its energy is
R_a(theta_a) R_b(theta_b) / (4 pi r²), r the distance from the last image. Specular subpaths leave exactly this
class of paths out, so nothing is counted twice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, row, subtract
from soundspaces_sim.echogram.echogram import MIRRORS
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry, unoccluded
from soundspaces_sim.transport.bsdf.surface import Surfaces, specular_reflectance
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.image_source.images import (
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

ORDER = 2  # longer specular paths are left to `specular`


class _Scene(NamedTuple):
    geometry: Geometry
    surfaces: Surfaces
    planes: SpecularPlanes


class _Context(NamedTuple):
    """What the kernel reads."""

    scene: _Scene
    points_a: np.ndarray  # (A, 3) m
    points_b: np.ndarray  # (B, 3) m
    keys_a: np.ndarray  # (A,) of `point_keys`: the smaller one's point is solved from
    keys_b: np.ndarray  # (B,)
    sequences_a: Sequences
    sequences_b: Sequences


class _Unfolded(NamedTuple):
    """A path from p over x on plane a, and y on plane b, or x again, to q, as the images have it."""

    ok: bool  # whether the line from the last image crosses the planes in order
    p: Vec3
    x: Vec3
    y: Vec3
    q: Vec3
    length2: float  # m², squared length


class _SpecularPath(NamedTuple):
    """A path from p over x on plane a, and y on plane b unless b is -1, to q."""

    a: int
    b: int
    p: Vec3
    x: Vec3
    y: Vec3  # x if there is no second plane
    q: Vec3
    cos_a: float  # of incidence at a
    cos_b: float


@part(forceinline=True)
def _unfold(planes: SpecularPlanes, a: int, b: int, p: Vec3, q: Vec3) -> _Unfolded:
    """The path from p by plane a, then by b unless it is -1, to q."""
    image = image_of(planes, a, p)
    if b < 0:
        last = image
        ok, x = reflection_point(planes, a, image, q)
        y = x
    else:
        last = image_of(planes, b, image)
        ok, y = reflection_point(planes, b, last, q)
        x = y
        if ok:
            ok, x = reflection_point(planes, a, image, y)
    length2 = (last[0] - q[0]) ** 2 + (last[1] - q[1]) ** 2 + (last[2] - q[2]) ** 2
    return _Unfolded(ok, p, x, y, q, length2)


@part
def _trace(scene: _Scene, a: int, b: int, path: _Unfolded, energy: np.ndarray) -> tuple[bool, FoundPath]:
    """Whether rays follow a path by plane a, then by b unless it is -1; its energies into `energy` (b,), without
    air."""
    p, x, y, q = path.p, path.x, path.y, path.q
    to_y, to_x = distance(y, q), distance(x, p)
    if to_x <= 0.0 or to_y <= 0.0:
        return False, FoundPath(0.0, p, q, (a, b), MIRRORS, (-1, -1), (-1, -1))
    cos_a, half = abs(signed_distance(scene.planes, a, p)) / to_x, 0.5 * INV_4PI / path.length2
    cos_b = abs(signed_distance(scene.planes, b, q)) / to_y if b >= 0 else 1.0
    specular = _SpecularPath(a, b, p, x, y, q, cos_a, cos_b)
    energy[:] = 0.0
    forward, groups = _add_energy(scene, specular, half, energy)
    backward, of_reversed = _add_energy(scene, _reversed(specular), half, energy)
    if not forward:
        groups = of_reversed
    at_q, at_p = divide(subtract(y, q), to_y), divide(subtract(x, p), to_x)
    length = math.sqrt(path.length2)
    return forward or backward, FoundPath(length, at_q, at_p, (a, b), MIRRORS, (-1, -1), groups)


@part
def _reversed(path: _SpecularPath) -> _SpecularPath:
    """The path from q to p."""
    if path.b < 0:
        return _SpecularPath(path.a, path.b, path.q, path.x, path.x, path.p, path.cos_a, path.cos_b)
    return _SpecularPath(path.b, path.a, path.q, path.y, path.x, path.p, path.cos_b, path.cos_a)


@part
def _add_energy(
    scene: _Scene, path: _SpecularPath, scale: float, energy: np.ndarray
) -> tuple[bool, tuple[int, int]]:
    """Add `scale` of what the planes reflect of sound along a path to `energy` (b,); False if rays do not get
    through, and the groups of what reflects. Where a plane's triangles are not quite in it, rays from one end may
    and those from the other not: hence half of the energy for either direction."""
    geometry, surfaces = scene.geometry, scene.surfaces
    none = (-1, -1)
    first, lifted = bounce(geometry, scene.planes, path.a, path.p, path.x)
    if first < 0:
        return False, none
    second = first
    if path.b >= 0:
        second, lifted = bounce(geometry, scene.planes, path.b, lifted, path.y)
        if second < 0:
            return False, none
    if not unoccluded(geometry, lifted, path.q):
        return False, none
    for band in range(len(energy)):
        left = specular_reflectance(surfaces, geometry.material[first], path.cos_a, band)
        if path.b >= 0:
            left *= specular_reflectance(surfaces, geometry.material[second], path.cos_b, band)
        energy[band] += scale * left
    of_first, of_second = (
        surfaces.group[geometry.material[first]],
        surfaces.group[geometry.material[second]],
    )
    return True, (of_first, of_second if path.b >= 0 else -1)


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


@kernel
def _specular_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, energy: np.ndarray
) -> None:
    """Early specular paths of pairs, solved from the end of the smaller key, so that both directions have the same
    bits."""
    of_a, of_b = context.sequences_a, context.sequences_b
    for k in range(first, last):
        i, j = pairs[k]
        p, q = row(context.points_a, i), row(context.points_b, j)
        swap = context.keys_a[i] > context.keys_b[j]
        for s in range(of_a.start[i + 1] - of_a.start[i] + of_b.start[j + 1] - of_b.start[j]):
            a, b = _sequence(context, i, j, s)
            if a < 0:
                continue
            c, d = (b, a) if swap and b >= 0 else (a, b)
            start, end = (q, p) if swap else (p, q)
            unfolded = _unfold(context.scene.planes, c, d, start, end)
            if not unfolded.ok:
                continue
            found, path = _trace(context.scene, c, d, unfolded, energy)
            if not found:
                continue
            at_b, at_a = (path.at_a, path.at_b) if swap else (path.at_b, path.at_a)
            path = FoundPath(path.length, at_b, at_a, (a, b), MIRRORS, (-1, -1), path.groups)
            store(slots, k, path, energy)


def connect(tile: Tile) -> PathTable | None:
    """Early specular paths of every pair."""
    world, a, b = tile.model.world, tile.a.ends, tile.b.ends
    planes = tile.model.prepared.part(prepare_planes)
    context = _Context(
        scene=_Scene(world.geometry, world.surfaces, planes),
        points_a=a.points,
        points_b=b.points,
        keys_a=a.keys,
        keys_b=b.keys,
        sequences_a=tile.a.once(plane_sequences),
        sequences_b=tile.b.once(plane_sequences),
    )
    bands = world.air.shape[1]
    pairs = tile.pairs if len(planes.offset) else np.empty((0, 2), np.int64)
    return for_each_pair(tile, _specular_paths, context, pairs, lambda: np.empty(bands))
