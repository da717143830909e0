"""A mesh of plane polygons, as room-acoustic programs write them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from soundspaces_room_programs.polygons import MOST_CORNERS, triangulate
from soundspaces_sim import MaterialTable, SceneError
from soundspaces_sim.parts import LabelledMesh

# Cutting polygons takes a time that grows with the squares of their corners: so many of these are cut, and so many
# more for each byte of the file.
_MOST_SQUARES, _SQUARES_PER_BYTE = 2_000_000, 20
_FARTHEST = 1e12  # in any unit, beyond which no coordinate can be meant


class Polygon(NamedTuple):
    """`where`: for messages; `corners`: numbers of points; `label`: its material's name or its own, or ""."""

    where: str
    corners: Sequence[int]
    label: str


def read_text_model(path: Path, content: bytes) -> str:
    """The text of a model: UTF-8, or else the code page of old Windows programs. Raises `SceneError`."""
    if b"\0" in content:
        raise SceneError(f"{path}: expected a text file, got one with zero bytes")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def mesh_of_polygons(
    path: Path,
    size: int,
    points: Mapping[int, Sequence[float]],
    polygons: Iterable[Polygon],
    metre: float,
    materials: Mapping[str, MaterialTable] | None = None,
    notes: tuple[str, ...] = (),
) -> LabelledMesh:
    """A labelled mesh, Z up, of a file of `size` bytes. Raises `SceneError` with the polygon that is wrong."""
    polygons = _bounded(path, size, polygons)
    if not polygons:
        raise SceneError(f"{path}: no surface is defined in it")
    numbers = {n: row for row, n in enumerate(points)}
    vertices = np.array(list(points.values()), float).reshape(-1, 3)
    if not (np.abs(vertices) < _FARTHEST).all():
        raise SceneError(
            f"{path}: some points have coordinates that are not finite, or beyond {_FARTHEST:g}"
        )
    labels = tuple(sorted({p.label for p in polygons} - {""}))
    row_of = {"": -1} | {label: row for row, label in enumerate(labels)}
    faces, rows = [], []
    for polygon in polygons:
        where = f"{path}: {polygon.where}"
        if len(polygon.corners) > MOST_CORNERS:
            raise SceneError(
                f"{where}: expected at most {MOST_CORNERS} corners, got {len(polygon.corners)}"
            )
        lost = next((n for n in polygon.corners if n not in numbers), None)
        if lost is not None:
            raise SceneError(f"{where}: there is no point {lost}")
        corners = _from_the_first([numbers[n] for n in polygon.corners])
        triangles = corners[triangulate(vertices[corners], where)]
        faces.append(triangles)
        rows.append(np.full(len(triangles), row_of[polygon.label]))
    return LabelledMesh(
        vertices,
        np.concatenate(faces),
        labels,
        np.concatenate(rows),
        path.stem,
        notes,
        metre=metre,
        materials=materials or {},
    )


def _bounded(path: Path, size: int, polygons: Iterable[Polygon]) -> list[Polygon]:
    """The polygons, which are taken only as long as they are not too much."""
    out, squares = [], 0
    for polygon in polygons:
        squares += len(polygon.corners) ** 2
        if squares > _MOST_SQUARES + _SQUARES_PER_BYTE * size:
            raise SceneError(
                f"{path}: its surfaces have more corners than a file of {size:,} bytes should need"
            )
        out.append(polygon)
    return out


def _from_the_first(corners: list[int]) -> np.ndarray:
    """The corners from their lowest number on, towards the lower of its neighbours: a plane's front and its back
    are then cut into the same triangles, of which a scene takes one each."""
    if len(corners) < 3:
        return np.array(corners, np.int64)
    at = corners.index(min(corners))
    turned = np.array(corners[at:] + corners[:at])
    return turned if turned[1] <= turned[-1] else np.roll(turned[::-1], 1)
