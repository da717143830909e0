"""Gibson, as habitat has it: `Name.glb` with `Name.navmesh`, and, with the objects of 3DSceneGraph,
`Name_semantic.ply` and `Name.scn`; or as its authors have it: a folder with `mesh_z_up.obj`. Z up, metres.

Faces of the PLY carry `object_id`, and the JSON of the .scn says of which class (`class_`) the object is, which is
its label; 0 is no object. 3DSceneGraph has furniture and things alone: walls, floors and ceilings have no label.
Read from habitat-sim: `GibsonSemanticScene.cpp`, `tools/npz2scn.py` and `Datatool.cpp`, which turns Y up to Z up
"to match .glb", `Asset.cpp` and `gibson_semantic.scene_dataset_config.json` (a .glb is Z up, although glTF says Y
up), `GenericSemanticMeshData.cpp` (a semantic PLY is Z up); and GibsonEnv's `gibson/data/README.md` (raw folders).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from soundspaces_sim import SceneError
from soundspaces_sim.parts import (
    LabelledMesh,
    SceneFormat,
    find_gibson,
    label_rows,
    read_json,
    read_labelled_ply,
    read_mesh,
    read_obj,
)

_RAW = "mesh_z_up.obj"
_PLY, _SCN = "_semantic.ply", ".scn"
_NOTE = (
    "Z is taken as up: so is a .glb with habitat's .scn or .navmesh, although glTF says Y up "
    "(override with up=)"
)


def load_gibson(ply: Path) -> LabelledMesh:
    """Read a scene with semantics; each face's label is the class of its object. Raises `SceneError`."""
    name = ply.name.removesuffix(_PLY)
    vertices, faces, numbers = read_labelled_ply(ply, ("object_id",))
    if "object_id" not in numbers:
        raise SceneError(f"{ply}: faces have no object_id; expected habitat's {ply.name}")
    class_of = _read_classes(ply.with_name(name + _SCN))
    labels, rows = label_rows(numbers["object_id"], class_of, class_of.values())
    return LabelledMesh(vertices, faces, labels, rows, name)


def _read_classes(path: Path) -> Mapping[int, str]:
    """Class of each object by its number."""
    scn = read_json(path, SceneError, "description of a Gibson scene")
    try:
        found = {int(item["id"]): str(item["class_"]) for item in scn["objects"]}
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise SceneError(
            f"{path}: expected Gibson's objects, each with id and class_ ({error!r:.200})"
        ) from error
    if not found:
        raise SceneError(f"{path}: no object has a class; is the file complete?")
    return found


def _read(source: str) -> LabelledMesh:
    found = find_gibson(Path(source))
    assert found is not None
    if found.name == _RAW:
        mesh = read_obj(str(found))
        name = found.resolve().parent.name or mesh.name
        return replace(mesh, name=name, up="z", metre=1.0 if mesh.metre is None else mesh.metre)
    if found.name.endswith(_PLY):
        return load_gibson(found)
    mesh = read_mesh(str(found))
    return replace(mesh, up="z", notes=(_NOTE, *mesh.notes))


FORMAT = SceneFormat(
    "a Gibson scene's .glb with its .navmesh or with .scn and _semantic.ply, or a folder with mesh_z_up.obj",
    lambda source: find_gibson(Path(source)) is not None,
    _read,
)
