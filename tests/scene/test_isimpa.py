"""I-Simpa's PLY, as its ExportPly writes it: big-endian, layers after the faces; and its projects."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable
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


def project(
    path: Path, older: bool = False, change: Callable[[dict[str, bytes]], object] = lambda _: None
) -> Path:
    """The same room as a project: three groups, two with materials of the user, in the older form of 1.1.5 or in
    that of 1.3.4. `change` alters its files."""
    scene = box((4.0, 3.0, 2.5), table(0.1, 0.1))
    vertices = scene.vertices.astype("<f4").tobytes()
    parts, after = [], 8 + 16 + len(vertices)
    for count in (4, 8):  # groups of the mesh, which are not those of the tree
        faces = scene.faces[:4] if count == 4 else scene.faces[4:]
        body = b"".join(struct.pack("<3I", *f) + b"\xff" * 20 for f in faces)
        after += 16 + 256 + len(body)
        last = after if count == 4 else 0
        parts.append(
            struct.pack("<HHII", 1, 0xFB, 0, last)
            + b"part".ljust(256, b"\0")
            + struct.pack("<I", count)
            + body
        )
    mesh = struct.pack("<II", 1, 2) + struct.pack("<HHIII", 0, 0xFB, 0, 24 + len(vertices), 8) + vertices

    def finfo(faces: list[tuple[int, int]]) -> bytes:
        return struct.pack(f"<{1 + 2 * len(faces)}I", len(faces), *np.array(faces).ravel())

    def band(f: int, absorbed: float, spread: float) -> str:
        if older:
            return f'<bfreq name="{f}" absorb="{absorbed}" diffusion="{spread}" affaiblissement="15,0" loi="2"/>'.replace(
                "0.", "0,"
            )
        each = {"absorb": absorbed, "diffusion": spread, "transmission": 0, "affaiblissement": 0}
        return (
            f'<p name="{f}">' + "".join(f'<p name="{k}" value="{v}"/>' for k, v in each.items()) + "</p>"
        )

    groups = (("walls", "a", 100), ("walls", "b", 101), ("carpet", "c", 21))
    xml = '<?xml version="1.0"?><projet><donnees><sgroupes name="Surfaces">' + "".join(
        f'<gr name="{name}" facesFile="{file}.finfo"><p name="idmat" value="{number}"/></gr>'
        for name, file, number in groups
    ) + "</sgroupes></donnees><gr name='Limits' facesFile='x.finfo'/><materiaux>"  # fmt: skip
    for number, absorbed in ((100, 0.25), (101, 0.5)):
        bands = band(4000, 0.75, 0.5) + band(250, absorbed, 0.125)  # from above, as genuine ones are
        xml += f'<usermat name="M{number}"><materiau idmateriau="{number}">{bands}</materiau></usermat>'
    files = {
        "instance1/sceneMesh.bin": mesh + b"".join(parts),
        "instance1/projet_config.xml": (xml + "</materiaux></projet>").encode(),
        "instance1/a.finfo": finfo([(0, 0), (0, 1), (0, 2), (0, 3)]),
        "instance1/b.finfo": finfo([(1, 0), (1, 1), (1, 2), (1, 3)]),
        "instance1/c.finfo": finfo([(1, 4), (1, 5)]),
    }
    change(files)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


@pytest.mark.parametrize("older", [False, True])
def test_a_project_is_its_room_with_its_materials(tmp_path: Path, older: bool) -> None:
    """Faces, groups and coefficients; what the library has is not in the file, and goes by its label."""
    scene = ss.load_scene(project(tmp_path / "room.proj", older), ceiling=False)
    expected = box((4.0, 3.0, 2.5), table(0.1, 0.1))
    np.testing.assert_array_equal(scene.corners, expected.corners)
    named = [scene.labels[row] if row >= 0 else "" for row in scene.face_label]
    assert named == ["walls"] * 4 + ["walls 1"] * 4 + ["carpet"] * 2 + [""] * 2
    absorption, scattering, transmission = scene.materials.in_bands((210.0, 300.0, 3900.0, 4100.0))[:3]
    for faces, absorbed in ((slice(0, 4), 0.25), (slice(4, 8), 0.5)):
        own = scene.face_material[faces]
        np.testing.assert_allclose(absorption[own][:, 0], absorbed, atol=0.02)
        np.testing.assert_allclose(absorption[own][:, 2], 0.75, atol=0.02)
        np.testing.assert_allclose(scattering[own][:, 0], 0.125, atol=0.02)
        assert not transmission[own].any()
    assert {scene.materials.names[k] for k in scene.face_material[8:10]} == {"carpet"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.pop("instance1/sceneMesh.bin"), "one sceneMesh.bin"),
        (lambda f: f.pop("instance1/b.finfo"), "file of faces 'b.finfo'"),
        (lambda f: f.update({"instance1/b.finfo": struct.pack("<3I", 1, 1, 99)}), "does not have"),
        (lambda f: f.update({"instance1/b.finfo": struct.pack("<3I", 1, 9, 0)}), "does not have"),
        (
            lambda f: f.update({"instance1/sceneMesh.bin": f["instance1/sceneMesh.bin"][:200]}),
            "too early",
        ),
        (lambda f: f.update({"instance1/projet_config.xml": b"<projet>"}), "projet_config.xml"),
        (lambda f: f.update({"instance1/x.xml": bytes(10**8)}), "unpack to"),
        (lambda f: f.update({k: v.replace(b'"0.25"', b'"1.25"') for k, v in f.items()}), "M100"),
        (lambda f: f.update({k: v.replace(b'"0.25"', b'"x"') for k, v in f.items()}), "M100"),
    ],
)
def test_damaged_projects(
    tmp_path: Path, change: Callable[[dict[str, bytes]], object], message: str
) -> None:
    with pytest.raises(ss.SceneError, match=message):
        ss.load_scene(project(tmp_path / "room.proj", change=change))


def test_a_mesh_that_goes_in_a_circle_ends(tmp_path: Path) -> None:
    def turn(files: dict[str, bytes]) -> None:
        mesh = bytearray(files["instance1/sceneMesh.bin"])
        mesh[16:20] = struct.pack("<I", 8)  # the part after the vertices is the vertices
        files["instance1/sceneMesh.bin"] = bytes(mesh)

    with pytest.raises(ss.SceneError, match="circle"):
        ss.load_scene(project(tmp_path / "room.proj", change=turn))
