"""Any mesh that trimesh reads. Materials, or else names of parts, serve as labels.

glTF is Y up and in metres, 3MF Z up and in the unit that it names; others say neither.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import trimesh

from soundspaces_sim.base.errors import SceneError
from soundspaces_sim.loaders.labelled import LabelledMesh, SceneFormat
from soundspaces_sim.scene.adopt import join_parts, parts_of

_UP = {".glb": "y", ".gltf": "y", ".3mf": "z"}
_METRES = {
    "micron": 1e-6,
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "meter": 1.0,
    "inch": 0.0254,
    "foot": 0.3048,
}


def read_mesh(source: str) -> LabelledMesh:
    """Read a mesh file. Raises `SceneError`."""
    path = Path(source)
    return from_parts(path, open_with_trimesh(path))


def open_with_trimesh(path: Path, **options: Any) -> Any:
    """A `trimesh.Scene`; `options` instead of the path, if there are any. Raises `SceneError`."""
    try:
        return trimesh.load_scene(
            **(options or {"file_obj": str(path)}), process=False, group_material=True
        )
    except OSError as error:
        raise SceneError(f"{path}: cannot read this file ({error.strerror or error})") from error
    except Exception as error:  # trimesh raises whatever its parsers met
        raise SceneError(
            f"{path}: cannot be read as a {path.suffix or 'mesh'} file ({error or type(error).__name__}); "
            f"expected one of {', '.join(sorted({*trimesh.available_formats(), 'ifc'}))}"
        ) from error


def from_parts(path: Path, scene: Any) -> LabelledMesh:
    """The meshes of a `trimesh.Scene` as one. Raises `SceneError`."""
    suffix = path.suffix.lower()
    try:
        parts = parts_of(scene, node_names=suffix in (".glb", ".gltf"))
    except Exception as error:  # a damaged file may show when its parts are put in place
        raise SceneError(f"{path}: the parts of this file cannot be put together ({error})") from error
    if not parts:
        raise SceneError(f"{path}: the mesh has no faces (a point cloud?); need triangles")
    metre = 1.0 if suffix in (".glb", ".gltf") else None
    if suffix == ".3mf":
        metre = _METRES.get(re.sub("s$", "", str(scene.units or "").lower()).replace("inche", "inch"))
    return LabelledMesh(*join_parts(parts), path.stem, up=_UP.get(suffix), metre=metre)


FORMAT = SceneFormat(
    "a mesh file (OBJ, PLY, GLB, glTF, STL, OFF, DAE, 3MF, …)",
    lambda source: Path(source).is_file(),
    read_mesh,
)
