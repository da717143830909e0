"""Small holes in a mesh are closed, as scanners leave them: triangles that are missing from a surface.

Sound leaks through a hole: where a hundredth of a wall is missing, what arrives behind it first has come through
there, and not through the door. A hole is a loop of edges that belong to one triangle each, with the surface
outside of the loop; about a sheet it is inside. Openings that people make are larger.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.rows import in_order
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.triangles import areas, lone_sides, weld

_AROUND = 0.6  # m, around a hole that is closed: 20 cm of three sides, where openings that people make have more
_SIDES = 12  # of such a hole at most
_STEPS = 4000  # by which loops through a side are searched
_ACROSS = 0.3  # cosine to the way to the loop's middle, up to which a surface turns there at an edge
_WELD = 5  # decimals of a metre


class _Rim(NamedTuple):
    """E sides that one triangle has each, between P points."""

    ends: np.ndarray  # (E, 2) points, in the order of the triangle
    face: np.ndarray  # (E,)
    length: np.ndarray  # (E,) m
    middle: np.ndarray  # (E, 3) m
    inward: np.ndarray  # (E, 3) from the side to the triangle's third corner
    start: np.ndarray  # (P + 1,) of each point's entries below
    side: np.ndarray  # (2 E,) sides of a point
    other: np.ndarray  # (2 E,) their other ends


class _Work(NamedTuple):
    """The path at hand, from the side that it began with."""

    node: np.ndarray  # (_SIDES,) points
    via: np.ndarray  # (_SIDES,) sides by which they were reached
    at: np.ndarray  # (_SIDES,) next entry of each
    total: np.ndarray  # (_SIDES,) m
    best: np.ndarray  # (_SIDES,) sides of the shortest loop


def close_holes(mesh: LabelledMesh) -> LabelledMesh:
    """The mesh, in metres, with its small holes closed by triangles after its own, labelled as one around, and a
    note that says so."""
    points, row = weld(mesh.vertices, _WELD)
    faces = row[mesh.faces]
    rim = _rim(points, faces)
    count, loops = 0, np.full((len(rim.face) // 3, _SIDES), -1)
    if len(loops) > 0:
        node, via, at, best = np.empty((4, _SIDES), np.int64)
        work = _Work(node, via, at, np.empty(_SIDES), best)
        count = _find_loops(rim, np.zeros(len(rim.face), np.bool_), loops, work)
    if count == 0:
        return mesh
    loops = loops[:count]
    sides = (loops >= 0).sum(axis=1)
    of_loop = np.repeat(np.arange(count), sides)
    side = loops[loops >= 0]
    around, first = rim.ends[side], np.cumsum(sides) - sides
    middle = np.stack([np.bincount(of_loop, x) for x in rim.middle[side].T], axis=1) / sides[:, None]
    # A triangle about three sides, about more of them one from each to the middle.
    three = sides == 3
    far = np.cumsum(~three) - 1 - np.count_nonzero(~three)  # from the end
    each = np.column_stack([around[:, 1], around[:, 0], far[of_loop]])[~three[of_loop]]
    ends = around[first[three]]
    second = around[first[three] + 1]
    third = np.where((second == ends[:, :1]) | (second == ends[:, 1:]), -1, second).max(axis=1)
    new = np.concatenate([np.column_stack([ends[:, 1], ends[:, 0], third]), each])
    own = np.empty(len(points), np.int64)  # a vertex of each point
    own[row] = np.arange(len(row))
    vertices = np.concatenate([mesh.vertices, middle[~three]])
    new = np.where(new >= 0, own[new], len(vertices) + new)
    label = mesh.face_label[rim.face[side]]
    labels = np.concatenate([label[first[three]], label[~three[of_loop]]])
    area = float(areas(vertices[new]).sum())
    note = f"{count:,} holes of up to {_AROUND:g} m around, {area:.2g} m² in all, were closed"
    return replace(
        mesh,
        vertices=vertices,
        faces=np.concatenate([mesh.faces, new]),
        face_label=np.concatenate([mesh.face_label, labels]),
        notes=(*mesh.notes, note),
    )


def _rim(points: np.ndarray, faces: np.ndarray) -> _Rim:
    face, corner = np.divmod(np.flatnonzero(lone_sides(faces, len(points))), 3)
    ends = np.stack([faces[face, corner], faces[face, (corner + 1) % 3]], axis=1)
    a, b = points[ends[:, 0]], points[ends[:, 1]]
    inward = points[faces[face, (corner + 2) % 3]] - 0.5 * (a + b)
    point = ends.T.ravel()
    order = in_order(point)[1]
    start = np.concatenate([[0], np.cumsum(np.bincount(point, minlength=len(points)))])
    side, other = order % max(len(ends), 1), ends[:, ::-1].T.ravel()[order]
    length = np.linalg.norm(b - a, axis=1)
    return _Rim(ends, face, length, 0.5 * (a + b), inward, start, side, other)


@part
def _shortest(rim: _Rim, e: int, used: np.ndarray, work: _Work) -> int:
    """The shortest loop through a side into `work.best`: how many sides it has, 0 if there is none."""
    begin, depth, found, steps, shortest = rim.ends[e, 0], 0, 0, 0, _AROUND
    work.node[0], work.via[0], work.total[0] = rim.ends[e, 1], e, rim.length[e]
    work.at[0] = rim.start[work.node[0]]
    while depth >= 0:
        k = work.at[depth]
        if k == rim.start[work.node[depth] + 1] or steps == _STEPS:
            depth -= 1
            continue
        work.at[depth], steps = k + 1, steps + 1
        side, point = rim.side[k], rim.other[k]
        total = work.total[depth] + rim.length[side]
        if used[side] or side == work.via[depth] or not total <= shortest:
            continue
        if point == begin:
            if side != e and total < shortest:
                found, shortest = depth + 2, total
                for n in range(depth + 1):
                    work.best[n] = work.via[n]
                work.best[depth + 1] = side
            continue
        known = depth + 2 >= _SIDES
        for n in range(depth + 1):
            known |= work.node[n] == point
        if not known:
            depth += 1
            work.node[depth], work.via[depth], work.total[depth] = point, side, total
            work.at[depth] = rim.start[point]
    return found


@part
def _is_hole(rim: _Rim, sides: int, loop: np.ndarray) -> bool:
    """Whether the surface is outside of a loop: from a third of its sides or more it goes away from the middle, at
    others it may turn, as at an edge, and it goes inwards from half as many at most, as where a loop is bent."""
    x = y = z = 0.0
    for k in range(sides):
        x += rim.middle[loop[k], 0] / sides
        y += rim.middle[loop[k], 1] / sides
        z += rim.middle[loop[k], 2] / sides
    away = inwards = 0
    for k in range(sides):
        m, d = rim.middle[loop[k]], rim.inward[loop[k]]
        across = (x - m[0]) * d[0] + (y - m[1]) * d[1] + (z - m[2]) * d[2]
        size = math.sqrt((x - m[0]) ** 2 + (y - m[1]) ** 2 + (z - m[2]) ** 2)
        size *= math.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
        away += across < -_ACROSS * size
        inwards += across > _ACROSS * size
    return 3 * away >= sides and 2 * inwards <= away


@kernel
def _find_loops(rim: _Rim, used: np.ndarray, loops: np.ndarray, work: _Work) -> int:
    """The sides of holes into rows of `loops`, and how many there are: through each side that is in none yet, the
    shortest loop."""
    count = 0
    for e in range(len(rim.face)):
        if used[e]:
            continue
        sides = _shortest(rim, e, used, work)
        if sides < 3 or not _is_hole(rim, sides, work.best):
            continue
        for k in range(sides):
            loops[count, k] = work.best[k]
            used[work.best[k]] = True
        count += 1
    return count
