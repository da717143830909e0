"""What is kept on disk of loading a large mesh (`core.io.disk_cache`): its frame with its holes closed, and its
synthetic ceiling. A scan of millions of triangles is then ready again in little more than its file takes to read.

Both are kept under a digest of what they are made of, not of a file: formats read several files. Smaller meshes are
loaded in less time than it takes to tell whether they are known.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np

from soundspaces_sim.core.io.check_cached import like, within
from soundspaces_sim.core.io.disk_cache import cached_on_disk, fingerprint
from soundspaces_sim.scene.ceiling import add_ceiling, with_cover
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.scene import Scene, is_large, scene_key

_MESH = {"vertices": "f8 V 3", "faces": "i8 F 3", "face_label": "i8 F", "notes": "u1 n"}
_COVER = {"vertices": "f8 V 3", "faces": "i8 F 3", "notes": "u1 n"}


class _Mesh(NamedTuple):
    """What loading changes of a `LabelledMesh`."""

    vertices: np.ndarray  # (V, 3) m
    faces: np.ndarray  # (F, 3)
    face_label: np.ndarray  # (F,)
    notes: np.ndarray  # (n,) bytes, a JSON list of sentences


class _Cover(NamedTuple):
    """What a ceiling adds to a mesh."""

    vertices: np.ndarray  # (V, 3) m
    faces: np.ndarray  # (F, 3) rows of `vertices`
    notes: np.ndarray  # (n,) bytes, a JSON list of sentences


def kept_mesh(
    mesh: LabelledMesh, options: tuple[object, ...], make: Callable[[], LabelledMesh]
) -> LabelledMesh:
    """`make()`, Z up and in metres, of a mesh as its file has it and `options`; what it gave before, if the mesh is
    large."""
    if not is_large(mesh.faces):
        return make()

    def packed() -> _Mesh:
        made = make()
        arrays = np.asarray(made.faces, np.int64), np.asarray(made.face_label, np.int64)
        return _Mesh(np.asarray(made.vertices, float), *arrays, _packed(made.notes))

    key = fingerprint(mesh.vertices, mesh.faces, mesh.face_label), mesh.labels, mesh.notes
    found = cached_on_disk(
        _Mesh,
        (*key, mesh.up, mesh.metre, options),
        packed,
        lambda f: _fits(f, _MESH) and within(f.face_label, -1, len(mesh.labels) - 1),
    )
    return replace(
        mesh,
        vertices=found.vertices,
        faces=found.faces,
        face_label=found.face_label,
        notes=_notes(found.notes),
        up="z",
        metre=1.0,
    )


def kept_ceiling(mesh: LabelledMesh, scene: Scene, always: bool) -> LabelledMesh:
    """`add_ceiling(mesh, scene, always)`; what it gave before, if the scene is large."""
    if not is_large(scene.faces):
        return add_ceiling(mesh, scene, always)

    def packed() -> _Cover:
        made = add_ceiling(mesh, scene, always)
        faces = np.asarray(made.faces[len(mesh.faces) :], np.int64) - len(mesh.vertices)
        return _Cover(made.vertices[len(mesh.vertices) :], faces, _packed(made.notes[len(mesh.notes) :]))

    key = scene_key(scene), scene.materials.names, always
    found = cached_on_disk(_Cover, key, packed, lambda f: _fits(f, _COVER))
    return with_cover(mesh, found.vertices, found.faces, _notes(found.notes))


def _fits(found: _Mesh | _Cover, expected: dict[str, str]) -> bool:
    return (
        like(found, expected, {})
        and within(found.faces, 0, len(found.vertices) - 1)
        and isinstance(_notes(found.notes), tuple)
    )


def _packed(notes: tuple[str, ...]) -> np.ndarray:
    return np.frombuffer(json.dumps(notes).encode(), np.uint8)


def _notes(packed: np.ndarray) -> tuple[str, ...]:
    """Raises msgspec's errors for what is no list of sentences."""
    return msgspec.json.decode(packed.tobytes(), type=tuple[str, ...])
