"""What a loader hands over: a mesh with labels, before materials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LabelledMesh:
    """Metres, Z up. `face_label` (F,) rows of `labels`, -1 where the file says nothing."""

    vertices: np.ndarray  # (V, 3)
    faces: np.ndarray  # (F, 3)
    labels: tuple[str, ...]
    face_label: np.ndarray  # (F,)
    name: str
    notes: tuple[str, ...] = ()
