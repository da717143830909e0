"""HM3D and Gibson as habitat-sim has them: small scenes whose faces' labels are known, and damaged ones."""

from __future__ import annotations

import io
import json
import logging
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from soundspaces_scene_formats import hm3d as hm3d_format
from soundspaces_scene_formats.hm3d import _middles, _nearest

import soundspaces_sim as ss
from soundspaces_sim.scene.load import find_scenes
from tests.scene.test_formats import _QUADS, _V, ROOM, _names, _ply

#: The texels of a picture of 4 x 2 by row, each for one side of the room; 0: for none.
FIRST: list[list[int]] = [[0xFF0001, 0x0A0B0C, 0x7F0080, 0x00FE00], [0x123456, 0, 0x010203, 0xFFFFFF]]
#: Greys, which a JPEG of one colour keeps to the bit: luma is the grey, and both differences are 0 (T.871).
SECOND = 0x404040
#: Of each side: number of the picture, column and row.
PLACE = {
    "floor": (0, 0, 0), "wall_w": (0, 1, 0), "wall_e": (0, 0, 1), "wall_s": (0, 2, 0), "wall_n": (1, 0, 0),
    "ceiling": (0, 3, 1),
}  # fmt: skip
ROWS = """HM3D Semantic Annotations
1,FF0001,"floor",0
2,0A0B0C,"wall",0

3,123456,"wall",-1
4,7F0080,"wall",0
5,404040,"wall, painted",1
6,FFFFFF,"ceiling",1
7,c,"radiator",11
"""


def _image(texels: np.ndarray, kind: str, **options: Any) -> bytes:
    out = io.BytesIO()
    Image.fromarray(texels).save(out, kind, **options)
    return out.getvalue()


def _texels(colors: list[list[int]]) -> np.ndarray:
    value = np.array(colors)
    return np.stack([value >> 16, value >> 8 & 255, value & 255], axis=-1).astype(np.uint8)


def _pictures() -> list[bytes]:
    grey = np.full((16, 16, 3), SECOND & 255, np.uint8)
    return [_image(_texels(FIRST), "PNG"), _image(grey, "JPEG", quality=90)]


def _glb(
    path: Path, pictures: list[bytes] | None = None, change: Any = None, whole: bool = False
) -> Path:
    """The room as HM3D has it: Z up, a vertex for each corner, below a node that moves it by (1, 2, 3) and halves
    it, and a mesh of a material for each picture. `whole`: texture coordinates in 16 bits."""
    pictures = _pictures() if pictures is None else pictures
    data, views, accessors, primitives = b"", [], [], []

    def view(content: bytes) -> int:
        nonlocal data
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(content)})
        data += content + b"\0" * (-len(content) % 4)
        return len(views) - 1

    def accessor(values: np.ndarray, kind: str, component: int, **more: Any) -> int:
        item = {
            "bufferView": view(values.tobytes()),
            "componentType": component,
            "count": len(values),
            "type": kind,
        }
        accessors.append({**item, **more})
        return len(accessors) - 1

    for number in range(2):
        sides = [name for name in _QUADS if PLACE[name][0] == number]
        corners = np.concatenate([2.0 * _V[[_QUADS[s][k] for k in (0, 1, 2, 0, 2, 3)]] for s in sides])
        size = np.array([4, 2]) if number == 0 else np.array([1, 1])
        around = np.array([[-0.4, -0.4], [0.4, -0.4], [0.1, 0.4]] * 2) + 0.5
        uv = np.concatenate([(np.array(PLACE[s][1:]) + around) / size for s in sides])
        places = (
            accessor(np.rint(uv * 65535).astype("<u2"), "VEC2", 5123, normalized=True)
            if whole
            else accessor(uv.astype("<f4"), "VEC2", 5126)
        )
        primitives.append({
            "attributes": {"POSITION": accessor(corners.astype("<f4"), "VEC3", 5126), "TEXCOORD_0": places},
            "indices": accessor(np.arange(len(corners), dtype="<u4"), "SCALAR", 5125), "material": number,
        })  # fmt: skip
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1, 2], "translation": [1, 2, 3], "scale": [0.5, 0.5, 0.5]}, {"mesh": 0}, {"mesh": 1}],
        "meshes": [{"name": "chunk", "primitives": [p]} for p in primitives],
        "materials": [{"name": "chunk", "pbrMetallicRoughness": {"baseColorTexture": {"index": 1 - n}}} for n in range(2)],
        "textures": [{"source": 1}, {"source": 0}],
        "images": [
            {"bufferView": view(p), "mimeType": f"image/{'png' if p[1:4] == b'PNG' else 'jpeg'}"} for p in pictures
        ],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(data)}],
    }  # fmt: skip
    if change is not None:
        change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(
        struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data))
        + struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    )  # fmt: skip
    return path


PNG = _pictures()[0]


def declaring(png: bytes, size: int) -> bytes:
    """The PNG with another size in its head, whose check is right."""
    head = png[12:16] + struct.pack(">II", size, size) + png[24:29]
    return png[:12] + head + struct.pack(">I", zlib.crc32(head)) + png[33:]


def hm3d(folder: Path, rows: str = ROWS, **options: Any) -> Path:
    """A scene's folder, `00800-Room`."""
    scene = folder / "00800-Room"
    _glb(scene / "Room.semantic.glb", **options)
    _glb(scene / "Room.basis.glb")
    (scene / "Room.semantic.txt").write_text(rows)
    return scene


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("name", ["", "Room.semantic.glb", "Room.semantic.txt", "Room.basis.glb"])
def test_hm3d(tmp_path: Path, name: str, whole: bool) -> None:
    """The label of each side by its texel, in place: Z up although glTF says Y up."""
    scene = ss.load_scene(hm3d(tmp_path, whole=whole) / name)
    np.testing.assert_allclose(scene.bounds, [[1.0, 2.0, 3.0], [5.0, 5.0, 5.5]])
    assert _names(scene) == ROOM and scene.name == "Room"
    centre = scene.vertices[scene.faces].mean(axis=1)
    for label, axis, value in (("floor", 2, 3.0), ("ceiling", 2, 5.5), ("wall, painted", 1, 5.0)):
        there = np.abs(centre[:, axis] - value) < 1e-6
        assert there.sum() == 2
        assert {scene.labels[r] for r in scene.face_label[there]} == {label}
        assert (scene.face_label == scene.labels.index(label)).sum() == 2
    assert not any("no row" in note for note in scene.notes)
    assert any("Z is taken as up" in note for note in scene.notes)


def test_colours_without_a_row_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The floor of 12 m2 is painted black, and the wall of 7.5 m2 in a colour of no row, of 59 m2 in all."""
    first = [[0, *FIRST[0][1:]], [0xABCDEF, *FIRST[1][1:]]]
    pictures = [_image(_texels(first), "PNG"), _pictures()[1]]
    with caplog.at_level(logging.WARNING):
        scene = ss.load_scene(hm3d(tmp_path, pictures=pictures), ceiling=False)
    note = next(n for n in scene.notes if "no row" in n)
    assert "4 faces (33.1 % of the area)" in note and "Room.semantic.txt" in note
    assert "2 faces (20.3 % of the area) black" in note and "1 other colours: ABCDEF" in note
    assert _names(scene) == {"default": 19.5, "gypsum-board": 27.5, "acoustic-tile": 12.0}
    assert "4 faces (19.5 m2, 33.1 % of the area) have no material" in caplog.text


def test_nearest_texel() -> None:
    """Rows from above, columns from the left, a texel's own half-open square, the edge beyond the picture."""
    texels = _texels(FIRST)
    places = [
        [0.0, 0.0],
        [0.2499, 0.4999],
        [0.25, 0.0],
        [0.0, 0.5],
        [0.99, 0.99],
        [1.0, 1.0],
        [-3.0, 7.0],
        [9.0, -1.0],
    ]
    expected = [
        FIRST[0][0],
        FIRST[0][0],
        FIRST[0][1],
        FIRST[1][0],
        FIRST[1][3],
        FIRST[1][3],
        FIRST[1][0],
        FIRST[0][3],
    ]
    assert _nearest(texels, np.array(places)).tolist() == expected
    whole = np.array([[0, 0], [65535, 0], [0, 65535]], np.uint16)
    np.testing.assert_allclose(_middles(whole, np.array([[0, 1, 2]])), [[1 / 3, 1 / 3]])
    with pytest.raises(ValueError, match="not finite"):
        _middles(np.array([[0.0, np.nan]] * 3), np.array([[0, 1, 2]]))


@pytest.mark.parametrize("mode", ["P", "RGBA", "RGB"])
def test_pictures_of_other_modes(tmp_path: Path, mode: str) -> None:
    """Palettes and transparency: the colours are the same."""
    out = io.BytesIO()
    Image.fromarray(_texels(FIRST)).convert(mode, palette=Image.Palette.ADAPTIVE).save(out, "PNG")
    scene = ss.load_scene(hm3d(tmp_path, pictures=[out.getvalue(), _pictures()[1]]))
    assert _names(scene) == ROOM


def test_other_sets_of_texture_coordinates(tmp_path: Path) -> None:
    def second(tree: Any) -> None:
        for material, mesh in zip(tree["materials"], tree["meshes"], strict=True):
            material["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = 3
            attributes = mesh["primitives"][0]["attributes"]
            attributes["TEXCOORD_3"] = attributes.pop("TEXCOORD_0")

    assert _names(ss.load_scene(hm3d(tmp_path, change=second))) == ROOM


def test_a_picture_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "00800-Room").mkdir()
    (tmp_path / "00800-Room" / "first.png").write_bytes(_pictures()[0])
    scene = hm3d(tmp_path, change=lambda tree: tree["images"].__setitem__(0, {"uri": "first.png"}))
    assert _names(ss.load_scene(scene)) == ROOM


def test_a_colour_that_stands_twice(tmp_path: Path) -> None:
    """The last row holds, as in habitat-sim, and that is told."""
    scene = ss.load_scene(hm3d(tmp_path, rows=ROWS + '8,FF0001,"rug",0\n'))
    assert _names(scene) == {**{k: v for k, v in ROOM.items() if k != "carpet"}, "carpet-heavy": 12.0}
    assert any("1 colours stand for several categories" in n and "FF0001" in n for n in scene.notes)


def test_hm3d_without_semantics(tmp_path: Path) -> None:
    """The mesh alone, Z up; a picture in Basis is not opened."""

    def basis(tree: Any) -> None:
        tree["extensionsUsed"] = tree["extensionsRequired"] = ["KHR_texture_basisu"]
        tree["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": n}}} for n in range(2)]

    for name in ("Room.glb", "Room.basis.glb"):
        scene = tmp_path / name / "00801-Room"
        _glb(scene / name, pictures=[b"\xabKTX 20\xbb"] * 2, change=basis)
        for path in (scene, scene / name):
            found = ss.load_scene(path)
            np.testing.assert_allclose(found.bounds, [[1.0, 2.0, 3.0], [5.0, 5.0, 5.5]])
            assert not found.labels or set(found.labels) == {"chunk"}
            assert any("Z is taken as up" in note for note in found.notes)


def test_folders_of_scenes(tmp_path: Path) -> None:
    hm3d(tmp_path / "hm3d")
    gibson(tmp_path / "gibson")
    assert find_scenes([str(tmp_path / "hm3d")]) == [str(tmp_path / "hm3d" / "00800-Room")]
    assert find_scenes([str(tmp_path / "gibson")]) == [str(tmp_path / "gibson" / "Room.glb")]


def _extension(name: str) -> Any:
    return lambda tree: tree.update(extensionsRequired=[name])


def _draco(tree: Any) -> None:
    tree["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}


def _meshopt(tree: Any) -> None:
    tree["buffers"].append(
        {"byteLength": 4, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}
    )


def _quantized(tree: Any) -> None:
    tree["accessors"][1].update(componentType=5122, normalized=True)


def _set(key: str, value: Any) -> Any:
    return lambda tree: tree.update({key: value})


def _color(value: Any) -> Any:
    return lambda tree: tree["materials"][0]["pbrMetallicRoughness"].update(baseColorTexture=value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_draco, r"mesh is compressed \(KHR_draco_mesh_compression\)"),
        (_meshopt, r"mesh is compressed \(EXT_meshopt_compression\)"),
        (_extension("KHR_meshopt_compression"), "mesh is compressed"),
        (_quantized, "KHR_mesh_quantization"),
    ],
)
def test_compressed_meshes_are_refused(tmp_path: Path, change: Any, message: str) -> None:
    """With and without semantics, and as any other glTF."""
    scene = hm3d(tmp_path, change=change)
    _glb(scene / "Room.glb", change=change)
    other = _glb(tmp_path / "other.glb", change=change)
    plain = _glb(tmp_path / "00801-Room" / "Room.basis.glb", change=change).parent
    for path in (scene, other, plain):
        with pytest.raises(ss.SceneError, match=message) as error:
            ss.load_scene(path)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("materials", [{}, {}]), "no material has a picture"),
        (_set("textures", [{"extensions": {"KHR_texture_basisu": {"source": 0}}}] * 2), "KHR_texture_basisu"),
        (_set("textures", [{"source": "a"}] * 2), "expected a number"),
        (_set("images", [{"uri": "../secret.png"}] * 2), "not a file beside it"),
        (_set("images", [{"uri": "https://example.org/a.png"}] * 2), "not a file beside it"),
        (_set("images", [{"uri": "nowhere.png"}] * 2), "cannot read this picture"),
        (_set("images", [{}] * 2), "is nowhere"),
        (_set("images", []), "cannot be read"),
        (_color({"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}), "KHR_texture_transform"),
        (_color({"index": 9}), "cannot be read"),
        (_color(3), "cannot be read"),
    ],
)  # fmt: skip
def test_pictures_that_cannot_be(tmp_path: Path, change: Any, message: str) -> None:
    with pytest.raises(ss.SceneError, match=message) as error:
        ss.load_scene(hm3d(tmp_path, change=change))
    assert "\n" not in str(error.value)


def test_damaged_and_large_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    png, jpeg = _pictures()
    bomb, huge = (declaring(png, n) for n in (30000, 8200))  # Pillow's own limit is between
    many = jpeg[:-2] + jpeg[jpeg.index(b"\xff\xda") : -2] * 200 + jpeg[-2:]
    grey16 = _image(np.zeros((4, 4), np.uint16), "PNG")
    for n, (picture, message) in enumerate((
        (png[:40], "cannot be read|damaged"), (png[:-30], "cannot be read"), (b"GIF89a" + b"\0" * 40, "neither PNG nor JPEG"),
        (bomb, "more than 67,108,864 pixels"), (huge, "more than 67,108,864 pixels"), (many, "scans"),
        (grey16, "expected eight bits"), (b"", "neither PNG nor JPEG"),
    )):  # fmt: skip
        with pytest.raises(ss.SceneError, match=message) as error:
            ss.load_scene(hm3d(tmp_path / str(n), pictures=[picture, jpeg]))
        assert "\n" not in str(error.value)
    monkeypatch.setattr(hm3d_format, "MOST_IN_ALL", 8 + 255)
    monkeypatch.setattr(hm3d_format, "_A_BYTE", 0)
    with pytest.raises(ss.SceneError, match="pictures of 264 pixels in all, 263 is the limit"):
        ss.load_scene(hm3d(tmp_path / "all"))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("", "an empty file"),
        ('1,FF0001,"floor",0\n', "expected 'HM3D Semantic Annotations' in the first line"),
        ("HM3D Semantic Annotations\n", "no colour has a category"),
        ('HM3D Semantic Annotations\n1,FF0001,"floor"\n', "line 2"),
        ('HM3D Semantic Annotations\n\n1,GG0001,"floor",0\n', "line 3"),
        ('HM3D Semantic Annotations\n1,1FF0001,"floor",0\n', "line 2"),
        ('HM3D Semantic Annotations\n1,-1,"floor",0\n', "line 2"),
        ("HM3D Semantic Annotations\n1,FF0001,floor,0\n", "line 2"),
        ('HM3D Semantic Annotations\nnan,FF0001,"floor",0\n', "line 2"),
        ('HM3D Semantic Annotations\n1,FF0001,"floor",inf\n', "line 2"),
        (f'HM3D Semantic Annotations\n{"9" * 5000},FF0001,"floor",0\n', "line 2"),
    ],
)
def test_bad_rows(tmp_path: Path, rows: str, message: str) -> None:
    with pytest.raises(ss.SceneError, match=message):
        ss.load_scene(hm3d(tmp_path, rows=rows))


@pytest.mark.parametrize("gone", ["Room.semantic.txt", "Room.semantic.glb"])
def test_one_of_the_two_is_missing(tmp_path: Path, gone: str) -> None:
    """Labels that are half there are not silently left out."""
    scene = hm3d(tmp_path)
    (scene / gone).unlink()
    for path in (scene, scene / "Room.basis.glb"):
        with pytest.raises(ss.SceneError, match=f"{gone} is missing beside it"):
            ss.load_scene(path)


def test_without_pillow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = hm3d(tmp_path)
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(ss.SceneError, match=r"need the pillow package.*\[hm3d\]"):
        ss.load_scene(scene)


SCN = {
    "objects": [{"class_": "sofa", "id": 1, "size": [1, 2, 3]}, {"class_": "bed", "id": 2}],
    "rooms": [],
}


def gibson(folder: Path, scn: object = SCN) -> Path:
    """`Room.glb`, `.navmesh`, `.scn` and `_semantic.ply` in a folder; returns the .glb."""
    ids = {"floor": 1, "ceiling": 2, "wall_w": 1, "wall_e": 7}
    numbers = {"object_id": ("ushort", [ids.get(name, 0) for name in _QUADS])}
    _ply(folder / "Room_semantic.ply", list(_QUADS.values()), numbers, extra=True)
    (folder / "Room.scn").write_text(scn if isinstance(scn, str) else json.dumps(scn))
    (folder / "Room.navmesh").touch()
    return _glb(folder / "Room.glb")


@pytest.mark.parametrize("name", ["Room.glb", "Room.scn", "Room_semantic.ply"])
def test_gibson(tmp_path: Path, name: str) -> None:
    """Sofa 12 + 7.5 m2, bed 12 m2; 0 and what has no row have no label."""
    gibson(tmp_path)
    scene = ss.load_scene(tmp_path / name, ceiling=False)
    np.testing.assert_allclose(scene.bounds[1], [4.0, 3.0, 2.5])
    area = {n: scene.areas[scene.face_label == i].sum() for i, n in enumerate(("bed", "sofa"))}
    assert scene.labels == ("bed", "sofa") and area == pytest.approx({"bed": 12.0, "sofa": 19.5})
    assert any("27.5 m2" in note and "have no material" in note for note in scene.notes)


@pytest.mark.parametrize(
    "gone", [(".scn",), ("_semantic.ply",), (".scn", "_semantic.ply"), (".navmesh", "_semantic.ply")]
)
def test_gibson_without_semantics(tmp_path: Path, gone: tuple[str, ...]) -> None:
    """The .glb is Z up, as with semantics; a folder of its name is the scene as well."""
    glb = gibson(tmp_path / "Room")
    for end in gone:
        (tmp_path / "Room" / f"Room{end}").unlink()
    for path in (glb, tmp_path / "Room"):
        scene = ss.load_scene(path)
        np.testing.assert_allclose(scene.bounds, [[1.0, 2.0, 3.0], [5.0, 5.0, 5.5]])
        assert any("Z is taken as up" in note for note in scene.notes)
    np.testing.assert_allclose(np.ptp(ss.load_scene(glb, up="y").bounds, axis=0), [4.0, 2.5, 3.0])


def test_a_glb_alone_is_y_up(tmp_path: Path) -> None:
    scene = ss.load_scene(_glb(tmp_path / "Room.glb"))
    np.testing.assert_allclose(np.ptp(scene.bounds, axis=0), [4.0, 2.5, 3.0])


def test_gibson_raw(tmp_path: Path) -> None:
    """A tall shaft, 2 x 2 x 9 m, whose axis could not be guessed as Z."""
    box = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [9.0, 2.0, 9.0]])
    (tmp_path / "Allensville").mkdir()
    box.export(tmp_path / "Allensville" / "mesh_z_up.obj")
    for path in (tmp_path / "Allensville", tmp_path / "Allensville" / "mesh_z_up.obj"):
        scene = ss.load_scene(path)
        assert scene.name == "Allensville" and not any("taken as" in note for note in scene.notes)
        np.testing.assert_allclose(scene.bounds[1], [9.0, 2.0, 9.0])


@pytest.mark.parametrize(
    ("scn", "message"),
    [
        ("{", "not valid JSON"),
        ('{"objects": [{"id": NaN, "class_": "a"}]}', "NaN is not JSON"),
        ([], "expected Gibson's objects"),
        ({"objects": 3}, "expected Gibson's objects"),
        ({"objects": [{"id": 1}]}, "expected Gibson's objects"),
        ({"objects": [{"id": [], "class_": "a"}]}, "expected Gibson's objects"),
        ({"objects": []}, "no object has a class"),
    ],
)
def test_bad_scn(tmp_path: Path, scn: object, message: str) -> None:
    with pytest.raises(ss.SceneError, match=message):
        ss.load_scene(gibson(tmp_path, scn))
