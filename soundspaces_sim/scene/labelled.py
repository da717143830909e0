"""What a reader of a format hands over: a mesh with labels, before materials; and what a format is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from soundspaces_sim.scene.materials import MaterialTable


@dataclass(frozen=True)
class LabelledMesh:
    """A mesh in its file's own frame. `face_label` (F,) rows of `labels`, -1 where the file says nothing.

    `up`: 'x', 'y' or 'z'; `metre`: length of the file's unit, m. Either is None where the file does not say.
    """

    vertices: np.ndarray  # (V, 3)
    faces: np.ndarray  # (F, 3)
    labels: tuple[str, ...]
    face_label: np.ndarray  # (F,)
    name: str
    notes: tuple[str, ...] = ()
    up: str | None = "z"
    metre: float | None = 1.0
    # That the file itself gives its labels.
    materials: Mapping[str, MaterialTable] = field(default_factory=dict)


def label_rows(
    of_face: np.ndarray, label_of: Mapping[int, str], labels: Iterable[str]
) -> tuple[tuple[str, ...], np.ndarray]:
    """The labels in order, and (F,) their rows for faces that have a number (F,): -1 where that has no label."""
    ordered = tuple(sorted(set(labels)))
    row = {label: i for i, label in enumerate(ordered)}
    known, inverse = np.unique(of_face, return_inverse=True)
    rows = np.array([row.get(label_of.get(int(k), ""), -1) for k in known], np.int64)
    return ordered, rows[inverse]


@dataclass(frozen=True)
class SceneFormat:
    """One kind of scene: `detects` says whether a name or path is one, `read` reads it (`SceneError`).

    `accepts`: what it is, for messages and help. `beside`: habitat's files beside it may say its frame.
    """

    accepts: str
    detects: Callable[[str], bool]
    read: Callable[[str], LabelledMesh]
    beside: bool = False
