"""PLY files whose faces carry numbers (object ids): any polygons, any order of properties."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import plyfile

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.formats.limits import check_ply, open_mesh, ply_header

_TEXT = re.compile(rb"^format[ \t]+ascii", re.MULTILINE)
_INDICES = ("vertex_indices", "vertex_index")


def read_labelled_ply(
    path: Path, properties: tuple[str, ...], also: Callable[[Any], None] | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Vertices (V, 3), triangles (F, 3), and the named integers (F,) of each triangle's face.

    Of `properties`, those that the file has; polygons are cut into fans. `also` is given the file's elements.
    Raises `SceneError`.
    """
    try:
        with open_mesh(path) as file:
            check_ply(path, file)
            # of a text plyfile makes a text file, which it does not close
            text = _TEXT.search(ply_header(path)) is not None
            data = _read(io.BytesIO(file.read()) if text else file)
        vertex, face = data["vertex"], data["face"]
        if also is not None:
            also(data)
        vertices = np.stack([np.asarray(vertex[axis], float) for axis in "xyz"], axis=1)
        name = next(n for n in _INDICES if n in face)
        triangles, of_face = _fans(face[name])
        numbers = {p: np.asarray(face[p]).astype(np.int64)[of_face] for p in properties if p in face}
    except SceneError:
        raise
    except OSError as error:
        raise SceneError(f"{path}: cannot read this file ({error.strerror or error})") from error
    except StopIteration:
        raise SceneError(f"{path}: faces have none of the lists {', '.join(_INDICES)}") from None
    except Exception as error:  # the parser raises whatever it meets in a damaged file
        raise SceneError(
            f"{path}: cannot be read as a PLY mesh ({error}); is the file complete?"
        ) from error
    if len(triangles) == 0:
        raise SceneError(f"{path}: the mesh has no faces (a point cloud?); need triangles")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise SceneError(
            f"{path}: face indices reach {triangles.min()}..{triangles.max()}, but there are "
            f"{len(vertices)} vertices; is the file complete?"
        )
    return vertices, triangles, numbers


def _read(file: BinaryIO) -> Any:
    """The file; all faces of one size are read at once, others one by one."""
    for corners in (3, 4):
        for name in _INDICES:
            try:
                return plyfile.PlyData.read(file, known_list_len={"face": {name: corners}})
            except (plyfile.PlyParseError, ValueError, KeyError):
                file.seek(0)
    return plyfile.PlyData.read(file)


def _fans(polygons: Any) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (F, 3) of polygons, and the row of the polygon of each."""
    rows = np.asarray(polygons)
    if rows.ndim == 2 and rows.dtype != object:
        lists = {rows.shape[1]: (np.arange(len(rows)), rows)}
    else:
        sizes = np.array([len(p) for p in polygons], np.int64)
        lists = {
            int(n): (where, np.stack([polygons[i] for i in where]))
            for n in np.unique(sizes)
            for where in [np.flatnonzero(sizes == n)]
        }
    triangles, faces = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
    for n, (where, corners) in lists.items():
        for i in range(1, n - 1):
            triangles.append(corners[:, [0, i, i + 1]].astype(np.int64))
            faces.append(where)
    triangle, face = np.concatenate(triangles), np.concatenate(faces)
    order = np.argsort(face, kind="stable")
    return triangle[order], face[order]
