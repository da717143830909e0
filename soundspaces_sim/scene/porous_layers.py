"""Sheets: curtains, screens and canopies that hang free, which sound meets on both faces and passes.

Absorption is tabulated as a curtain takes it before a wall, where sound passes it twice, there and back. A face
that hangs free with that absorption on either side would take it twice. So a free-hanging piece of a material
that is a sheet (`MaterialTable.sheet`) gets a material of its own: a pass absorbs 1 - sqrt(1 - alpha), so that two
take alpha, and of the rest the sheet's share goes through.

The same material is also given to what it covers: sofas, beds. What tells them apart is what is behind a face:
within a body, or between a rug and the floor, sound does not get far; behind a curtain it does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.core.numerics.vec3 import Vec3, negate, row
from soundspaces_sim.scene.materials import FREE, MaterialTable, pass_absorption
from soundspaces_sim.scene.rays.directions import sample_cosine_hemisphere
from soundspaces_sim.scene.rays.geometry import Geometry, before, intersect, lifted
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import pieces_of, points_on, welded_faces

_SAMPLES = 256  # per piece and side
_BOUNCES = 8
_AROUND = 0.05  # m around a piece: a walk that leaves this box has escaped
_OPEN = 0.5  # share of walks that get away from the less open side


class Boxes(NamedTuple):
    """n boxes parallel to the axes."""

    low: np.ndarray  # (n, 3) m
    high: np.ndarray  # (n, 3) m


def with_free_sheets(scene: Scene) -> Scene:
    """The scene with free-hanging pieces of sheet materials as sheets, and a note of them; else, as it is."""
    rows = np.flatnonzero(np.isfinite(scene.materials.sheet).all(axis=1))
    faces = np.flatnonzero(np.isin(scene.face_material, rows))
    if len(faces) == 0:
        return scene
    free = faces[_hanging_free(scene, faces)]
    if len(free) == 0:
        return scene
    table, of_row = _with_free_rows(scene.materials, np.unique(scene.face_material[free]))
    material = scene.face_material.copy()
    material[free] = of_row[material[free]]
    return replace(
        scene, materials=table, face_material=material, notes=(*scene.notes, _note(scene, free))
    )


def mounted(scene: Scene) -> Scene:
    """The scene with free-hanging sheets taken as if they were mounted on a wall, both faces of them.

    Raises `MaterialError` if the table has no material for one.
    """
    table = scene.materials
    rows = table.mounted_rows[scene.face_material]
    if (rows == scene.face_material).all():
        return scene
    if rows.min() < 0:
        name = table.names[scene.face_material[rows.argmin()]]
        raise MaterialError(
            f"{scene.name}: '{name}' hangs free, and the table has no '{name.removesuffix(FREE)}' to take for it "
            "with simulation.porous_layers = false; add that material, or leave them on"
        )
    return replace(scene, face_material=rows)


def _with_free_rows(table: MaterialTable, rows: np.ndarray) -> tuple[MaterialTable, np.ndarray]:
    """The table with a free-hanging twin of some rows, and the row of each one's twin."""
    names, count = list(table.names), len(table.names)
    of_row = np.arange(count)
    known = np.array([names[r] + FREE in names for r in rows])
    of_row[rows[known]] = [names.index(names[r] + FREE) for r in rows[known]]
    rows = rows[~known]
    of_row[rows] = count + np.arange(len(rows))
    absorbed = pass_absorption(table.absorption[rows])
    through = (1.0 - absorbed) * table.sheet[rows]
    return MaterialTable(
        (*names, *(names[r] + FREE for r in rows)),
        table.frequency_hz,
        np.concatenate([table.absorption, absorbed]),
        np.concatenate([table.scattering, table.scattering[rows]]),
        np.concatenate([table.transmission, through]),
        np.concatenate([table.sheet, np.full((len(rows), table.sheet.shape[1]), np.nan)]),
        reflection=(*table.reflection, *(table.reflection[r] for r in rows)),
        mounting=(*table.mounting, *("free" for _ in rows)),
    ), of_row


def _note(scene: Scene, free: np.ndarray) -> str:
    names = sorted({scene.materials.names[m] for m in np.unique(scene.face_material[free])})
    labels = sorted({scene.labels[i] for i in np.unique(scene.face_label[free]) if i >= 0})
    what = f" ({', '.join(labels[:8])}{', …' if len(labels) > 8 else ''})" if labels else ""
    return (
        f"{len(free)} faces ({scene.areas[free].sum():.1f} m2) of {', '.join(names)}{what} hang free: a pass "
        "absorbs 1 - sqrt(1 - absorption), and most of the rest goes through"
    )


def _hanging_free(scene: Scene, faces: np.ndarray) -> np.ndarray:
    """(n,) which of these faces belong to pieces open on both sides."""
    points, rows = welded_faces(scene.vertices - scene.center, scene.faces[faces], 4)
    piece = pieces_of(rows, len(points))
    corners = scene.corners[faces] - scene.center
    count = int(piece.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece, corners.min(axis=1))
    np.maximum.at(high, piece, corners.max(axis=1))
    rng = np.random.default_rng(0)
    owner, face = [], []
    for p in range(count):
        own = np.flatnonzero(piece == p)
        share = scene.areas[faces[own]]
        owner.append(np.full(_SAMPLES, p))
        face.append(own[rng.choice(len(own), _SAMPLES, p=share / share.sum())])
    of, at = np.concatenate(owner), np.concatenate(face)
    start = points_on(corners[at], *rng.uniform(size=(2, len(at))))
    away = np.zeros((len(at), 2), np.bool_)
    boxes = Boxes(low[of] - _AROUND, high[of] + _AROUND)
    over_rows(_walk_away, len(at), scene.geometry, start, faces[at], boxes, away)
    open_ = np.stack([np.bincount(of, away[:, side], count) for side in (0, 1)]) / _SAMPLES
    return np.asarray((open_.min(axis=0) >= _OPEN)[piece])


@part(forceinline=True)
def _is_within(point: Vec3, low: Vec3, high: Vec3) -> bool:
    x, y, z = point
    return low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2]


@kernel
def _walk_away(
    first: int,
    last: int,
    geometry: Geometry,
    start: np.ndarray,
    face: np.ndarray,
    box: Boxes,
    away: np.ndarray,
) -> None:
    """Flag `away` (n, 2): a diffuse walk from `start[i]` on `face[i]`, off either side, leaves the piece's box."""
    for i in range(first, last):
        for side in range(2):
            key = combine(np.uint64(i), side)
            normal = row(geometry.normal, face[i])
            if side == 1:
                normal = negate(normal)
            origin = lifted(geometry, row(start, i), normal)
            for bounce in range(_BOUNCES):
                u, v = hashed_uniform(key, 2 * bounce), hashed_uniform(key, 2 * bounce + 1)
                direction = sample_cosine_hemisphere(normal, u, v)
                hit = intersect(geometry, origin, direction, np.inf)
                if hit.triangle < 0 or not _is_within(hit.point, row(box.low, i), row(box.high, i)):
                    away[i, side] = True
                    break
                origin, normal = before(geometry, hit, direction), hit.normal
