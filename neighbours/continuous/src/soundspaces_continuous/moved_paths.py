"""Discrete paths to points, moved to places between these, and dropped where a wall is in the way.

A path is known by its last stretch. Sound reaches a listener from `target`: the source itself, or the point of an
edge that it came round; over up to two mirrors, in order from the listener. The mirrored target is what the
listener hears, and moves with nobody but the source: so for another listener the length, the direction and the
points of reflection follow by images (Allen & Berkley 1979; Borish 1984), and rays tell whether the mirrors are
there and nothing is in between. `rest`: length from the source to the target, which stays.

Energy goes as 1 / length² for mirrors. A wedge at distance a from the listener and b along the path from the source
diffracts 1 / (a (a + b)) (Kouyoumjian & Pathak 1974); the angle in its coefficient stays that of the point
simulated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim import Echogram, SimulationConfig
from soundspaces_sim.parts import (
    KIND_EDGE as EDGE,
    KIND_EDGE_MIRROR as EDGE_MIRROR,
    KIND_MIRRORS as MIRRORS,
    KIND_MIRRORS_AND_BACK as MIRRORS_AND_BACK,
    LEAST_DISTANCE,
    Geometry,
    SpecularPlanes,
    Vec3,
    Wedges,
    air_transmission,
    beside_edge,
    dot_product as dot,
    image_of,
    kernel,
    kernel_part as part,
    mirror_bounce as bounce,
    point_distance as distance,
    reflection_point,
    subtract_vectors as subtract,
    unoccluded,
    vector_length as length,
    vector_row as row,
)

DIRECT, THROUGH_WALLS = -1, -2  # kinds of path beside `echogram.KINDS`
_SQUARE = 1e-6  # cosine


class Paths(NamedTuple):
    """n paths from a source to a point, relative to the scene's centre."""

    kind: np.ndarray  # (n,) row of `echogram.KINDS`, or DIRECT, THROUGH_WALLS
    mirrors: np.ndarray  # (n, 2) planes in order from the listener, -1 for none
    target: np.ndarray  # (n, 3) m
    clear: np.ndarray  # (n, 3) m, the target, or beside its edge where rays just clear that
    in_sight: np.ndarray  # (n,) whether the point sees the source
    rest: np.ndarray  # (n,) m
    name: np.ndarray  # (n, 5) kind, planes and edges from the source on: paths of one name are one
    energy: np.ndarray  # (n, b) at the point
    length: np.ndarray  # (n,) m, at the point
    scale: np.ndarray  # (n,) m, to which the amplitude is inverse, at the point


class Surroundings(NamedTuple):
    """What paths are mirrored and cut by."""

    geometry: Geometry  # its `plane` tells which mirror a triangle belongs to
    planes: SpecularPlanes
    wedges: Wedges
    least: float  # m, below which levels stay


class Moved(NamedTuple):
    """Room for n paths that reach a listener."""

    row: np.ndarray  # (n,) of the paths that were moved
    name: np.ndarray  # (n, 5)
    gain: np.ndarray  # (n,) amplitude relative to that at the point
    length: np.ndarray  # (n,) m
    direction: np.ndarray  # (n, 3) unit, from the listener
    further: np.ndarray  # (n,) m, than at the point: so much more air


def make_moved(n: int) -> Moved:
    """Room for n paths."""
    whole = np.zeros(n, np.int64), np.zeros((n, 5), np.int64)
    return Moved(*whole, np.empty(n), np.empty(n), np.empty((n, 3)), np.empty(n))


def paths_of(
    echogram: Echogram,
    source: np.ndarray,
    point: np.ndarray,
    around: Surroundings,
    config: SimulationConfig,
) -> Paths:
    """The discrete paths of an echogram from `source` to `point`, (3,) m from the scene's centre. Where walls are
    between them, also the straight one, which places around the point may have."""
    early, direct, speed_of_sound = echogram.early, echogram.direct, config.c
    n = len(early) + (direct is not None) + (not echogram.visible)
    out = Paths(
        np.empty(n, np.int64), np.full((n, 2), -1), np.empty((n, 3)), np.empty((n, 3)),
        np.full(n, echogram.visible), np.zeros(n),
        np.full((n, 5), -1), np.empty((n, len(echogram.bands) - 1)), np.empty(n), np.empty(n),
    )  # fmt: skip
    out.target[:] = out.clear[:] = source
    m = len(early)
    if direct is not None:
        out.kind[m] = DIRECT if echogram.visible else THROUGH_WALLS
        out.energy[m], out.length[m] = direct.energy, direct.delay * speed_of_sound
    if not echogram.visible:
        apart = max(float(np.linalg.norm(source - point)), LEAST_DISTANCE)
        out.kind[-1], out.length[-1] = DIRECT, apart
        out.energy[-1] = air_transmission(config, np.array([apart]))[0] / (4.0 * math.pi * apart**2)
    out.kind[:m], out.energy[:m] = early.kind, early.energy
    out.length[:m] = early.delay * speed_of_sound
    planes, edges = _packed_left(early.planes), _packed_left(early.edges)
    back, mirrored = early.kind == MIRRORS_AND_BACK, early.kind == MIRRORS
    out.mirrors[:m][back] = planes[back]
    out.mirrors[:m][mirrored] = _packed_left(planes[mirrored, ::-1])
    own = np.flatnonzero(early.kind == EDGE_MIRROR)
    out.mirrors[own, 0] = planes[own, 0]
    own = np.flatnonzero(~(back | mirrored))
    edge, mirror = np.where(edges[own, 1] >= 0, edges[own, 1], edges[own, 0]), out.mirrors[own, 0]
    apex = _apexes(around, edge, mirror, point, early.direction[own])
    out.target[own], out.clear[own] = apex, apex + around.wedges.offset[edge]
    seen = np.linalg.norm(_mirrored(around.planes, mirror, apex) - point, axis=1)
    out.rest[own] = np.maximum(out.length[own] - seen, 0.0)
    out.name[:, 0] = out.kind
    out.name[:m, 1:3], out.name[:m, 3:5] = early.planes, early.edges
    two = np.flatnonzero((out.mirrors[:, 1] >= 0) & (out.kind == MIRRORS))
    first, second = around.planes.normal[out.mirrors[two].T]
    two = two[np.abs(_dots(first, second)) < _SQUARE]
    out.name[two, 1:3] = np.sort(out.name[two, 1:3], axis=1)
    last = np.maximum(out.length - out.rest, around.least)
    out.scale[:] = np.sqrt(last * np.maximum(out.length, around.least))
    return _merged(out)


def _merged(paths: Paths) -> Paths:
    """Paths of the same name as one: by two planes at right angles, either first, where source and point are both
    in the plane halfway between them."""
    if len(set(map(tuple, paths.name.tolist()))) == len(paths.name):
        return paths
    _, first, row = np.unique(paths.name, axis=0, return_index=True, return_inverse=True)
    energy = np.zeros((len(first), paths.energy.shape[1]))
    np.add.at(energy, row.ravel(), paths.energy)
    order = np.argsort(first)
    kept = Paths(*(np.ascontiguousarray(column[first[order]]) for column in paths))
    return kept._replace(energy=energy[order])


def _packed_left(rows: np.ndarray) -> np.ndarray:
    """(n, 2) numbers, -1 for none, of which none comes before another."""
    return np.where(rows[:, :1] >= 0, rows, np.stack([rows[:, 1], np.full(len(rows), -1)], axis=1))


def _dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n,) products of vectors (n, 3)."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _mirrored(planes: SpecularPlanes, plane: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Points (n, 3), or their images in planes (n,); -1: in none."""
    n = planes.normal[plane]
    far = np.where(plane >= 0, _dots(x, n) - planes.offset[plane], 0.0)
    return np.asarray(x - 2.0 * far[:, None] * n)


def _apexes(
    around: Surroundings, edge: np.ndarray, mirror: np.ndarray, point: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """(n, 3) points of edges (n,), seen in mirrors or without one (-1), that lie in directions (n, 3) from a
    point."""
    wedges, n = around.wedges, around.planes.normal[mirror]
    line = wedges.along[edge]
    start = _mirrored(around.planes, mirror, wedges.start[edge])
    turned = np.where(mirror >= 0, _dots(line, n), 0.0)
    seen = line - 2.0 * turned[:, None] * n
    offset, slant = start - point, _dots(seen, direction)
    # Of the points start + z line, those nearest to the rays from the point.
    z = (slant * _dots(offset, direction) - _dots(offset, seen)) / np.maximum(1.0 - slant * slant, 1e-12)
    z = np.clip(z, 0.0, wedges.length[edge])
    return np.asarray(wedges.start[edge] + z[:, None] * line)


@part
def are_square(planes: SpecularPlanes, a: int, b: int) -> bool:
    """Whether planes are at right angles: then both orders of reflection have one image."""
    return abs(dot(row(planes.normal, a), row(planes.normal, b))) < _SQUARE


@part
def _reaches(
    around: Surroundings, listener: Vec3, target: Vec3, mirrors: tuple[int, int], back: bool
) -> tuple[bool, Vec3]:
    """Whether rays get from a listener over mirrors, and then `back` over the first, to a target that is in the
    open; the target's image."""
    a, b = mirrors
    given, two = target, b >= 0 and not back
    if two:
        target = beside_edge(around.geometry, around.planes, mirrors, listener, given)
    first = image_of(around.planes, a, target) if back else target
    inner = image_of(around.planes, b, first) if b >= 0 else first
    image = image_of(around.planes, a, inner) if a >= 0 else inner
    ok, here, x = True, listener, listener
    if a >= 0:
        ok, here, x = _over(around, a, image, here, x)
    if ok and b >= 0:
        ok, here, x = _over(around, b, inner, here, x)
    if ok and back:
        ok, here, x = _over(around, a, first, here, x)
    ok = ok and unoccluded(around.geometry, here, target)
    return ok, image_of(around.planes, a, image_of(around.planes, b, given)) if two else image


@part
def _over(around: Surroundings, a: int, image: Vec3, here: Vec3, x: Vec3) -> tuple[bool, Vec3, Vec3]:
    """Whether a ray from `here`, which is `x` lifted off its plane, meets plane a on its way to an image; where it
    goes on, and the point of reflection."""
    found, at = reflection_point(around.planes, a, image, x)
    if not found:
        return False, here, x
    triangle, lifted = bounce(around.geometry, around.planes, a, here, at)
    return triangle >= 0, lifted, at


@part
def _is_named(names: np.ndarray, count: int, own: np.ndarray, i: int) -> bool:
    """Whether one of the first `count` of `names` (n, 5) is that of row `i` of `own` (k, 5)."""
    for k in range(count):
        same = True
        for j in range(5):
            same = same and names[k, j] == own[i, j]
        if same:
            return True
    return False


@kernel
def move_paths(
    around: Surroundings,
    paths: Paths,
    source: np.ndarray,
    listener: np.ndarray,
    out: Moved,
    count: int,
) -> int:
    """Add to the first `count` of `out` those paths from `source` (3,) that reach `listener` (3,), from the scene's
    centre, and whose names are not there yet. How many there are then."""
    s, p = (source[0], source[1], source[2]), (listener[0], listener[1], listener[2])
    in_sight = unoccluded(around.geometry, s, p)
    before = count
    for i in range(len(paths.kind)):
        if _is_named(out.name, before, paths.name, i):
            continue
        kind = paths.kind[i]
        mirrors = paths.mirrors[i, 0], paths.mirrors[i, 1]
        target, rest = row(paths.target, i), paths.rest[i]
        image = s
        if kind == DIRECT:
            ok = in_sight
        elif kind == THROUGH_WALLS:
            ok = not in_sight
        elif kind == MIRRORS_AND_BACK:
            ok, image = _reaches(around, p, s, mirrors, True)
            if not ok:
                ok, _ = _reaches(around, s, p, mirrors, True)
        elif kind == MIRRORS:
            ok, image = _reaches(around, p, s, mirrors, False)
            other = (mirrors[1], mirrors[0]) if mirrors[1] >= 0 else mirrors
            if not ok and mirrors[1] >= 0 and are_square(around.planes, mirrors[0], mirrors[1]):
                ok, image = _reaches(around, p, s, other, False)
            if not ok:  # planes that are not quite flat may let rays through one way alone
                ok, _ = _reaches(around, s, p, other, False)
        else:
            clear = row(paths.clear, i)
            ok, _ = _reaches(around, p, clear, mirrors, False)
            image = image_of(around.planes, mirrors[0], target) if mirrors[0] >= 0 else target
            if kind == EDGE:
                # Out of sight it is the sound that comes round an edge, in sight what a reflector's edge adds.
                rest = distance(s, target)
                ok = ok and in_sight == paths.in_sight[i] and unoccluded(around.geometry, s, clear)
        if not ok:
            continue
        offset = subtract(image, p)
        own = length(offset)
        scale = math.sqrt(max(own, around.least) * max(own + rest, around.least))
        out.row[count], out.gain[count] = i, paths.scale[i] / scale
        out.length[count], out.further[count] = own + rest, own + rest - paths.length[i]
        for axis in range(3):
            out.direction[count, axis] = offset[axis] / own if own > 0.0 else 0.0
        for part_of in range(5):
            out.name[count, part_of] = paths.name[i, part_of]
        count += 1
    return count
