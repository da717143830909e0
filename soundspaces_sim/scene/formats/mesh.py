"""Meshes that trimesh reads. Materials, or else names of parts, serve as labels.

glTF is Y up and in metres, 3MF Z up and in the unit that it names; others say neither.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.adopt import concatenate_parts, parts_of
from soundspaces_sim.scene.formats.gltf import Buffers, read_gltf
from soundspaces_sim.scene.formats.limits import check_3mf, check_corners, check_ply, open_mesh
from soundspaces_sim.scene.labelled import LabelledMesh, SceneFormat
from soundspaces_sim.scene.materials import MaterialTable

_UP = {".glb": "y", ".gltf": "y", ".3mf": "z"}
_METRES = {
    "micron": 1e-6,
    "millimeter": 1e-3,
    "mm": 1e-3,
    "centimeter": 1e-2,
    "cm": 1e-2,
    "meter": 1.0,
    "m": 1.0,
    "inch": 0.0254,
    "in": 0.0254,
    "foot": 0.3048,
    "feet": 0.3048,
    "ft": 0.3048,
}

#: Not archives, which may hold anything; and not what opens files of its own accord.
FORMATS = ("3mf", "dae", "glb", "gltf", "ifc", "obj", "off", "ply", "stl", "stl_ascii")


def read_mesh(source: str) -> LabelledMesh:
    """Read a mesh file. Raises `SceneError`."""
    import trimesh

    path = Path(source)
    kind = path.suffix.lower().removeprefix(".")
    with open_mesh(path) as file, in_our_words(path):
        if kind == "3mf" and find_spec("lxml") is None:
            raise SceneError(f"{path}: 3MF files need the lxml package: `pip install lxml`")
        if kind not in FORMATS or kind not in trimesh.available_formats():
            raise ValueError("this kind of file is not supported")
        content, beside = file, Buffers()
        known: dict[str, MaterialTable] = {}
        if kind in ("glb", "gltf"):
            plain, beside, known = read_gltf(path, file.read())
            kind, content = "gltf", io.BytesIO(plain)
        elif kind == "ply":
            check_ply(path, file)
        elif kind == "3mf":
            check_3mf(path, file)
        found = from_parts(path, open_with_trimesh(path, content, kind, beside))
        return replace(found, materials={n: m for n, m in known.items() if n in found.labels})


def open_with_trimesh(path: Path, file: Any, kind: str, beside: Any) -> Any:
    """The `trimesh.Scene` of an open file; `beside`: contents by name of files that it refers to. Raises
    `SceneError`."""
    import trimesh

    with in_our_words(path):
        return trimesh.load_scene(
            file_obj=file, file_type=kind, resolver=beside, process=False, group_material=True
        )


@contextmanager
def in_our_words(path: Path) -> Iterator[None]:
    """What parsers raise about a damaged file, of whatever kind, as `SceneError`."""
    try:
        yield
    except SceneError:
        raise
    except Exception as error:
        raise SceneError(
            f"{path}: cannot be read as a {path.suffix or 'mesh'} file ({error or type(error).__name__}); "
            f"expected one of {', '.join(FORMATS)}"
        ) from error


def from_parts(path: Path, scene: Any) -> LabelledMesh:
    """The meshes of a `trimesh.Scene` as one. Raises `SceneError`."""
    suffix = path.suffix.lower()
    try:
        in_place = (scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
        corners = sum(3 * len(getattr(part, "faces", ())) for part in in_place)
        check_corners(path, corners, path.stat().st_size)
        parts = parts_of(scene, node_names=suffix in (".glb", ".gltf"))
    except SceneError:
        raise
    except Exception as error:  # a damaged file may show when its parts are put in place
        raise SceneError(f"{path}: the parts of this file cannot be put together ({error})") from error
    if not parts:
        raise SceneError(f"{path}: the mesh has no faces (a point cloud?); need triangles")
    metre = 1.0 if suffix in (".glb", ".gltf") else None
    if suffix == ".3mf":
        metre = _metre(str(scene.units or ""))
    return LabelledMesh(*concatenate_parts(parts), path.stem, up=_UP.get(suffix), metre=metre)


def _metre(unit: str) -> float | None:
    """The length of a unit by its name in singular or plural, m; None if it is not known."""
    name = re.sub(r"metre", "meter", unit.lower())
    return next(
        (_METRES[n] for n in (name, name.removesuffix("s"), name.removesuffix("es")) if n in _METRES),
        None,
    )


def with_unit(mesh: LabelledMesh, unit: str) -> LabelledMesh:
    """A mesh whose file names its unit; one that is not known is noted."""
    metre = _metre(unit)
    if metre is not None:
        return replace(mesh, metre=metre)
    note = f"the file says that its unit is {unit!r}, which is not known here: give it (--unit)"
    return replace(mesh, notes=(*mesh.notes, note))


FORMAT = SceneFormat(
    "a mesh file (OBJ, PLY, GLB, glTF, STL, OFF, 3MF, …)",
    lambda source: Path(source).is_file(),
    read_mesh,
    beside=True,
)
