"""Vertices, faces, materials and labels of a scene, checked, from what a caller gives: arrays, or trimesh
objects.

Conventions: metres, Z up; `absorption` is a number in [0, 1] or the name of a material.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import MaterialError, SceneError
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.scene.adopt import concatenate_parts, parts_of
from soundspaces_sim.scene.labels import assign_materials, load_labels
from soundspaces_sim.scene.materials import MaterialTable, stack_materials
from soundspaces_sim.scene.triangles import areas, check_mesh

#: Absorption (a number in [0, 1]) or the name of a material.
Surface = float | str
Surfaces = Surface | Sequence[Surface] | np.ndarray


class Faces(NamedTuple):
    """The first fields of a `Scene`."""

    vertices: np.ndarray  # (V, 3) m
    faces: np.ndarray  # (F, 3) rows of `vertices`
    face_material: np.ndarray  # (F,) rows of `materials`
    materials: MaterialTable
    labels: tuple[str, ...]
    face_label: np.ndarray  # (F,) rows of `labels`, or -1; empty without labels


def faces_of_arrays(
    vertices: ArrayLike,
    faces: ArrayLike,
    absorption: Surfaces = 0.1,
    scattering: ArrayLike = 0.5,
    transmission: ArrayLike = 0.0,
    *,
    materials: MaterialTable | str | Path | None = None,
    name: str = "scene",
) -> Faces:
    """See `Scene.from_arrays`."""
    unlabelled: tuple[tuple[str, ...], np.ndarray] = ((), np.empty(0, np.int64))
    vertices, faces = _as_mesh(vertices, faces, name)
    values = _per_face(absorption, len(faces), name)
    names = [v for v in values if isinstance(v, str)]
    if names:
        if len(names) < len(values):
            raise MaterialError(f"{name}: absorption: expected numbers or names of materials, got both")
        table = stack_materials(materials)
        row = {n: table.index(n) for n in set(names)}
        return Faces(vertices, faces, np.array([row[n] for n in names], np.int64), table, *unlabelled)
    rows, table = _table_of(values, scattering, transmission, len(faces), name)
    return Faces(vertices, faces, rows, table, *unlabelled)


def faces_of_trimesh(
    mesh: Any,
    materials: MaterialTable | str | Path | Sequence[str] | None = None,
    labels: Mapping[str, str] | str | Path | None = None,
    *,
    absorption: Surfaces | None = None,
    scattering: ArrayLike = 0.5,
    transmission: ArrayLike = 0.0,
    name: str = "mesh",
) -> Faces:
    """See `Scene.from_trimesh`."""
    vertices, faces, names, face_label = mesh_arrays(mesh, name)
    of_faces = materials if _names_materials(materials) else absorption
    if of_faces is not None:
        own: Any = None if of_faces is materials else materials
        given: Any = of_faces
        return faces_of_arrays(
            vertices, faces, given, scattering, transmission, materials=own, name=name
        )
    table = stack_materials(materials)  # type: ignore[arg-type]
    rows = assign_materials(names, face_label, areas(vertices[faces]), table, load_labels(labels)).rows
    return Faces(vertices, faces, rows, table, names, face_label)


def mesh_arrays(mesh: Any, name: str) -> tuple[np.ndarray, np.ndarray, tuple[str, ...], np.ndarray]:
    """Vertices, faces, labels and label rows of a `trimesh.Trimesh` or `trimesh.Scene`. `SceneError`."""
    import trimesh

    if not isinstance(mesh, trimesh.Trimesh | trimesh.Scene):
        raise SceneError(f"expected a trimesh.Trimesh or trimesh.Scene, got {type(mesh).__name__}")
    parts = parts_of(mesh, node_names=isinstance(mesh, trimesh.Scene))
    if not parts:
        raise SceneError(f"{name}: the mesh has no faces (a point cloud?); need triangles")
    for vertices, faces, _ in parts:
        _as_mesh(vertices, faces, name)
    return concatenate_parts(parts)


def _names_materials(materials: Any) -> bool:
    """Whether it is a material's name or a sequence of them, not a table or a file of materials."""
    if isinstance(materials, str):
        return not materials.lower().endswith(".toml")
    return isinstance(materials, Sequence)


def _as_mesh(vertices: ArrayLike, faces: ArrayLike, name: str) -> tuple[np.ndarray, np.ndarray]:
    points = as_floats(vertices, f"{name}: vertices")
    try:
        rows = np.asarray(faces)
    except (ValueError, TypeError) as error:
        raise SceneError(f"{name}: faces need shape (F, 3) and integers ({error})") from error
    check_mesh(points, rows, name)
    return points, rows


def as_floats(values: ArrayLike, what: str) -> np.ndarray:
    """A copy as floats. Raises `SceneError` for anything but numbers."""
    try:
        return np.array(values, float)
    except (ValueError, TypeError) as error:
        raise SceneError(f"{what}: expected numbers ({error})") from error


def _per_face(value: Any, count: int, name: str) -> list[Any]:
    """A list of `count` numbers or names."""
    if isinstance(value, str) or np.ndim(value) == 0:
        return [value] * count
    values = list(value)
    if len(values) != count:
        raise MaterialError(
            f"{name}: absorption: expected one value, or one per face ({count}), got {len(values)}"
        )
    return [str(v) if isinstance(v, np.str_) else v for v in values]


def _table_of(
    absorption: list[Any], scattering: ArrayLike, transmission: ArrayLike, count: int, name: str
) -> tuple[np.ndarray, MaterialTable]:
    """A row per face, and the table of all different (absorption, scattering, transmission)."""
    columns = []
    for what, value in (
        ("absorption", absorption),
        ("scattering", scattering),
        ("transmission", transmission),
    ):
        try:
            columns.append(np.broadcast_to(np.asarray(value, float), count))
        except (ValueError, TypeError) as error:
            raise MaterialError(
                f"{name}: {what}: expected a number, or one per face ({count}) ({error})"
            ) from error
    rows = np.stack(columns, axis=1)
    first, of_face = unique_rows(rows)
    rows = rows[first]
    names = tuple(
        f"absorption {a:g}, scattering {s:g}, transmission {t:g} ({i})"
        for i, (a, s, t) in enumerate(rows)
    )
    return of_face, MaterialTable(names, np.array([1000.0]), *rows.T[:, :, None])
