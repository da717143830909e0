"""Scenes that distributions of their own read or make: without these they are refused by name.

Read as any other mesh, a PLY file of I-Simpa would lose its layers, and a scene of habitat lie on its side.
"""

from __future__ import annotations

import re
from pathlib import Path

from soundspaces_sim.core.errors import ConfigError, SceneError
from soundspaces_sim.core.extras import neighbour_hint
from soundspaces_sim.core.registry import Entry, of_neighbour
from soundspaces_sim.scene.formats.limits import ply_header
from soundspaces_sim.scene.labelled import LabelledMesh, SceneFormat

#: Of generated buildings, as ``home-7``.
BUILDINGS = ("home", "room", "office", "classroom", "hall", "church")
_BUILDING = Entry("soundspaces_buildings.registry:read_building", "a generated building", "buildings")
_PROGRAMS, _FORMATS = "room_programs", "scene_formats"
_BY_SUFFIX = {
    **dict.fromkeys((".geo", ".par", ".proj"), _PROGRAMS),
    **dict.fromkeys((".ifc", ".dae"), _FORMATS),
}
_HM3D = re.compile(r"\d{5}-(\w+)", re.ASCII)  # a scene's folder
_PAINTED, _COLOURS, _BASIS = ".semantic.glb", ".semantic.txt", ".basis.glb"
_RAW, _PLY, _SCN, _NAVMESH = "mesh_z_up.obj", "_semantic.ply", ".scn", ".navmesh"


def _is_building(source: str) -> bool:
    return re.fullmatch(rf"({'|'.join(BUILDINGS)})-\d{{1,9}}", source) is not None


def find_hm3d(path: Path) -> Path | None:
    """The file of a scene's folder or of any of its files that the mesh is in; None if it is no scene of HM3D.

    Of a scene with one of the two semantic files the .semantic.glb, whether it is there or not."""
    if path.is_dir():
        found = [f for f in path.glob("*.semantic.*") if f.name.endswith((_PAINTED, _COLOURS))]
        names = {f.name.removesuffix(_PAINTED).removesuffix(_COLOURS) for f in found}
        if len(names) == 1:
            return path / f"{names.pop()}{_PAINTED}"
        named = _HM3D.fullmatch(path.name)
        plain = [path / f"{named[1]}{end}" for end in (".glb", _BASIS)] if named else []
        return next((f for f in plain if f.is_file()), None)
    end = next((e for e in (_PAINTED, _COLOURS, _BASIS, ".glb") if path.name.endswith(e)), None)
    if end is None or not path.is_file():
        return None
    name = path.name.removesuffix(end)
    mesh, text = path.with_name(name + _PAINTED), path.with_name(name + _COLOURS)
    if end in (_PAINTED, _COLOURS) or mesh.is_file() or text.is_file():
        return mesh
    folder = _HM3D.fullmatch(path.resolve().parent.name)
    return path if end == _BASIS or (folder and folder[1] == name) else None


def find_gibson(path: Path) -> Path | None:
    """The file that a scene's mesh is in, of its folder or one of its files; None if it is no scene of Gibson."""
    if path.is_dir():
        inside = find_gibson(path / f"{path.resolve().name}.glb")
        return inside or (path / _RAW if (path / _RAW).is_file() else None)
    if not path.is_file():
        return None
    if path.name == _RAW:
        return path
    end = next((e for e in (".glb", _PLY, _SCN) if path.name.endswith(e)), None)
    if end is None or path.name == end:
        return None
    name = path.name.removesuffix(end)
    glb, ply, scn, navmesh = (path.with_name(name + e) for e in (".glb", _PLY, _SCN, _NAVMESH))
    if ply.is_file() and scn.is_file():
        return ply
    of_another = end == _PLY or path.with_name(f"{name}.house").is_file()
    if of_another or not glb.is_file():
        return None
    return glb if scn.is_file() or navmesh.is_file() else None


def _folder_of(source: str) -> str | None:
    """In neighbours/, of what reads a file or folder; None if the core does."""
    path = Path(source)
    if find_hm3d(path) or find_gibson(path):
        return _FORMATS
    if not path.is_file():
        return None
    kind = path.suffix.lower()
    if kind == ".ply":
        return _PROGRAMS if b"element layer " in ply_header(path) else None
    return _BY_SUFFIX.get(kind)


def _read(source: str) -> LabelledMesh:
    if not _is_building(source):
        hint = neighbour_hint(_folder_of(source) or _FORMATS)
        raise SceneError(f"{source}: what reads this kind of scene is not installed; {hint}")
    try:
        read = of_neighbour(f"{source}: a generated building", _BUILDING)
    except ConfigError as error:
        raise SceneError(str(error)) from None
    return read(source)


FORMAT = SceneFormat(
    f"by distributions in neighbours/: {', '.join(f'{name!r}' for name in (f'{b}-<number>' for b in BUILDINGS))} "
    "(buildings); files of CATT-Acoustic, ODEON, I-Simpa and Gmsh (room_programs); scenes of HM3D and Gibson, IFC "
    "models, COLLADA files (scene_formats)",
    lambda source: _is_building(source) or _folder_of(source) is not None,
    _read,
)
