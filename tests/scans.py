"""Meshes as scanners give them: a clean one cut into many triangles, with noise and holes."""

from __future__ import annotations

import numpy as np

import soundspaces_sim as ss
from soundspaces_sim.scene.triangles import welded


def scan_of(
    scene: ss.Scene, triangles: int, noise: float, missing: float = 0.03, seed: int = 0
) -> ss.Scene:
    """A scene cut to about so many triangles, each of its points off by a normal error of `noise` m rms along each
    axis, and a share of the triangles missing."""
    points, faces = welded(scene.corners, 6)
    row = np.arange(len(faces))
    longest = 3.7 * np.sqrt(scene.areas.sum() / triangles)
    while len(faces) < 0.9 * triangles:
        points, faces, row = _cut(points, faces, row, longest)
        longest *= 0.97
    rng = np.random.default_rng(seed)
    points = points + rng.normal(0.0, noise, points.shape)
    kept = rng.random(len(faces)) >= missing
    material, label = scene.face_material[row], scene.face_label[row]
    return ss.Scene(
        points, faces[kept], material[kept], scene.materials, scene.labels, label[kept], f"{scene.name}-scan"
    )  # fmt: skip


def _cut(
    points: np.ndarray, faces: np.ndarray, row: np.ndarray, longest: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut in the middle the longest side of every triangle that has one longer than this, until there is none; `row`
    goes with the faces. Sides are cut alike in both their triangles: there are no gaps."""
    while True:
        ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
        key = ends[..., 0] * len(points) + ends[..., 1]
        length = np.linalg.norm(points[ends[..., 0]] - points[ends[..., 1]], axis=2)
        side = length.argmax(axis=1)
        some = np.arange(len(faces))
        chosen = np.unique(key[some, side][length[some, side] > longest])
        if len(chosen) == 0:
            return points, faces, row
        first, second = np.divmod(chosen, len(points))
        middle = len(points) + np.arange(len(chosen))
        count = len(points)
        points = np.concatenate([points, 0.5 * (points[first] + points[second])])
        for _ in range(3):
            at = np.minimum(np.searchsorted(chosen, key), len(chosen) - 1)
            cut = chosen[at] == key
            face = np.flatnonzero(cut.any(axis=1))
            if len(face) == 0:
                break
            k = cut[face].argmax(axis=1)
            a, b, c = (faces[face, (k + n) % 3] for n in range(3))
            m = middle[at[face, k]]
            faces[face] = np.column_stack([a, m, c])
            faces = np.concatenate([faces, np.column_stack([m, b, c])])
            row = np.concatenate([row, row[face]])
            ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
            key = np.where(ends[..., 1] < count, ends[..., 0] * count + ends[..., 1], -1)


def unlabelled(scene: ss.Scene) -> ss.Scene:
    """Of one material."""
    return ss.Scene.from_arrays(scene.vertices, scene.faces, 0.2, 0.3, name=scene.name)


def places_of(scene: ss.Scene) -> np.ndarray:
    """(24, 3) m, here and there."""
    points = ss.make_grid(scene, 1.0).points
    points = points[np.linspace(0, len(points) - 1, 24).astype(int)]
    return np.asarray(points + np.random.default_rng(1).uniform(-0.05, 0.05, points.shape))
