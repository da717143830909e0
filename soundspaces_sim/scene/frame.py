"""From a file's frame to the scene's: Z up, metres.

What a file says of axis and unit is believed, what the user says goes before it, and where nobody says
anything both are guessed from room-like proportions, and the guess is reported with its reason.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.triangles import cross_products

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
UPS = ("y", "z")
FARTHEST = 1000.0  # m; scenes that span more are looked over for stray vertices
_STANDING = 1.8  # m, below which a mesh is no room to stand in
_HIGHEST = 60.0  # m; a guess of the unit that makes a building higher than this is doubted
_ASTRAY = 300.0  # times the extent of the middle 80 % of the vertices, from their median
_FEW = 0.01  # share of the vertices that may be astray (three at least)
_MOST = 1e9  # m, beyond which no coordinate can be meant
# Rows and signs of the file's axes that become x, y, z: rotations, so that handedness is kept.
_TURNS = {"x": ((1, 2, 0), (1, 1, 1)), "y": ((0, 2, 1), (1, -1, 1)), "z": ((0, 1, 2), (1, 1, 1))}


def to_scene_frame(mesh: LabelledMesh, up: str | None = None, unit: str | None = None) -> LabelledMesh:
    """Turn and scale a mesh; `up` and `unit` override what the file says. Raises `SceneError`.

    Faces with a corner so far off that it can only be a slip are dropped, with a note.
    """
    _check(mesh, up, unit)
    vertices, faces = mesh.vertices, mesh.faces
    notes = list(mesh.notes)
    stray = _stray_faces(vertices, faces)
    core = faces[~stray] if not stray.all() else faces
    axis = up or mesh.up
    if axis is None:
        axis, reason = _guess_up(vertices, core, UNITS[unit] if unit is not None else mesh.metre)
        notes.append(f"{axis.upper()} is taken as up: {reason} (override with up=)")
    elif up is None and axis != "z":
        notes.append(f"{axis.upper()} is taken as up: so says the file (override with up=)")
    rows, signs = _TURNS[axis]
    vertices = vertices[:, rows] * np.array(signs, float)
    metre = UNITS[unit] if unit is not None else mesh.metre
    if metre is None:
        name, reason = _guess_unit(vertices, faces, core)
        metre = UNITS[name]
        notes.append(f"lengths are taken as {name}: {reason} (override with unit=)")
    elif unit is None and metre != 1.0:
        notes.append(f"lengths are taken as {metre:.6g} m: so says the file (override with unit=)")
    vertices = vertices * metre
    keep = np.ones(len(faces), bool)
    span = np.ptp(vertices[faces].reshape(-1, 3), axis=0)
    if stray.any() and not stray.all() and span.max() > FARTHEST:
        keep = ~stray
        left = np.ptp(vertices[faces[keep]].reshape(-1, 3), axis=0)
        notes.append(
            f"{int(stray.sum())} of {len(faces)} faces were dropped: they reach {span.max():.4g} m, to corners far "
            f"from all others, which span {left[0]:.1f} x {left[1]:.1f} x {left[2]:.1f} m"
        )
    if not mesh.labels:
        notes.append(
            "the file has no labels: every face gets the default material "
            "(override with materials= and labels=)"
        )
    return replace(
        mesh,
        vertices=vertices,
        faces=faces[keep],
        face_label=mesh.face_label[keep],
        notes=tuple(notes),
        up="z",
        metre=1.0,
    )


def _check(mesh: LabelledMesh, up: str | None, unit: str | None) -> None:
    if up is not None and up not in UPS:
        raise SceneError(f"up: expected one of {', '.join(UPS)}, got {up!r}")
    if unit is not None and unit not in UNITS:
        raise SceneError(f"unit: expected one of {', '.join(UNITS)}, got {unit!r}")
    vertices, faces = mesh.vertices, mesh.faces
    if len(faces) == 0:
        raise SceneError(f"{mesh.name}: the mesh has no faces (a point cloud?); need triangles")
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise SceneError(f"{mesh.name}: vertices need three coordinates, got shape {vertices.shape}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError(
            f"{mesh.name}: face indices reach {faces.min()}..{faces.max()}, but there are {len(vertices)} "
            "vertices; is the file complete?"
        )
    largest = float(np.abs(vertices[faces]).max())
    if not np.isfinite(largest):
        raise SceneError(f"{mesh.name}: some faces have coordinates that are not finite (NaN or inf)")
    if largest * (UNITS[unit] if unit is not None else mesh.metre or UNITS["mm"]) > _MOST:
        raise SceneError(
            f"{mesh.name}: coordinates reach {largest:.3g}, which is no length of a scene in any unit; is the "
            "file damaged?"
        )


def _stray_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) whether a face has a corner that may be a slip: far beyond the middle of the vertices, and one of
    few. In any unit, so that units can be guessed without it."""
    used = np.unique(faces)
    low, middle, high = np.quantile(vertices[used], [0.1, 0.5, 0.9], axis=0, method="nearest")
    far = np.abs(vertices - middle).max(axis=1) > _ASTRAY * max(float((high - low).max()), 1e-300)
    if far[used].sum() > max(3.0, _FEW * len(used)):
        return np.zeros(len(faces), bool)
    return np.asarray(far[faces].any(axis=1))


def _guess_up(vertices: np.ndarray, faces: np.ndarray, metre: float | None) -> tuple[str, str]:
    """Which of Y and Z is up: along it the mesh is low and has one large level (floor or ceiling). An axis along
    which nobody could stand upright is not, if one could along the other. `metre`: length of the unit, if known."""
    corners = vertices[faces]
    cross = cross_products(corners)
    area = 0.5 * np.linalg.norm(cross, axis=1)
    normal = cross / np.maximum(2.0 * area, 1e-300)[:, None]
    extent = np.ptp(corners.reshape(-1, 3), axis=0)
    heights = {n: float(extent[k]) for n, k in (("y", 1), ("z", 2))}
    metres = {n: h * (metre or UNITS[_unit_of(h)]) for n, h in heights.items()}
    upright = [n for n in UPS if _STANDING <= metres[n] <= _HIGHEST]
    if len(upright) == 1 and min(metres.values()) < _STANDING:
        low = "z" if upright == ["y"] else "y"
        reason = f"one can stand in {metres[upright[0]]:.2f} m, and not in the {metres[low]:.2f} m along"
        return upright[0], f"{reason} {low.upper()}"
    score = {}
    for name, axis in (("y", 1), ("z", 2)):
        level = np.abs(normal[:, axis]) > 0.9
        height = corners[level, :, axis].mean(axis=1)
        slab = max(extent[axis] / 30.0, 1e-12)
        # The mean of equal heights may round to just below them.
        rows = np.maximum(np.floor((height - corners[..., axis].min()) / slab).astype(np.int64), 0)
        largest = np.bincount(rows, weights=area[level]).max(initial=0.0)
        across = float(np.prod(np.delete(extent, axis)))
        score[name] = largest / max(across, 1e-300) / max(float(extent[axis]), 1e-300)
    up = "y" if score["y"] > 1.2 * score["z"] else "z"
    other = "z" if up == "y" else "y"
    if max(score.values()) <= 1.2 * min(score.values()):
        return "z", "neither axis stands out, and Z up is this package's convention"
    return up, (
        f"along it the mesh is lower and more level than along {other.upper()} "
        f"(score {score[up]:.2g} against {score[other]:.2g})"
    )


def _guess_unit(vertices: np.ndarray, faces: np.ndarray, core: np.ndarray) -> tuple[str, str]:
    """Unit in which a height reads like that of a building (2 to 40 m); `core`: faces that are not astray."""
    height = float(np.ptp(vertices[np.unique(faces), 2]))
    unit = _unit_of(height)
    if height * UNITS[unit] > _HIGHEST:
        height = float(np.ptp(vertices[np.unique(core), 2]))
        unit = _unit_of(height)
    return unit, f"a height of {height:.4g} is then {height * UNITS[unit]:.2f} m"


def _unit_of(height: float) -> str:
    if height < 50.0:
        return "m"
    if height < 180.0:
        return "in"
    return "cm" if height < 1500.0 else "mm"
