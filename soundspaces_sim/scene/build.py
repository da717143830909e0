"""Rectangular rooms. Metres, Z up."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import MaterialError, SceneError
from soundspaces_sim.scene.arrays import Surface, as_floats, faces_of_arrays
from soundspaces_sim.scene.materials import MaterialTable
from soundspaces_sim.scene.scene import Scene

_log = logging.getLogger(__name__)
_HIGH_ROOM, _LARGEST_ROOM = 30.0, 100.0  # m, of the smallest length: doubted, refused
#: At x = 0, x = max, y = 0, y = max, z = 0, z = max.
WALLS = ("west", "east", "south", "north", "floor", "ceiling")
_Spectrum = Mapping[Any, float]  # by frequency, Hz
_LABEL_OF_WALL = ("wall", "wall", "wall", "wall", "floor", "ceiling")


def shoebox(
    size: ArrayLike,
    absorption: Surface | _Spectrum | Mapping[str, Surface | _Spectrum] = 0.1,
    scattering: float | _Spectrum | Mapping[str, float | _Spectrum] = 0.5,
    transmission: float | _Spectrum | Mapping[str, float | _Spectrum] = 0.0,
    *,
    materials: MaterialTable | str | Path | None = None,
    name: str = "shoebox",
) -> Scene:
    """A rectangular room from the origin to `size` (3,) m.

    `absorption` is a number in [0, 1], numbers at frequencies, ``{125: 0.1, 1000: 0.4}``, or a material's name, for
    all walls or a mapping with one for each of west, east (x = 0 and x = size), south, north (y), floor and
    ceiling; `scattering` and `transmission` likewise, of walls given by numbers. `materials`: as in `load_scene`.
    Raises `SceneError` and `MaterialError`.
    """
    lengths = np.asarray(as_floats(size, f"{name}: size"))
    if lengths.shape != (3,) or not np.isfinite(lengths).all() or lengths.min(initial=np.inf) <= 0.0:
        raise SceneError(f"{name}: size: expected three positive lengths in m, got {size!r}")
    if lengths.min() > _LARGEST_ROOM:
        raise SceneError(
            f"{name}: size: {' x '.join(f'{x:g}' for x in lengths)} m is no room; expected lengths in m: "
            "divide those in cm by 100, those in mm by 1000"
        )
    if lengths.min() > _HIGH_ROOM:
        _log.warning("%s: a room of %g x %g x %g m: are the lengths in m?", name, *lengths)
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * lengths
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = np.array([[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)])
    values = tuple(
        _of_walls(value, what, name)
        for value, what in (
            (absorption, "absorption"),
            (scattering, "scattering"),
            (transmission, "transmission"),
        )
    )
    if any(isinstance(v, Mapping) for column in values for v in column):
        rows, table = _in_frequency(values, name)
        made = faces_of_arrays(vertices, faces, name=name)._replace(face_material=rows, materials=table)
    else:
        made = faces_of_arrays(vertices, faces, *values, materials=materials, name=name)
    labels = ("ceiling", "floor", "wall")
    rows = np.repeat([labels.index(label) for label in _LABEL_OF_WALL], 2)
    return Scene(made.vertices, made.faces, made.face_material, made.materials, labels, rows, name)


def _of_walls(value: Any, what: str, name: str) -> list[Any]:
    """One value per triangle of the room."""
    if not isinstance(value, str | Mapping) and np.ndim(value) > 0:
        raise MaterialError(
            f"{name}: {what}: got {len(value)} values, which may be those of walls or of octaves: expected one, "
            f"{{{', '.join(f'{wall!r}: …' for wall in WALLS)}}} or {{125: …, 250: …}}"
        )
    if isinstance(value, Mapping) and not _at_frequencies(value):
        if set(value) != set(WALLS):
            raise MaterialError(
                f"{name}: {what}: expected one value for each of {', '.join(WALLS)}, "
                f"got {', '.join(map(str, value))}"
            )
        return [value[wall] for wall in WALLS for _ in (0, 1)]
    return [value] * 12


def _at_frequencies(value: Any) -> bool:
    """Whether it is a mapping of numbers."""
    return isinstance(value, Mapping) and bool(value) and not any(isinstance(k, str) for k in value)


def _in_frequency(values: Sequence[list[Any]], name: str) -> tuple[np.ndarray, MaterialTable]:
    """(12,) rows, and the table, of coefficients of which some are given at frequencies: interpolated over the
    logarithm of frequency, constant beyond the ends."""
    given = [v for column in values for v in column if isinstance(v, Mapping)]
    try:
        axis = np.unique([float(f) for mapping in given for f in mapping])
        if not (np.isfinite(axis).all() and (axis > 0.0).all()):
            raise ValueError(f"frequencies {axis.tolist()}")
        columns = [[_at(v, axis) for v in column] for column in values]
    except (TypeError, ValueError) as error:
        raise MaterialError(
            f"{name}: expected numbers, also at frequencies above 0 Hz as in {{125: 0.1, 1000: 0.4}} ({error})"
        ) from error
    rows = np.array(columns).transpose(1, 0, 2)  # (12, 3, k)
    different, of_face = np.unique(rows.reshape(len(rows), -1), axis=0, return_inverse=True)
    coefficients = different.reshape(-1, 3, len(axis)).transpose(1, 0, 2)
    names = tuple(f"wall {i + 1}" for i in range(len(different)))
    return np.asarray(of_face).ravel(), MaterialTable(names, axis, *coefficients)


def _at(value: Any, axis: np.ndarray) -> np.ndarray:
    """(k,) a number, or numbers at frequencies, at others."""
    if not isinstance(value, Mapping):
        return np.full(len(axis), float(value))
    known = sorted((float(f), float(x)) for f, x in value.items())
    return np.interp(np.log(axis), np.log([f for f, _ in known]), [x for _, x in known])
