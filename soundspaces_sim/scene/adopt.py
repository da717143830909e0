"""Meshes that live in memory as trimesh objects."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

# Names that programs make up where nobody gave one.
_NO_NAME = re.compile(
    r"(default.*|material_.*|(material|texture|mesh|geometry|node|object|group|model|scene|untitled|unnamed|none"
    r"|world|root|lambert|phong|initialshadinggroup)[\s._#-]*\d*)",
    re.IGNORECASE | re.DOTALL,
)


def parts_of(mesh: Any, node_names: bool = False) -> list[tuple[np.ndarray, np.ndarray, str]]:
    """(vertices, faces, label or '') of the meshes of a `trimesh.Trimesh` or, in place, of a `trimesh.Scene`.

    The label is the name of a mesh's material; with `node_names`, of its node where it has no material.
    """
    import trimesh  # here, because it takes long, and few scenes need it

    placed: list[tuple[np.ndarray, Any, Any]]
    if isinstance(mesh, trimesh.Scene):
        placed = [(*mesh.graph[node], node) for node in mesh.graph.nodes_geometry]
    else:
        placed = [(np.eye(4), "", "")]
    found = []
    for transform, name, node in placed:
        own = mesh.geometry[name] if isinstance(mesh, trimesh.Scene) else mesh
        if not isinstance(own, trimesh.Trimesh) or len(own.faces) == 0:
            continue
        label = _label(own, [node, name] if node_names else [])
        if not np.array_equal(transform, np.eye(4)):  # a copy of a scan takes a second
            own = own.copy().apply_transform(transform)
        found.append((np.asarray(own.vertices), np.asarray(own.faces), label))
    return found


def _label(mesh: Any, node_names: list[Any]) -> str:
    names = [getattr(getattr(mesh.visual, "material", None), "name", None), *node_names]
    return next((str(n) for n in names if n and not is_made_up(str(n))), "")


def is_made_up(name: str) -> bool:
    """Whether a name is one that programs give where nobody gave one (``Object.12``, ``material_0``)."""
    return _NO_NAME.fullmatch(name) is not None


def concatenate_parts(
    parts: list[tuple[np.ndarray, np.ndarray, str]],
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...], np.ndarray]:
    """Vertices, faces, labels and label rows of parts (vertices, faces, label or ''), at least one."""
    labels = tuple(sorted({label for _, _, label in parts if label}))
    if len(parts) == 1:
        vertices, faces, _ = parts[0]
        return (
            np.asarray(vertices, float),
            np.asarray(faces, np.int64),
            labels,
            np.full(len(faces), len(labels) - 1),
        )
    row = {label: i for i, label in enumerate(labels)}
    offsets = np.cumsum([0] + [len(vertices) for vertices, _, _ in parts])
    return (
        np.concatenate([np.asarray(v, float) for v, _, _ in parts]),
        np.concatenate([np.asarray(f) + o for (_, f, _), o in zip(parts, offsets, strict=False)]),
        labels,
        np.concatenate([np.full(len(f), row.get(label, -1)) for _, f, label in parts]),
    )
