"""Replica's layout: `<scene>/habitat/mesh_semantic.ply` and `info_semantic.json`. Z up, metres."""

from __future__ import annotations

from pathlib import Path

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.io.untrusted import read_json
from soundspaces_sim.scene.formats.ply import read_labelled_ply
from soundspaces_sim.scene.labelled import LabelledMesh, SceneFormat, label_rows

_MESH, _INFO = "mesh_semantic.ply", "info_semantic.json"


def find_replica(path: Path) -> Path | None:
    """The folder that holds Replica's two files, if `path` is such a scene or its habitat folder."""
    for folder in (path / "habitat", path):
        if (folder / _MESH).is_file() and (folder / _INFO).is_file():
            return folder
    return None


def load_replica(source: str) -> LabelledMesh:
    """Read a scene; each face's label is the class of its object. Raises `SceneError`."""
    folder = find_replica(Path(source))
    assert folder is not None
    name = folder.parent.name if folder.name == "habitat" else folder.name
    vertices, faces, numbers = read_labelled_ply(folder / _MESH, ("object_id",))
    if "object_id" not in numbers:
        raise SceneError(
            f"{folder / _MESH}: faces have no object_id; expected Replica's mesh_semantic.ply"
        )
    class_of = _read_classes(folder / _INFO)
    labels, rows = label_rows(numbers["object_id"], class_of, class_of.values())
    return LabelledMesh(vertices, faces, labels, rows, name)


def _read_classes(path: Path) -> dict[int, str]:
    """Class name of each object id, from `objects` and, for the others, from `id_to_label`."""
    info = read_json(path, SceneError, "description of a Replica scene")
    try:
        classes = {int(c["id"]): str(c["name"]) for c in info.get("classes", [])}
        result = {
            i: classes[int(label)]
            for i, label in enumerate(info.get("id_to_label", []))
            if int(label) in classes
        }
        for item in info.get("objects", []):
            label = item.get("class_name") or classes.get(int(item.get("class_id", -1)))
            if label:
                result[int(item["id"])] = str(label)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise SceneError(
            f"{path}: expected Replica's info_semantic.json with classes and objects ({error!r})"
        ) from error
    if not result:
        raise SceneError(f"{path}: no object has a class; expected `objects` or `id_to_label`")
    return result


FORMAT = SceneFormat(
    "a Replica scene's folder (habitat/mesh_semantic.ply and habitat/info_semantic.json)",
    lambda source: find_replica(Path(source)) is not None,
    load_replica,
)
