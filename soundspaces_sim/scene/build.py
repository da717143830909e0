"""Rectangular rooms. Metres, Z up."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import MaterialError, SceneError
from soundspaces_sim.scene.arrays import Surface, as_floats, faces_of_arrays
from soundspaces_sim.scene.materials import MaterialTable
from soundspaces_sim.scene.scene import Scene

#: At x = 0, x = max, y = 0, y = max, z = 0, z = max.
WALLS = ("west", "east", "south", "north", "floor", "ceiling")
_LABEL_OF_WALL = ("wall", "wall", "wall", "wall", "floor", "ceiling")


def shoebox(
    size: ArrayLike,
    absorption: Surface | Mapping[str, Surface] = 0.1,
    scattering: float | Mapping[str, float] = 0.5,
    transmission: float | Mapping[str, float] = 0.0,
    *,
    materials: MaterialTable | str | Path | None = None,
    name: str = "shoebox",
) -> Scene:
    """A rectangular room from the origin to `size` (3,) m.

    `absorption` is a number in [0, 1] or a material's name, for all walls or a mapping with one for each of
    west, east (x = 0 and x = size), south, north (y), floor and ceiling; `scattering` and `transmission`
    likewise, of walls given by numbers. `materials`: as in `load_scene`. Raises `SceneError` and
    `MaterialError`.
    """
    lengths = np.asarray(as_floats(size, f"{name}: size"))
    if lengths.shape != (3,) or not np.isfinite(lengths).all() or lengths.min(initial=np.inf) <= 0.0:
        raise SceneError(f"{name}: size: expected three positive lengths in m, got {size!r}")
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * lengths
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = np.array([[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)])
    values = (
        _of_walls(value, what, name)
        for value, what in (
            (absorption, "absorption"),
            (scattering, "scattering"),
            (transmission, "transmission"),
        )
    )
    made = faces_of_arrays(vertices, faces, *values, materials=materials, name=name)
    labels = ("ceiling", "floor", "wall")
    rows = np.repeat([labels.index(label) for label in _LABEL_OF_WALL], 2)
    return Scene(made.vertices, made.faces, made.face_material, made.materials, labels, rows, name)


def _of_walls(value: Any, what: str, name: str) -> list[Any]:
    """One value per triangle of the room."""
    if isinstance(value, Mapping):
        if set(value) != set(WALLS):
            raise MaterialError(
                f"{name}: {what}: expected one value for each of {', '.join(WALLS)}, "
                f"got {', '.join(map(str, value))}"
            )
        return [value[wall] for wall in WALLS for _ in (0, 1)]
    return [value] * 12
