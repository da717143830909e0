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
_HM3D = re.compile(r"\d{5}-(\w+)")  # a scene's folder
_HM3D_ENDS = (".semantic.glb", ".semantic.txt", ".basis.glb")
_GIBSON_RAW, _GIBSON_ENDS = "mesh_z_up.obj", (".glb", "_semantic.ply", ".scn")


def _is_building(source: str) -> bool:
    return re.fullmatch(rf"({'|'.join(BUILDINGS)})-\d{{1,9}}", source) is not None


def _is_of_habitat(path: Path) -> bool:
    """Whether a file or folder is a scene of HM3D or Gibson, as far as names tell."""
    if path.is_dir():
        own = path / f"{path.resolve().name}.glb"
        files = [own, *path.glob("*.semantic.*"), path / _GIBSON_RAW]
        return bool(_HM3D.fullmatch(path.name)) or any(f.is_file() and _is_of_habitat(f) for f in files)
    folder = _HM3D.fullmatch(path.resolve().parent.name)
    if path.name.endswith(_HM3D_ENDS) or path.name == _GIBSON_RAW:
        return True
    if folder and path.name == f"{folder[1]}.glb":
        return True
    end = next((end for end in _GIBSON_ENDS if path.name.endswith(end)), None)
    if end is None:
        return False
    beside = (
        path.with_name(path.name.removesuffix(end) + kind) for kind in (".scn", ".navmesh", ".house")
    )
    scn, navmesh, house = (other.is_file() for other in beside)
    return not house and (scn or (navmesh and end == ".glb"))


def _folder_of(source: str) -> str | None:
    """In neighbours/, of what reads a file or folder; None if the core does."""
    path = Path(source)
    if (path.is_dir() or path.is_file()) and _is_of_habitat(path):
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
    mesh: LabelledMesh = read(source)
    return mesh


FORMAT = SceneFormat(
    f"by distributions in neighbours/: {', '.join(f'{name!r}' for name in (f'{b}-<number>' for b in BUILDINGS))} "
    "(buildings); files of CATT-Acoustic, ODEON, I-Simpa and Gmsh (room_programs); scenes of HM3D and Gibson, IFC "
    "models, COLLADA files (scene_formats)",
    lambda source: _is_building(source) or _folder_of(source) is not None,
    _read,
)
