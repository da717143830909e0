"""Files of room programs, which a neighbour reads: without it they are refused by name, for a PLY file of I-Simpa
would lose its layers if it were read as any other."""

from __future__ import annotations

from pathlib import Path

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.extras import neighbour_hint
from soundspaces_sim.scene.formats.limits import ply_header
from soundspaces_sim.scene.labelled import LabelledMesh, SceneFormat

_SUFFIXES = (".geo", ".par", ".proj")


def _detects(source: str) -> bool:
    path = Path(source)
    kind = path.suffix.lower()
    if kind not in (*_SUFFIXES, ".ply") or not path.is_file():
        return False
    return kind in _SUFFIXES or b"element layer " in ply_header(path)


def _refuse(source: str) -> LabelledMesh:
    raise SceneError(
        f"{source}: a file of a room program; what reads it is not installed; {neighbour_hint('room_programs')}"
    )


FORMAT = SceneFormat(
    "files of CATT-Acoustic, ODEON, I-Simpa and Gmsh (by neighbours/room_programs)", _detects, _refuse
)
