"""The reader of PLY files whose faces carry numbers."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.formats.ply import read_labelled_ply

_VERTICES = [(0.0, 0.0, 0.5), (2.0, 0.0, 0.5), (2.0, 1.0, 0.5), (1.0, 2.0, 0.5), (0.0, 1.0, 0.5)]
_FACES = [([0, 1, 2, 3, 4], 7), ([0, 1, 2], -3), ([], 5), ([2, 3], 4), ([4, 3, 2, 1], 1 << 20)]
_FANS = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 1, 2], [4, 3, 2], [4, 2, 1]]
_OF = [7, 7, 7, -3, 1 << 20, 1 << 20]


def _file(path: Path, order: str, faces: list[tuple[list[int], int]], end: str = "\n") -> Path:
    """Elements and properties that nobody asks for stand before, between and after the others."""
    name = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = [
        "ply", f"format {name} 1.0", "comment end_header", "element note 2", "property list ushort uchar text",
        f"element vertex {len(_VERTICES)}", "property uchar red", "property float32 x", "property double y",
        "property float z", f"element face {len(faces)}", "property short flag",
        "property list uint8 int32 vertex_indices", "property list uint float uv", "property int object_id",
        "element empty 0", "property list uchar int nothing", "end_header",
    ]  # fmt: skip
    rows: list[Any] = [("H2B", 2, 65, 66), ("H0B", 0)]
    rows += [("Bfdf", 200, *v) for v in _VERTICES]
    for i, (corners, number) in enumerate(faces):
        rows.append((f"hB{len(corners)}iI{i}fi", -i, len(corners), *corners, i, *[0.5] * i, number))
    if order:
        body = b"".join(struct.pack(order + kinds, *values) for kinds, *values in rows)
    else:
        body = end.join(" ".join(map(str, values)) for _, *values in rows).encode()
    path.write_bytes((end.join(head) + end).encode() + body)
    return path


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("order", ["", "<", ">"])
def test_any_polygons_in_any_form(tmp_path: Path, order: str, end: str) -> None:
    path = _file(tmp_path / "a.ply", order, _FACES, end)
    vertices, triangles, numbers = read_labelled_ply(path, ("object_id", "other"))
    np.testing.assert_array_equal(vertices, _VERTICES)
    np.testing.assert_array_equal(triangles, _FANS)
    assert {name: list(values) for name, values in numbers.items()} == {"object_id": _OF}


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_a_file_that_ends_early_is_told(tmp_path: Path, order: str) -> None:
    path = _file(tmp_path / "a.ply", order, _FACES)
    whole = path.read_bytes()
    last = 1 if order else len(f" {_OF[-1]}")  # of which a text would lack only digits
    for length in range(len(whole) - last):
        path.write_bytes(whole[:length])
        with pytest.raises(SceneError, match=r"a\.ply: cannot be read as a PLY mesh"):
            read_labelled_ply(path, ("object_id",))


def _declared(*lines: str, body: bytes = b"") -> bytes:
    head = ["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]
    return "\n".join(head).encode() + body


_MANY = [f"property uchar p{i}" for i in range(3000)]
BAD = {
    "more columns than bytes": (_declared("element vertex 900000", *_MANY, body=bytes(10**6)), "beyond the end"),
    "two columns of one name": (_declared("element vertex 1", "property int x", "property int x"), "two properties"),
    "two elements of one name": (_declared("element vertex 1", "element vertex 1", body=bytes(9)), "element vertex 1"),
    "an unknown kind": (_declared("element vertex 1", "property half x", body=bytes(9)), "property half x"),
    "lengths in fractions": (_declared("element face 1", "property list float int a", body=bytes(9)), "fractions"),
    "a negative length": (
        _declared("element face 1", "property list char int a", body=b"\xff" + bytes(9)), "beyond the end"),
    "a length of 2^32": (
        _declared("element face 1", "property list uint int a", body=b"\xff" * 9), "beyond the end"),
    "no vertices": (_declared("element face 1", "property list uchar int vertex_index", body=b"\0"), "no 'vertex'"),
    "no format": (b"ply\nelement vertex 0\nend_header\n", "no format"),
    "words": (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\none", "unmatched|could not"),
    "a fraction for an integer": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nend_header\n1.5", "other numbers"),
    "an endless header": (b"ply\nformat ascii 1.0\n" + b"comment x\n" * 10**5, "no end_header"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_files(tmp_path: Path, case: str) -> None:
    content, message = BAD[case]
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(SceneError, match=message):
        read_labelled_ply(tmp_path / "a.ply", ())


def test_polygons_of_all_sizes_take_no_longer_than_their_corners(tmp_path: Path) -> None:
    """A step of Python per corner or per size and face would take minutes."""
    sizes = np.arange(3, 3000)
    rng = np.random.default_rng(1)
    corners = [rng.integers(0, 3, n) for n in sizes]
    many = b"".join(struct.pack("<H", len(c)) + c.astype("<i4").tobytes() for c in corners)
    triangle = struct.pack("<H3i", 3, 0, 1, 2) * 100_000
    head = [
        "element vertex 3", "property float x", "property float y", "property float z",
        f"element face {len(sizes) + 100_000}", "property list ushort int vertex_indices",
    ]  # fmt: skip
    (tmp_path / "a.ply").write_bytes(_declared(*head, body=bytes(36) + many + triangle))
    _, triangles, _ = read_labelled_ply(tmp_path / "a.ply", ())
    assert len(triangles) == (sizes - 2).sum() + 100_000
    np.testing.assert_array_equal(triangles[-1], [0, 1, 2])
    np.testing.assert_array_equal(triangles[1:3], corners[1][[[0, 1, 2], [0, 2, 3]]])
