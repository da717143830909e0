"""PLY files whose faces carry numbers (object ids): any polygons, any order of properties.

Greg Turk, The PLY Polygon File Format (1994). Time and memory grow as a file's bytes do, whatever its header
declares.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.formats.limits import PLY_HEADER, check_ply, open_mesh
from soundspaces_sim.scene.triangles import check_mesh

_KINDS = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float": "f4",
    "double": "f8",
    "float32": "f4",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDICES = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class Lists:
    """A property with a list in each row: row i has `values[start[i]:start[i + 1]]`."""

    start: np.ndarray
    values: np.ndarray

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self.values[a:b] for a, b in pairwise(self.start))


Element = Mapping[str, np.ndarray | Lists]
Elements = Mapping[str, Element]


class _Property(NamedTuple):
    name: str
    kind: np.dtype
    of_length: np.dtype | None  # of the lengths of lists


class _Declared(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]


def read_labelled_ply(
    path: Path, properties: tuple[str, ...], also: Callable[[Elements], None] | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Vertices (V, 3), triangles (F, 3), and the named integers (F,) of each triangle's face.

    Of `properties`, those that the file has; polygons are cut into fans. `also` is given the file's elements.
    Raises `SceneError`.
    """
    try:
        with open_mesh(path) as file:
            check_ply(path, file)
            data = _elements(file.read())
        vertex, face = data["vertex"], data["face"]
        if also is not None:
            also(data)
        vertices = np.stack([np.asarray(vertex[axis], float) for axis in "xyz"], axis=1)
        polygons = next((found for n in _INDICES if isinstance(found := face.get(n), Lists)), None)
        if polygons is None:
            raise SceneError(f"{path}: faces have none of the lists {', '.join(_INDICES)}")
        triangles, of_face = _fans(polygons)
        numbers = {p: np.asarray(face[p]).astype(np.int64)[of_face] for p in properties if p in face}
    except SceneError:
        raise
    except OSError as error:
        raise SceneError(f"{path}: cannot read this file ({error.strerror or error})") from error
    except KeyError as error:
        raise SceneError(f"{path}: cannot be read as a PLY mesh (it has no {error})") from error
    except (ValueError, TypeError) as error:
        raise SceneError(
            f"{path}: cannot be read as a PLY mesh ({error}); is the file complete?"
        ) from error
    if len(triangles) == 0:
        raise SceneError(f"{path}: the mesh has no faces (a point cloud?); need triangles")
    check_mesh(vertices, triangles, str(path), "; is the file complete?")
    return vertices, triangles, numbers


def _elements(data: bytes) -> Elements:
    """All that a file holds. Raises `ValueError`."""
    end = PLY_HEADER.search(data)
    if end is None or not data.startswith(b"ply"):
        raise ValueError("it has no header")
    order, declared = _header(data[: end.start()].decode("ascii", "replace"))
    if order == "ascii":
        units = _numbers(data[end.end() :])
    else:
        units = np.frombuffer(data, np.uint8, offset=end.end())
    found: dict[str, Element] = {}
    at = 0
    for element in declared:
        found[element.name], at = _element(element, units, at, _ORDERS[order])
    return found


def _header(text: str) -> tuple[str, list[_Declared]]:
    form, declared = "", list[_Declared]()
    for line in text.splitlines()[1:]:
        match line.split():
            case ["format", str(kind), "1.0"] if kind in _ORDERS:
                form = kind
            case ["element", name, rows] if rows.isdecimal() and name not in {d.name for d in declared}:
                declared.append(_Declared(name, int(rows), []))
            case ["property", kind, name] if kind in _KINDS and declared:
                declared[-1].properties.append(_Property(name, np.dtype(_KINDS[kind]), None))
            case ["property", "list", count, kind, name] if {count, kind} <= _KINDS.keys() and declared:
                kinds = np.dtype(_KINDS[kind]), np.dtype(_KINDS[count])
                declared[-1].properties.append(_Property(name, *kinds))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header has the line {line[:80]!r}")
    if not form:
        raise ValueError("its header names no format")
    for element in declared:
        names = [p.name for p in element.properties]
        if len(set(names)) < len(names):
            raise ValueError(f"its element {element.name} has two properties of one name")
        if any(p.of_length is not None and p.of_length.kind == "f" for p in element.properties):
            raise ValueError(f"its element {element.name} counts in fractions")
    return form, declared


def _numbers(text: bytes) -> np.ndarray:
    """The numbers of a text, (n,) float64."""
    if not text.strip():
        return np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # older versions of NumPy warn where newer ones raise
        try:
            return np.fromstring(text, sep=" ")
        except DeprecationWarning as problem:
            raise ValueError(str(problem)) from problem


def _element(element: _Declared, units: np.ndarray, at: int, order: str) -> tuple[Element, int]:
    """An element's columns, and where it ends. `units`: bytes of a binary file, numbers of a text."""
    least = sum(_size(p.kind if p.of_length is None else p.of_length, units) for p in element.properties)
    if at + element.rows * least > len(units):
        raise ValueError(f"its element {element.name} goes beyond the end of the file")
    return _equal_rows(element, units, at, order) or _any_rows(element, units, at, order)


def _equal_rows(
    element: _Declared, units: np.ndarray, at: int, order: str
) -> tuple[Element, int] | None:
    """An element whose lists are all as long as those of the first row; None if they are not."""
    length, columns = 0, list[tuple[int, int]]()
    for _, kind, count in element.properties:
        number = 1
        if count is not None:
            if at + length + _size(count, units) > len(units):
                return None
            number = int(_column(units, at + length, 1, 1, 0, count, order)[0, 0]) if element.rows else 0
            length += _size(count, units)
        columns.append((length, number))
        length += number * _size(kind, units)
        if number < 0 or at + element.rows * length > len(units):
            return None
    found: dict[str, np.ndarray | Lists] = {}
    for (name, kind, count), (offset, number) in zip(element.properties, columns, strict=True):
        if count is not None:
            before = at + offset - _size(count, units)
            if (_column(units, before, element.rows, 1, length, count, order) != number).any():
                return None
        values = _column(units, at + offset, element.rows, number, length, kind, order)
        found[name] = (
            values[:, 0]
            if count is None
            else Lists(number * np.arange(element.rows + 1), values.ravel())
        )
    return found, at + element.rows * length


def _any_rows(element: _Declared, units: np.ndarray, at: int, order: str) -> tuple[Element, int]:
    """An element whose lists are of any lengths, row by row."""
    # Each list with what stands before it: numbers of a fixed size, and its length.
    before, sizes, counts = 0, list[tuple[int, int]](), list[np.dtype]()
    where: list[tuple[int, int]] = []  # of a column: how many lists are before it, and what after those
    for _, kind, count in element.properties:
        where.append((len(sizes), before))
        if count is None:
            before += _size(kind, units)
        else:
            sizes.append((before, _size(kind, units)))
            counts.append(count)
            before = 0
    ends = np.empty((len(sizes) + 1, element.rows), np.int64)  # of the row before, and of each list
    lengths = np.empty((len(sizes), element.rows), np.int64)
    for row in range(element.rows):
        ends[0, row] = at
        for k, (fixed, size) in enumerate(sizes):
            width = _size(counts[k], units)
            at += fixed
            number = (
                int(_column(units, at, 1, 1, 0, counts[k], order)[0, 0])
                if at + width <= len(units)
                else -1
            )
            at += width + number * size
            if number < 0 or at > len(units):
                raise ValueError(
                    f"row {row} of its element {element.name} goes beyond the end of the file"
                )
            ends[k + 1, row], lengths[k, row] = at, number
        at += before
    if at > len(units):
        raise ValueError(f"its element {element.name} goes beyond the end of the file")
    found: dict[str, np.ndarray | Lists] = {}
    for (name, kind, count), (k, fixed) in zip(element.properties, where, strict=True):
        if count is None:
            found[name] = _gathered(units, ends[k] + fixed, kind, order)
        else:
            start = np.concatenate([[0], np.cumsum(lengths[k])])
            first = ends[k + 1] - lengths[k] * _size(kind, units) - start[:-1] * _size(kind, units)
            places = np.repeat(first, lengths[k]) + np.arange(start[-1]) * _size(kind, units)
            found[name] = Lists(start, _gathered(units, places, kind, order))
    return found, at


def _size(kind: np.dtype, units: np.ndarray) -> int:
    return kind.itemsize if units.dtype == np.uint8 else 1


def _column(
    units: np.ndarray, at: int, rows: int, number: int, length: int, kind: np.dtype, order: str
) -> np.ndarray:
    """(rows, number) of a kind, from `at` on, `length` units from row to row. They lie within `units`."""
    stored = np.dtype(order + kind.str[1:]) if order else units.dtype
    strides = length * units.itemsize, stored.itemsize
    if rows * number == 0:
        return np.empty((rows, number), kind)
    found = np.ndarray((rows, number), stored, units, at * units.itemsize, strides)
    return _of_kind(found, kind)


def _gathered(units: np.ndarray, places: np.ndarray, kind: np.dtype, order: str) -> np.ndarray:
    """The numbers of a kind at these places, which lie within `units`."""
    if not order:
        return _of_kind(units[places], kind)
    found = np.empty((len(places), kind.itemsize), np.uint8)
    for byte in range(kind.itemsize):
        found[:, byte] = units[places + byte]
    return _of_kind(found.view(order + kind.str[1:])[:, 0], kind)


def _of_kind(values: np.ndarray, kind: np.dtype) -> np.ndarray:
    """Values as numbers of a kind. Raises `ValueError` for a text that has others."""
    if kind.kind in "iu" and values.dtype == float:
        limits = np.iinfo(kind)
        if not ((values >= limits.min) & (values <= limits.max) & (values == np.floor(values))).all():
            raise ValueError(f"it has other numbers where its header says {kind.name}")
    return values.astype(kind)


def _fans(polygons: Lists) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (F, 3) of polygons, and the row of the polygon of each."""
    number = np.maximum(np.diff(polygons.start) - 2, 0)
    face = np.repeat(np.arange(len(number)), number)
    corner = np.arange(len(face)) - np.repeat(np.cumsum(number) - number, number)
    first = polygons.start[face]
    places = np.stack([first, first + corner + 1, first + corner + 2], axis=1)
    return polygons.values[places].astype(np.int64), face
