"""Scenes from arrays, from trimesh objects, and rectangular rooms. Metres, Z up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import MaterialError, SceneError
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.scene.adopt import join_parts, parts_of
from soundspaces_sim.scene.labels import assign_materials, load_labels
from soundspaces_sim.scene.materials import MaterialTable, stack_materials
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import areas

WALLS = (
    "west",
    "east",
    "south",
    "north",
    "floor",
    "ceiling",
)  # at x = 0, x = max, y = 0, y = max, z = 0, z = max
_LABEL_OF_WALL = ("wall", "wall", "wall", "wall", "floor", "ceiling")

#: Absorption (a number in [0, 1]) or the name of a material.
Surface = float | str


def from_arrays(
    vertices: ArrayLike,
    faces: ArrayLike,
    absorption: Surface | Sequence[Surface] | np.ndarray = 0.1,
    scattering: ArrayLike = 0.5,
    transmission: ArrayLike = 0.0,
    *,
    materials: MaterialTable | str | Path | None = None,
    name: str = "scene",
) -> Scene:
    """See `Scene.from_arrays`."""
    vertices, faces = _as_mesh(vertices, faces, name)
    values = _per_face(absorption, len(faces), name)
    names = [v for v in values if isinstance(v, str)]
    if names:
        if len(names) < len(values):
            raise MaterialError(f"{name}: absorption: expected numbers or names of materials, got both")
        table = stack_materials(materials)
        row = {n: table.index(n) for n in set(names)}
        return Scene(vertices, faces, np.array([row[n] for n in names], np.int64), table, name=name)
    rows, table = _table_of(values, scattering, transmission, len(faces), name)
    return Scene(vertices, faces, rows, table, name=name)


def from_trimesh(
    mesh: Any,
    materials: MaterialTable | str | Path | Sequence[str] | None = None,
    labels: Mapping[str, str] | str | Path | None = None,
    *,
    absorption: Surface | Sequence[Surface] | np.ndarray | None = None,
    scattering: ArrayLike = 0.5,
    transmission: ArrayLike = 0.0,
    name: str = "mesh",
) -> Scene:
    """See `Scene.from_trimesh`."""
    vertices, faces, names, face_label = mesh_arrays(mesh, name)
    of_faces = materials if _names_materials(materials) else absorption
    if of_faces is not None:
        own = None if of_faces is materials else materials
        return from_arrays(
            vertices, faces, of_faces, scattering, transmission,  # type: ignore[arg-type]
            materials=own, name=name,  # type: ignore[arg-type]
        )  # fmt: skip
    table = stack_materials(materials)  # type: ignore[arg-type]
    rows = assign_materials(names, face_label, areas(vertices[faces]), table, load_labels(labels)).rows
    return Scene(vertices, faces, rows, table, names, face_label, name)


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
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise SceneError(
                f"{name}: face indices reach {faces.min()}..{faces.max()}, but there are {len(vertices)} vertices"
            )
    return join_parts(parts)


def shoebox(
    size: ArrayLike,
    absorption: Surface | Mapping[str, Surface] = 0.1,
    scattering: float | Mapping[str, float] = 0.5,
    transmission: float | Mapping[str, float] = 0.0,
    *,
    materials: MaterialTable | str | Path | None = None,
    name: str = "shoebox",
) -> Scene:
    """A rectangular room from the origin to `size` (3,) m.

    `absorption` is a number in [0, 1] or a material's name, for all walls or a mapping with one for each of
    west, east (x = 0 and x = size), south, north (y), floor and ceiling; `scattering` and `transmission`
    likewise, of walls given by numbers. `materials`: as in `load_scene`. Raises `SceneError` and
    `MaterialError`.
    """
    lengths = np.asarray(_floats(size, f"{name}: size"))
    if lengths.shape != (3,) or not np.isfinite(lengths).all() or lengths.min(initial=np.inf) <= 0.0:
        raise SceneError(f"{name}: size: expected three positive lengths in m, got {size!r}")
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * lengths
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = np.array([[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)])
    made = from_arrays(
        vertices, faces, _of_walls(absorption, "absorption", name),
        _of_walls(scattering, "scattering", name), _of_walls(transmission, "transmission", name),
        materials=materials, name=name,
    )  # fmt: skip
    labels = ("ceiling", "floor", "wall")
    rows = np.repeat([labels.index(label) for label in _LABEL_OF_WALL], 2)
    return Scene(made.vertices, made.faces, made.face_material, made.materials, labels, rows, name)


def _of_walls(value: Any, what: str, name: str) -> list[Any]:
    """One value per triangle of the room."""
    if isinstance(value, Mapping):
        if set(value) != set(WALLS):
            raise MaterialError(
                f"{name}: {what}: expected one value for each of {', '.join(WALLS)}, "
                f"got {', '.join(map(str, value))}"
            )
        return [value[wall] for wall in WALLS for _ in (0, 1)]
    return [value] * 12


def _names_materials(materials: Any) -> bool:
    """Whether it is a material's name or a sequence of them, not a table or a file of materials."""
    if isinstance(materials, str):
        return not materials.lower().endswith(".toml")
    return isinstance(materials, Sequence)


def _as_mesh(vertices: ArrayLike, faces: ArrayLike, name: str) -> tuple[np.ndarray, np.ndarray]:
    points = _floats(vertices, f"{name}: vertices")
    try:
        rows = np.asarray(faces)
    except (ValueError, TypeError) as error:
        raise SceneError(f"{name}: faces need shape (F, 3) and integers ({error})") from error
    if points.ndim != 2 or points.shape[1:] != (3,):
        raise SceneError(f"{name}: vertices need shape (V, 3), got {points.shape}")
    if rows.ndim != 2 or rows.shape[1:] != (3,) or rows.dtype.kind not in "iu":
        raise SceneError(f"{name}: faces need shape (F, 3) and integers, got {rows.shape} {rows.dtype}")
    return points, rows


def _floats(values: ArrayLike, what: str) -> np.ndarray:
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
