"""A synthetic ceiling over rooms without one, as the seed paper adds to Replica's open scenes.

A place on the floor is open if nothing lies above it, and indoors if three quarters of the directions at
listener height meet something. Where indoor places are open, a ceiling is laid at the height of the ceiling
around them or, if most of the storey has none, of the walls.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.heightfield import too_large
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.rays.diffuse_walk import blocked
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.storeys import CELL, STEP, find_ground, find_storeys
from soundspaces_sim.scene.walkable import Columns

_HEIGHT = 1.5  # m, of an agent, and where walls are looked for
_INDOORS = 0.75  # share of directions
_DIRECTIONS = 16
_REACH = 1.0  # m around an open place where furniture may stand under the same sky
_WORTH = 0.01  # share of a storey's floor below which a hole is let be
_TALLEST = 8.0  # m, of a storey


def add_ceiling(mesh: LabelledMesh, scene: Scene, always: bool = False) -> LabelledMesh:
    """The mesh with a synthetic ceiling where one is missing, and a note that says so; `scene` is made of the
    mesh.

    The faces of the ceiling come after the mesh's own. `always`: also over places that do not look like indoors.
    """
    ground = find_ground(scene, _HEIGHT)
    if ground is None:
        reason = too_large(scene.corners, CELL)
        if always:
            raise SceneError(f"{mesh.name}: no ceiling can be added: {reason}")
        note = f"missing ceilings were not looked for: {reason}"
        return replace(mesh, notes=(*mesh.notes, note))
    columns = ground.columns
    for floor in find_storeys(scene, _HEIGHT, ground).floors:
        covered, open_ = _places(columns, float(floor))
        if not always:
            open_ &= _indoors(scene, columns, open_, float(floor))
        total = int(covered.sum() + open_.sum())
        if total == 0 or open_.sum() < max(_WORTH * total, 1):
            continue
        height = _ceiling_height(scene, float(floor), bool(covered.sum() > open_.sum()))
        where = f"{100.0 * open_.sum() / total:.0f} % of the floor at z = {floor:.2f} m"
        mesh = _cover(mesh, columns, open_, height, where)
    return mesh


def _places(columns: Columns, floor: float) -> tuple[np.ndarray, np.ndarray]:
    """(nx, ny) where the storey's floor has something above it, and where it has nothing."""
    column = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
    here = np.abs(columns.floor - floor) <= STEP
    last = np.zeros(len(column), bool)
    last[columns.start[1:][np.diff(columns.start) > 0] - 1] = True  # the highest floor of its column
    maps = []
    for chosen in (here & ~columns.sky, here & columns.sky & last):
        out = np.zeros(len(columns.start) - 1, bool)
        out[column[chosen]] = True
        maps.append(out.reshape(columns.cells.nx, columns.cells.ny))
    return maps[0], maps[1]


def _indoors(scene: Scene, columns: Columns, where: np.ndarray, floor: float) -> np.ndarray:
    i, j = np.nonzero(where)
    points = np.stack([*columns.cells.middles(i, j), np.full(len(i), floor + _HEIGHT)], axis=1)
    angle = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    directions = np.stack([np.cos(angle), np.sin(angle), np.zeros(_DIRECTIONS)], axis=1)
    out = np.zeros(where.shape, bool)
    out[i, j] = blocked(scene.plain_geometry, points - scene.center, directions).mean(axis=1) >= _INDOORS
    return out


def _ceiling_height(scene: Scene, floor: float, has_ceiling: bool) -> float:
    """Of the storey's ceilings (median by area) if it has any, else of its walls' upper ends."""
    z = scene.corners[:, :, 2]
    above = (z.max(axis=1) > floor + _HEIGHT + STEP) & (z.max(axis=1) < floor + _TALLEST)
    level = np.abs(scene.normals[:, 2])
    chosen = above & ((level > 0.9) & (z.min(axis=1) > floor + _HEIGHT) if has_ceiling else level < 0.3)
    if not chosen.any():
        return float(scene.bounds[1, 2])
    height, area = z[chosen].max(axis=1), scene.areas[chosen]
    order = np.argsort(height, kind="stable")
    at = np.searchsorted(np.cumsum(area[order]), (0.5 if has_ceiling else 0.95) * area.sum())
    return float(height[order][min(at, len(order) - 1)])


def _cover(
    mesh: LabelledMesh, columns: Columns, open_: np.ndarray, height: float, where: str
) -> LabelledMesh:
    near = scipy.ndimage.distance_transform_edt(~open_) * CELL <= _REACH
    top = columns.top.reshape(open_.shape)
    low = (top < height - CELL) & np.isfinite(top)
    # To the middle of the walls.
    area = scipy.ndimage.binary_dilation(open_ | (near & low), iterations=2)
    vertices, faces = [np.empty((0, 3))], [np.empty((0, 3), np.int64)]
    for k, (i0, i1, j0, j1) in enumerate(_rectangles(area)):
        x0, x1 = columns.cells.x0 + i0 * CELL, columns.cells.x0 + i1 * CELL
        y0, y1 = columns.cells.y0 + j0 * CELL, columns.cells.y0 + j1 * CELL
        vertices.append(
            np.array([[x0, y0, height], [x1, y0, height], [x1, y1, height], [x0, y1, height]])
        )
        faces.append(np.array([[0, 2, 1], [0, 3, 2]]) + 4 * k)
    size = area.sum() * CELL**2
    note = (
        f"nothing lies above {where}: a synthetic ceiling of {size:.1f} m2 was added at z = {height:.2f} m "
        "(ceiling=False leaves it open)"
    )
    return with_cover(mesh, np.concatenate(vertices), np.concatenate(faces), (note,))


def with_cover(
    mesh: LabelledMesh, vertices: np.ndarray, faces: np.ndarray, notes: tuple[str, ...]
) -> LabelledMesh:
    """The mesh with the faces (F, 3) of a ceiling between `vertices` (V, 3) after its own, and its notes."""
    if len(faces) == 0:
        return replace(mesh, notes=(*mesh.notes, *notes))
    labels, label = mesh.labels, -1
    if labels:  # a mesh without labels gets none here either
        labels = labels if "ceiling" in labels else (*labels, "ceiling")
        label = labels.index("ceiling")
    return LabelledMesh(
        np.concatenate([mesh.vertices, vertices]),
        np.concatenate([mesh.faces, faces + len(mesh.vertices)]),
        labels,
        np.concatenate([mesh.face_label, np.full(len(faces), label)]),
        mesh.name,
        (*mesh.notes, *notes),
    )


def _rectangles(area: np.ndarray) -> list[tuple[int, int, int, int]]:
    """Rows i0 to i1 and columns j0 to j1 (exclusive) of rectangles that tile the cells of a mask."""
    found: list[tuple[int, int, int, int]] = []
    growing: dict[tuple[int, int], int] = {}
    for i in range(len(area) + 1):
        row = (
            np.concatenate([[False], area[i], [False]])
            if i < len(area)
            else np.zeros(area.shape[1] + 2, bool)
        )
        edges = np.flatnonzero(np.diff(row.astype(np.int8)))
        runs = {(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)}
        for run in [r for r in growing if r not in runs]:
            found.append((growing.pop(run), i, *run))
        for run in runs:
            growing.setdefault(run, i)
    return found
