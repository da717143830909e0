"""Fewer faces: quadric edge collapse (Garland & Heckbert 1997) by the fast-simplification package."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from soundspaces_sim.errors import SceneError
from soundspaces_sim.loaders.labelled import LabelledMesh


def decimate_mesh(mesh: LabelledMesh, share: float) -> LabelledMesh:
    """Keep about `share` (0 to 1) of the faces; each takes the label of the nearest old face.

    benchmarks/RESULTS.md shows what it does to the sound. Raises `SceneError`.
    """
    if not 0.0 < share < 1.0:
        raise SceneError(f"decimate: expected a share of the faces above 0 and below 1, got {share}")
    try:
        import fast_simplification
    except ImportError:
        raise SceneError(
            "decimation needs the fast-simplification package: `pip install soundspaces-sim[decimate]`"
        ) from None
    used, inverse = np.unique(
        np.round(mesh.vertices[mesh.faces].reshape(-1, 3), 6), axis=0, return_inverse=True
    )
    vertices, faces = fast_simplification.simplify(
        used.astype(np.float32), inverse.reshape(-1, 3).astype(np.int32), target_reduction=1.0 - share
    )
    if len(faces) == 0:
        raise SceneError(f"{mesh.name}: nothing is left of {len(mesh.faces)} faces; use a larger share")
    old = mesh.vertices[mesh.faces].mean(axis=1)
    _, nearest = cKDTree(old).query(np.asarray(vertices, float)[faces].mean(axis=1))
    note = f"decimated from {len(mesh.faces):,} to {len(faces):,} faces (decimate={share:g})"
    return LabelledMesh(
        np.asarray(vertices, float), np.asarray(faces, np.int64), mesh.labels, mesh.face_label[nearest],
        mesh.name, (*mesh.notes, note),
    )  # fmt: skip
