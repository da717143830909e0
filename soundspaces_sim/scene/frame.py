"""From a file's frame to the scene's: Z up, metres.

What a file says of axis and unit is believed, what the user says goes before it, and where nobody says anything
both are guessed: up is the axis along which the mesh has more floor to walk on under ceilings of rooms, and with
what stands on it; the unit is one in which these ceilings are as high as rooms' are. The guess is reported with its
reason, and warned of where another one is about as good.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.heightfield import too_large
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.triangles import (
    boxes,
    check_mesh,
    corners_of,
    pieces_of,
    used_rows,
    welded_faces,
)
from soundspaces_sim.scene.walkable import find_floors

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
UPS = ("y", "z")
FARTHEST = 1000.0  # m; scenes that span more are looked over for stray vertices
_STANDING = 1.8  # m, below which a mesh is no room to stand in
DOUBT = "in doubt: "  # begins notes that are warned of
_HIGHEST = 60.0  # m; a guess of the unit that makes a building higher than this is doubted
_CEILINGS = (1.8, 2.3, 5.0)  # m: none, as in most rooms from .. to; beyond, the fewer the higher
_OPEN = 0.8  # what floor without a ceiling counts
_ALIKE, _EQUAL = 1.4, 1.05  # ratios of scores of axes that are warned of, and that decide nothing
_ROOMS = (2.0, 6.0)  # m, heights of rooms for the unit
_COLUMNS = 40_000  # of the floor that is looked at
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
    core = faces[~stray] if stray.any() and not stray.all() else faces
    axis, clear = up or mesh.up, None
    if axis is None:
        axis, clear, note = _guess_up(vertices, core, UNITS[unit] if unit is not None else mesh.metre)
        notes.append(note)
    elif up is None and axis != "z":
        notes.append(f"{axis.upper()} is taken as up: so says the file (override with up=)")
    vertices = _turned(vertices, axis)
    metre = UNITS[unit] if unit is not None else mesh.metre
    if metre is None:
        name, note = _guess_unit(vertices, faces, core, clear)
        metre = UNITS[name]
        notes.append(note)
    elif unit is None and metre != 1.0:
        notes.append(f"lengths are taken as {metre:.6g} m: so says the file (override with unit=)")
    vertices = vertices * metre
    keep: np.ndarray | slice = slice(None)
    span = np.ptp(vertices[used_rows(faces, len(vertices))], axis=0)
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
    check_mesh(vertices, faces, mesh.name, "; is the file complete?")
    largest = float(np.abs(vertices[used_rows(faces, len(vertices))]).max())
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
    used = used_rows(faces, len(vertices))
    low, middle, high = np.quantile(vertices[used], [0.1, 0.5, 0.9], axis=0, method="nearest")
    far = np.abs(vertices - middle).max(axis=1) > _ASTRAY * max(float((high - low).max()), 1e-300)
    count = int(far[used].sum())
    if count == 0 or count > max(3.0, _FEW * len(used)):
        return np.zeros(len(faces), bool)
    return np.asarray(far[faces].any(axis=1))


def _turned(vertices: np.ndarray, axis: str) -> np.ndarray:
    """The vertices with an axis of theirs up."""
    rows, signs = _TURNS[axis]
    return vertices[:, rows] * np.array(signs, float)


def _guess_up(
    vertices: np.ndarray, faces: np.ndarray, metre: float | None
) -> tuple[str, np.ndarray | None, str]:
    """Which of Y and Z is up; the free heights with that axis up, if they were measured; and a note. An axis along
    which nobody could stand upright is not, if one could along the other. `metre`: length of the unit, if known."""
    extent = np.ptp(vertices[used_rows(faces, len(vertices))], axis=0)
    heights = {n: float(extent[k]) for n, k in (("y", 1), ("z", 2))}
    metres = {n: h * (metre or UNITS[_unit_of(h)]) for n, h in heights.items()}
    upright = [n for n in UPS if _STANDING <= metres[n] <= _HIGHEST]
    if len(upright) == 1 and min(metres.values()) < _STANDING:
        low = "z" if upright == ["y"] else "y"
        reason = f"one can stand in {metres[upright[0]]:.2f} m, and not in the {metres[low]:.2f} m along"
        return upright[0], None, f"{_up_note(upright[0])}: {reason} {low.upper()} (override with up=)"
    points, welded = welded_faces(vertices, faces, 5)
    piece, score, clear = pieces_of(welded, len(points)), {}, {}
    for name in UPS:
        own = corners_of(_turned(vertices, name), faces)
        clear[name], cell = _clear_heights(own, extent[list(_TURNS[name][0])])
        length = metre or UNITS[_unit_of(heights[name])]
        area = float(_like_rooms(clear[name] * length).sum()) * (cell * length) ** 2
        score[name] = area * (1.0 + _resting(own, piece))
    up = "y" if score["y"] > _EQUAL * score["z"] else "z"
    other = "z" if up == "y" else "y"
    reason = (
        f"there is {score[up]:.3g} m² of floor under ceilings of rooms, weighted, and {score[other]:.3g} with "
        f"{other.upper()} up"
    )
    if score[up] < _ALIKE * score[other] or score[up] == 0.0:
        return up, clear[up], f"{DOUBT}{_up_note(up)}, but {reason}: set --up (up=)"
    return up, clear[up], f"{_up_note(up)}: {reason} (override with up=)"


def _up_note(axis: str) -> str:
    return f"{axis.upper()} is taken as up"


def _clear_heights(corners: np.ndarray, extent: np.ndarray) -> tuple[np.ndarray, float]:
    """Free heights above cells of floor, inf where no ceiling is, and the size of a cell, in the file's unit, as
    the corners' `extent` (3,). Roofs are no floor: what has no ceiling counts where nothing is below."""
    cell = float(np.sqrt(extent[0] * extent[1] / _COLUMNS))
    if cell <= 0.0 or too_large(corners, cell):
        return np.empty(0), cell
    columns = find_floors(corners, cell, 0.1 * float(extent[2]), cell, 0.03 * float(extent[2]))
    column = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
    first = columns.start[column] == np.arange(len(column))
    return columns.clear[columns.stand & (first | ~columns.sky)].astype(float), cell


def _like_rooms(clear: np.ndarray) -> np.ndarray:
    """How much a floor counts under so many m of free air."""
    none, low, high = _CEILINGS
    share = np.clip((clear - none) / (low - none), 0.0, 1.0) * high / np.maximum(clear, high)
    return np.where(np.isinf(clear), _OPEN, share)


def _resting(corners: np.ndarray, piece: np.ndarray) -> float:
    """Share of the pieces (F,) beside the largest whose feet are at the height at which most are: furniture on a
    floor."""
    count = int(piece.max()) + 1
    if count < 4:
        return 0.0
    z = corners[..., 2]
    foot, top = np.full(count, np.inf), np.full(count, -np.inf)
    low, high = boxes(corners)
    np.minimum.at(foot, piece, low[:, 2])
    np.maximum.at(top, piece, high[:, 2])
    height = float(np.ptp(z))
    feet = foot[top - foot < 0.8 * height]
    slab = np.rint(feet / max(0.02 * height, 1e-300)).astype(np.int64)
    return float(np.bincount(slab - slab.min()).max() / len(slab)) if len(slab) >= 3 else 0.0


def _guess_unit(
    vertices: np.ndarray, faces: np.ndarray, core: np.ndarray, clear: np.ndarray | None
) -> tuple[str, str]:
    """Unit in which a height reads like that of a building (2 to 40 m) and, if there is one, its rooms are as high
    as most are; and a note. `core`: faces that are not astray; `clear`: free heights above them, if known."""
    height = float(np.ptp(vertices[used_rows(faces, len(vertices)), 2]))
    unit = _unit_of(height)
    extent = np.ptp(vertices[used_rows(core, len(vertices))], axis=0)
    if height * UNITS[unit] > _HIGHEST:
        height = float(extent[2])
        unit = _unit_of(height)
    if clear is None:
        clear, _ = _clear_heights(corners_of(vertices, core), extent)
    clear = clear[np.isfinite(clear)]
    room = float(np.median(clear)) if len(clear) else height
    good = [n for n, metre in UNITS.items() if _ROOMS[0] <= room * metre <= _ROOMS[1]]
    if unit != "m" and unit not in good and good:
        unit = good[0]
    reason = f"a height of {height:.4g} is then {height * UNITS[unit]:.2f} m"
    if unit in good:
        return unit, f"lengths are taken as {unit}: {reason} (override with unit=)"
    others = ", ".join(f"{room * UNITS[n]:.2f} m in {n}" for n in good)
    return unit, (
        f"{DOUBT}lengths are taken as {unit}: {reason}, and rooms are {room * UNITS[unit]:.2f} m high"
        + (f" (they would be {others})" if others else "")
        + "; set --unit (unit=)"
    )


def _unit_of(height: float) -> str:
    if height < 50.0:
        return "m"
    if height < 180.0:
        return "in"
    return "cm" if height < 1500.0 else "mm"
