"""Any mesh that trimesh reads. Materials or groups serve as labels; axis and unit are found here.

A format that says which way is up and how long a metre is, is believed (glTF: Y up, metres). For the
others both are guessed from room-like proportions, and the guess is reported with its reason.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from soundspaces_sim.base.errors import SceneError
from soundspaces_sim.loaders.labelled import LabelledMesh
from soundspaces_sim.scene.triangles import cross_products

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
UPS = ("y", "z")
_GLTF = (".glb", ".gltf")


def load_mesh(path: Path, up: str | None = None, unit: str | None = None) -> LabelledMesh:
    """Read a mesh file. `up`: 'y' or 'z'; `unit`: a key of `UNITS`. Raises `SceneError`."""
    vertices, faces, labels, face_label = _read(path)
    notes: list[str] = []
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise SceneError(f"{path}: vertices need three coordinates, got shape {vertices.shape}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError(
            f"{path}: face indices reach {faces.min()}..{faces.max()}, but there are {len(vertices)} vertices; "
            "is the file complete?"
        )
    if not np.isfinite(vertices[faces]).all():
        raise SceneError(f"{path}: some faces have coordinates that are not finite (NaN or inf)")
    if up is None:
        up, reason = (
            ("y", "glTF files are Y up") if path.suffix.lower() in _GLTF else _guess_up(vertices, faces)
        )
        notes.append(f"{up.upper()} is taken as up: {reason} (override with up=)")
    if up == "y":  # turn about X: y becomes z, z becomes -y
        vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    if unit is None:
        height = float(np.ptp(vertices[np.unique(faces), 2]))
        unit, reason = (
            ("m", "glTF files are in metres") if path.suffix.lower() in _GLTF else _guess_unit(height)
        )
        notes.append(f"lengths are taken as {unit}: {reason} (override with unit=)")
    if not labels:
        notes.append(
            "the file has no labels: every face gets the default material "
            "(override with materials= and labels=)"
        )
    return LabelledMesh(vertices * UNITS[unit], faces, labels, face_label, path.stem, tuple(notes))


def _read(path: Path) -> tuple[np.ndarray, np.ndarray, tuple[str, ...], np.ndarray]:
    """Vertices, faces, labels and label rows of all meshes in a file, in the scene's frame."""
    try:
        scene: Any = trimesh.load_scene(path, process=False, group_material=True)
        parts = scene.dump() if len(scene.geometry) else []
    except OSError as error:
        raise SceneError(f"{path}: cannot read this file ({error.strerror or error})") from error
    except Exception as error:  # trimesh raises whatever its parsers met
        raise SceneError(
            f"{path}: cannot be read as a {path.suffix or 'mesh'} file ({error}); expected one of "
            f"{', '.join(sorted(trimesh.available_formats()))}"
        ) from error
    meshes = [m for m in parts if isinstance(m, trimesh.Trimesh) and len(m.faces)]
    if not meshes:
        raise SceneError(f"{path}: the mesh has no faces (a point cloud?); need triangles")
    names = [_label(m) for m in meshes]
    labels = tuple(sorted({n for n in names if n}))
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes])
    return (
        np.concatenate([np.asarray(m.vertices, float) for m in meshes]),
        np.concatenate([np.asarray(m.faces) + o for m, o in zip(meshes, offsets, strict=False)]),
        labels,
        np.concatenate(
            [
                np.full(len(m.faces), labels.index(n) if n else -1)
                for m, n in zip(meshes, names, strict=True)
            ]
        ),
    )


def _label(mesh: Any) -> str:
    """The name of a mesh's material, if the file gave it one."""
    name = getattr(getattr(mesh.visual, "material", None), "name", None)
    return str(name) if name and not str(name).startswith(("material_", "default")) else ""


def _guess_up(vertices: np.ndarray, faces: np.ndarray) -> tuple[str, str]:
    """Which of Y and Z is up: along it the mesh is low and has one large level (floor or ceiling)."""
    corners = vertices[faces]
    cross = cross_products(corners)
    area = 0.5 * np.linalg.norm(cross, axis=1)
    normal = cross / np.maximum(2.0 * area, 1e-300)[:, None]
    extent = np.ptp(corners.reshape(-1, 3), axis=0)
    score = {}
    for name, axis in (("y", 1), ("z", 2)):
        level = np.abs(normal[:, axis]) > 0.9
        height = corners[level, :, axis].mean(axis=1)
        slab = max(extent[axis] / 30.0, 1e-12)
        rows = np.floor((height - corners[..., axis].min()) / slab).astype(np.int64)
        largest = np.bincount(rows, weights=area[level]).max(initial=0.0)
        across = float(np.prod(np.delete(extent, axis)))
        score[name] = largest / max(across, 1e-300) / max(float(extent[axis]), 1e-300)
    up = "y" if score["y"] > 1.2 * score["z"] else "z"
    other = "z" if up == "y" else "y"
    if max(score.values()) <= 1.2 * min(score.values()):
        return "z", "neither axis stands out, and Z up is this package's convention"
    return up, (
        f"along it the mesh is lower and more level than along {other.upper()} "
        f"(score {score[up]:.2g} against {score[other]:.2g})"
    )


def _guess_unit(height: float) -> tuple[str, str]:
    """Unit in which a height reads like that of a building (2 to 40 m)."""
    if height < 50.0:
        unit = "m"
    elif height < 180.0:
        unit = "in"
    elif height < 1500.0:
        unit = "cm"
    else:
        unit = "mm"
    return unit, f"a height of {height:.4g} is then {height * UNITS[unit]:.2f} m"
