"""I-Simpa's PLY: faces have a `layer_id`, and an element `layer` after them has the names. Z up, metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.formats.limits import ply_header
from soundspaces_sim.scene.formats.ply import Elements, Lists, read_labelled_ply
from soundspaces_sim.scene.labelled import LabelledMesh, SceneFormat


def read_isimpa(source: str) -> LabelledMesh:
    """Read a model; each face's label is the name of its layer. Raises `SceneError`."""
    path = Path(source)
    layers: list[str] = []

    def names(data: Elements) -> None:
        found = data["layer"]["layer_name"]
        if not isinstance(found, Lists) or found.values.dtype.kind == "f":
            raise ValueError("its layers have no names")
        layers.extend(bytes(n.astype(np.uint8)).decode("utf-8", "replace") for n in found)

    vertices, faces, numbers = read_labelled_ply(path, ("layer_id",), names)
    if "layer_id" not in numbers:
        raise SceneError(
            f"{path}: it has layers, but its faces have no layer_id; expected a PLY of I-Simpa"
        )
    labels = tuple(sorted(set(layers)))
    number = {name: i for i, name in enumerate(labels)}
    row = np.array([*(number[name] for name in layers), -1], np.int64)
    of = numbers["layer_id"]
    return LabelledMesh(
        vertices, faces, labels, row[np.where((of >= 0) & (of < len(layers)), of, -1)], path.stem
    )


def _detects(source: str) -> bool:
    path = Path(source)
    return path.suffix.lower() == ".ply" and path.is_file() and b"element layer " in ply_header(path)


FORMAT = SceneFormat("a PLY file of I-Simpa", _detects, read_isimpa)
