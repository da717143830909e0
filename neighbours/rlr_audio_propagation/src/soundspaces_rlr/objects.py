"""The objects of a context: meshes with a pose, and the scene that they make together."""

from __future__ import annotations

import io
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import trimesh

from soundspaces_rlr.errors import RlrError, as_runtime_errors
from soundspaces_rlr.materials import Database, concatenate_tables
from soundspaces_rlr.records import BoxMaterialCategories
from soundspaces_sim import Scene
from soundspaces_sim.parts import check_ply, open_mesh

# Corners of the unit cube in the order of np.ndindex(2, 2, 2), and its sides as two triangles each.
_SIDES = {
    "x_min": (0, 1, 3, 2),
    "x_max": (4, 6, 7, 5),
    "y_min": (0, 4, 5, 1),
    "y_max": (2, 3, 7, 6),
    "z_min": (0, 2, 6, 4),
    "z_max": (1, 5, 7, 3),
}
_DEFAULT = "default"


@dataclass(frozen=True)
class Mesh:
    """Triangles with a material category each; coordinates in the object's frame and units."""

    vertices: np.ndarray  # (V, 3)
    faces: np.ndarray  # (F, 3)
    categories: tuple[str, ...]
    face_category: np.ndarray  # (F,) row of `categories`


@dataclass
class SceneObject:
    """One object: what has been given so far, its mesh once that is finalized, and its pose."""

    vertices: list[np.ndarray] = field(default_factory=list)
    parts: list[tuple[np.ndarray, str]] = field(default_factory=list)  # faces and category
    mesh: Mesh | None = None
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))

    def finalize(self, index: int) -> None:
        """Make the mesh of what has been given. Raises `RlrError`."""
        if self.mesh is not None and not self.vertices and not self.parts:
            return
        if not self.vertices or not self.parts:
            raise RlrError(
                f"object {index} has {len(self.vertices)} blocks of vertices and {len(self.parts)} of "
                "indices; call add_mesh_vertices and add_mesh_indices before finalize_object_mesh"
            )
        vertices = np.concatenate(self.vertices)
        faces = np.concatenate([f for f, _ in self.parts])
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise RlrError(
                f"object {index}: indices reach {faces.min()}..{faces.max()}, but there are "
                f"{len(vertices)} vertices"
            )
        self.mesh = make_mesh(vertices, self.parts)
        self.vertices, self.parts = [], []


def make_mesh(vertices: np.ndarray, parts: list[tuple[np.ndarray, str]]) -> Mesh:
    """A mesh of vertices and (faces, category) parts."""
    categories = tuple(dict.fromkeys(category for _, category in parts))
    rows = np.concatenate([np.full(len(f), categories.index(category)) for f, category in parts])
    return Mesh(vertices, np.concatenate([f for f, _ in parts]), categories, rows)


def flat_vertices(values: object) -> np.ndarray:
    """(V, 3) from x, y, z, x, …. Raises `RlrError`."""
    array = np.asarray(values, float).ravel()
    if len(array) == 0 or len(array) % 3 or not np.isfinite(array).all():
        raise RlrError(
            f"add_mesh_vertices: expected finite x, y, z of every vertex in turn, got {len(array)} numbers"
        )
    return array.reshape(-1, 3)


def flat_faces(values: object, corners: int) -> np.ndarray:
    """(F, 3) triangles from the indices of faces with `corners` corners, split into fans."""
    array = np.asarray(values)
    if array.size and array.dtype.kind not in "iu":
        raise TypeError(f"add_mesh_indices: expected integers, got {array.dtype}")
    array = array.ravel().astype(np.int64)
    if corners < 3 or len(array) == 0 or len(array) % corners:
        raise RlrError(
            f"add_mesh_indices: expected a multiple of vertices_per_face, 3 or more, got {len(array)} "
            f"indices and {corners}"
        )
    polygons = array.reshape(-1, corners)
    fans = [polygons[:, [0, i, i + 1]] for i in range(1, corners - 1)]
    return np.stack(fans, axis=1).reshape(-1, 3)


def box_mesh(low: np.ndarray, high: np.ndarray, materials: BoxMaterialCategories) -> Mesh:
    """A box with a category per side. Raises `RlrError` unless it has a volume."""
    if not (high > low).all():
        raise RlrError(f"set_object_box: box_max {high} must exceed box_min {low} along every axis")
    corners = np.array(list(np.ndindex(2, 2, 2)), float)
    parts = []
    for side, (a, b, c, d) in _SIDES.items():
        category = getattr(materials, side)
        parts.append((np.array([[a, b, c], [a, c, d]]), category if category is not None else _DEFAULT))
    return make_mesh(low + corners * (high - low), parts)


def read_mesh(path: str | Path, category: str, kind: str) -> Mesh:
    """An OBJ or PLY file, all of one category. Raises `RlrError`."""
    try:
        with as_runtime_errors(), open_mesh(Path(path)) as file:
            if kind == "ply":
                check_ply(Path(path), file)
            content = io.BytesIO(file.read())  # trimesh asks an open file for its name
            loaded = trimesh.load_mesh(content, file_type=kind, process=False)
        vertices, faces = np.asarray(loaded.vertices, float), np.asarray(loaded.faces, np.int64)
    except RlrError:
        raise
    except OSError as error:
        raise RlrError(f"{path}: cannot read this file ({error.strerror or error})") from error
    except Exception as error:  # trimesh raises whatever its parsers met
        raise RlrError(f"{path}: cannot be read as {kind.upper()} ({error})") from error
    if len(faces) == 0 or not np.isfinite(vertices[faces]).all():
        raise RlrError(f"{path}: expected a mesh with faces and finite coordinates")
    return make_mesh(vertices, [(faces, category)])


def build_scene(
    objects: list[SceneObject], database: Database, unit: float, transmits: bool
) -> tuple[Scene | None, np.ndarray]:
    """The scene of all objects that have a mesh, in metres, and the object of each of its faces (F,); None if
    none has.

    Faces keep their category as label. Without `transmits` nothing passes through surfaces.
    """
    parts = [(o, o.mesh) for o in objects if o.mesh is not None]
    if not parts:
        return None, np.empty(0, np.int64)
    categories = list(dict.fromkeys(c for _, mesh in parts for c in mesh.categories))
    table = concatenate_tables(database.materials(categories))
    if not transmits:
        table = replace(table, transmission=np.zeros_like(table.transmission))
    vertices = [unit * (mesh.vertices @ o.turn.T + o.position) for o, mesh in parts]
    before = np.cumsum([0] + [len(v) for v in vertices])
    rows = np.concatenate(
        [np.array([categories.index(c) for c in m.categories])[m.face_category] for _, m in parts]
    )
    scene = Scene(
        np.concatenate(vertices),
        np.concatenate([m.faces + n for (_, m), n in zip(parts, before, strict=False)]),
        rows,
        table,
        tuple(categories),
        rows,
        name="rlr context",
    )
    return scene, np.searchsorted(before, scene.faces[:, 0], "right") - 1
