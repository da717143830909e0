"""Fewer faces: quadric edge collapse (Garland & Heckbert 1997) by the fast-simplification package.

The package deletes large flat parts of few triangles whole, a floor for instance. So each connected piece
is decimated by itself, and what has lost area or extent is left as it was.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.extras import install_hint
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.triangles import areas, pieces_of, welded

_LEAST_FACES = 64  # of a piece that is worth it
_AREA_CHANGE = 0.03  # share of a piece's area,
_HOLE = 0.2  # m2, and no more than this: a hole in a wall is heard
_BOUNDS_CHANGE = 0.02  # m


def decimate_mesh(mesh: LabelledMesh, share: float) -> LabelledMesh:
    """Keep about `share` (0 to 1) of the faces of every piece that stands it.

    A new face takes the label of the nearest old face of its piece. benchmarks/RESULTS.md shows what it does
    to the sound. Raises `SceneError`.
    """
    if not 0.0 < share < 1.0:
        raise SceneError(f"decimate: expected a share of the faces above 0 and below 1, got {share}")
    try:
        import fast_simplification
    except ImportError:
        raise SceneError(
            f"decimation needs the fast-simplification package: {install_hint('decimate')}"
        ) from None
    used, faces = welded(mesh.vertices[mesh.faces], 6)
    vertices, new_faces, new_labels = [], [], []
    count = 0
    for rows in _rows_of_pieces(pieces_of(faces, len(used))):
        old_points, old = np.unique(faces[rows], return_inverse=True)
        points, piece = used[old_points], old.reshape(-1, 3)
        label = mesh.face_label[rows]
        if len(piece) >= _LEAST_FACES:
            small, fewer = fast_simplification.simplify(
                points.astype(np.float32), piece.astype(np.int32), target_reduction=1.0 - share
            )
            small = np.asarray(small, float)
            if len(fewer) and _same_extent(points, piece, small, fewer):
                _, nearest = cKDTree(points[piece].mean(axis=1)).query(small[fewer].mean(axis=1))
                points, piece, label = small, np.asarray(fewer, np.int64), label[nearest]
        vertices.append(points)
        new_faces.append(piece + count)
        new_labels.append(label)
        count += len(points)
    result = np.concatenate(new_faces)
    note = f"decimated from {len(mesh.faces):,} to {len(result):,} faces (decimate={share:g})"
    return LabelledMesh(
        np.concatenate(vertices),
        result,
        mesh.labels,
        np.concatenate(new_labels),
        mesh.name,
        (*mesh.notes, note),
    )


def _rows_of_pieces(piece: np.ndarray) -> list[np.ndarray]:
    order = np.argsort(piece, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(piece[order])) + 1)


def _same_extent(points: np.ndarray, faces: np.ndarray, small: np.ndarray, fewer: np.ndarray) -> bool:
    before, after = (float(areas(p[f]).sum()) for p, f in ((points, faces), (small, fewer)))
    a, b = points[faces].reshape(-1, 3), small[fewer].reshape(-1, 3)
    moved = np.abs([a.min(axis=0) - b.min(axis=0), a.max(axis=0) - b.max(axis=0)]).max()
    return bool(abs(after - before) <= min(_AREA_CHANGE * before, _HOLE) and moved <= _BOUNDS_CHANGE)
