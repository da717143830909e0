"""COLLADA (.dae) by the pycollada package: its unit and up axis are honoured, its materials are labels.

Where a file has no `<up_axis>` the standard's default holds, Y up (COLLADA 1.4.1, `asset`).
"""

from __future__ import annotations

import math
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from soundspaces_sim import SceneError
from soundspaces_sim.parts import (
    LabelledMesh,
    SceneFormat,
    check_corners,
    concatenate_parts,
    file_size,
    install_hint,
    open_mesh,
    parse_xml,
    total_in_place,
    xml_elements,
)


def read_dae(source: str) -> LabelledMesh:
    """Read a COLLADA file. Raises `SceneError`."""
    path = Path(source)
    try:
        import collada
    except ImportError:
        raise SceneError(
            f"{path}: COLLADA files need the pycollada package: {install_hint('dae')}"
        ) from None
    ignored = [collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pycollada uses numpy.matrix
            with open_mesh(path) as file:
                _check(path, file)
                document = collada.Collada(file, ignore=ignored)
            parts = list(_parts(document))
        asset = document.assetInfo
        unit = asset.xmlnode.find(document.tag("unit")) if asset.xmlnode is not None else None
        metre = float(unit.get("meter", 1.0)) if unit is not None else None
        up = str(asset.upaxis)[0].lower()
    except SceneError:
        raise
    except Exception as error:  # the parsers raise whatever they meet in a damaged file
        raise SceneError(f"{path}: cannot be read as a COLLADA file ({error!r})") from error
    if not parts:
        raise SceneError(f"{path}: the mesh has no faces (a point cloud?); need triangles")
    if metre is not None and not (math.isfinite(metre) and metre > 0.0):
        raise SceneError(f"{path}: <unit meter=…> must be a positive number, got {metre}")
    return LabelledMesh(*concatenate_parts(parts), path.stem, up=up, metre=metre)


def _check(path: Path, file: BinaryIO) -> None:
    """Raise `SceneError` if a COLLADA file is an archive, or places its parts too often."""
    if zipfile.is_zipfile(file):
        raise SceneError(f"{path}: this is an archive; unpack it and give the .dae in it")
    file.seek(0)
    content = file.read()
    file.seek(0)
    root = parse_xml(path, content, "a COLLADA file", len(content))
    key = {
        node: f"#{node.get('id')}" if node.get("id") else f"at {i}"
        for i, node in enumerate(xml_elements(root, "node"))
    }
    parts = {
        f"#{g.get('id')}": sum(len(p.text or "") // 2 for p in xml_elements(g, "p"))
        for g in xml_elements(root, "geometry")
    }
    children: dict[str, list[str]] = {}
    weight: dict[str, int] = {}
    for node, name in key.items():
        own = children.setdefault(name, [])
        own += [key[child] for child in node if child in key]
        own += [
            str(child.get("url")) for child in node if child.tag.rpartition("}")[2] == "instance_node"
        ]
        placed = [c for c in node if c.tag.rpartition("}")[2] == "instance_geometry"]
        weight[name] = weight.get(name, 1) + sum(parts.get(str(c.get("url")), 0) for c in placed)
    roots = [key[node] for scene in xml_elements(root, "visual_scene") for node in scene if node in key]
    check_corners(path, total_in_place(path, children, weight, roots), file_size(file))


def _parts(document: Any) -> Iterator[tuple[np.ndarray, np.ndarray, str]]:
    """(vertices, faces, label) of every primitive of the scene, in place."""
    if document.scene is None:
        return
    for geometry in document.scene.objects("geometry"):
        for primitive in geometry.primitives():
            if hasattr(primitive, "triangleset"):
                primitive = primitive.triangleset()
            if not hasattr(primitive, "vertex_index") or primitive.vertex_index is None:
                continue
            corners = np.asarray(primitive.vertex_index)
            if corners.ndim != 2 or corners.shape[1] != 3 or len(corners) == 0:
                continue  # lines
            used, faces = np.unique(corners, return_inverse=True)
            material = primitive.material
            label = getattr(material, "name", None) or getattr(material, "id", None) or ""
            yield np.asarray(primitive.vertex)[used], faces.reshape(-1, 3), str(label)


FORMAT = SceneFormat(
    "a COLLADA file (.dae)",
    lambda source: Path(source).suffix.lower() == ".dae" and Path(source).is_file(),
    read_dae,
    beside=True,
)
