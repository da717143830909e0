"""I-Simpa's PLY, as its ExportPly writes it: big-endian, layers after the faces."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from tests.rooms import box, table

_LAYERS = ["brick", "Wooden floor", "ceiling", "unused"]


def _isimpa(path: Path, text: bool = False, ids: bool = True) -> Path:
    """A room of 4 x 3 x 2.5 m: walls, floor, ceiling in three of four layers."""
    scene = box((4.0, 3.0, 2.5), table(0.1, 0.1))
    layer_of = np.repeat([0, 0, 0, 0, 1, 2], 2).tolist()
    head = [
        "ply", f"format {'ascii' if text else 'binary_big_endian'} 1.0", "element vertex 8", "property float x",
        "property float y", "property float z", "element face 12", "property list uchar int vertex_indices",
        f"property int {'layer_id' if ids else 'other'}", f"element layer {len(_LAYERS)}",
        "property list uchar uchar layer_name", "end_header",
    ]  # fmt: skip
    rows = [struct.pack(">3f", *v) for v in scene.vertices]
    lines = [" ".join(map(str, v)) for v in scene.vertices]
    for corners, layer in zip(scene.faces.tolist(), layer_of, strict=True):
        rows.append(struct.pack(">B4i", 3, *corners, layer))
        lines.append(" ".join(map(str, (3, *corners, layer))))
    for name in _LAYERS:
        rows.append(bytes([len(name)]) + name.encode())
        lines.append(" ".join(map(str, (len(name), *name.encode()))))
    body = "\n".join(lines).encode() + b"\n" if text else b"".join(rows)
    path.write_bytes("\n".join(head).encode() + b"\n" + body)
    return path


@pytest.mark.parametrize("text", [False, True])
def test_layers_are_labels(tmp_path: Path, text: bool) -> None:
    """Z up and metres, as I-Simpa has it, though the room would be guessed to lie in the same way."""
    scene = ss.load_scene(_isimpa(tmp_path / "room.ply", text))
    names = [scene.materials.names[k] for k in scene.face_material]
    assert names == ["brick"] * 8 + ["wood-thick"] * 2 + ["acoustic-tile"] * 2
    np.testing.assert_allclose(scene.bounds, np.array([[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]]))
    assert not any("is taken as up" in note or "lengths are" in note for note in scene.notes)


def test_damaged_layers(tmp_path: Path) -> None:
    with pytest.raises(ss.SceneError, match="faces have no layer_id"):
        ss.load_scene(_isimpa(tmp_path / "room.ply", ids=False))
    whole = _isimpa(tmp_path / "room.ply").read_bytes()
    for length in range(0, len(whole) - 1, 7):
        (tmp_path / "cut.ply").write_bytes(whole[:length])
        with pytest.raises(ss.SceneError, match=r"cut\.ply"):
            ss.load_scene(tmp_path / "cut.ply")
