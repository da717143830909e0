"""I-Simpa's PLY, as its ExportPly writes it: big-endian, layers after the faces; and its projects."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from soundspaces_room_programs.isimpa import read_project

import soundspaces_sim as ss
from soundspaces_sim.scene.formats.limits import check_3mf
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
        (lambda f: f.update({"instance1/projet_config.xml": b"<projet>"}), "XML is damaged"),
        (lambda f: f.update({"instance1/x.finfo": bytes(10**8)}), "unpack to"),
        (lambda f: f.update({k: v.replace(b'"0.25"', b'"1.25"') for k, v in f.items()}), "M100"),
        (lambda f: f.update({k: v.replace(b'"0.25"', b'"x"') for k, v in f.items()}), "M100"),
    ],
)
def test_damaged_projects(
    tmp_path: Path, change: Callable[[dict[str, bytes]], object], message: str
) -> None:
    with pytest.raises(ss.SceneError, match=message):
        ss.load_scene(project(tmp_path / "room.proj", change=change))


def _groups(files: dict[str, bytes], groups: list[tuple[str, str]]) -> None:
    """The tree has these groups alone: name and file of faces."""
    own = "".join(f'<gr name="{name}" facesFile="{file}"/>' for name, file in groups)
    xml = f"<projet><sgroupes>{own}</sgroupes></projet>"
    files["instance1/projet_config.xml"] = xml.encode()


def test_names_that_come_again_get_numbers_of_their_own(tmp_path: Path) -> None:
    names = ["a", "a 1", "a", "a 2", "a", "a 1"]

    def rename(files: dict[str, bytes]) -> None:
        for row in range(6):
            files[f"instance1/{row}.finfo"] = struct.pack("<3I", 1, row // 4, row % 4)
        _groups(files, [(name, f"{row}.finfo") for row, name in enumerate(names)])

    found = read_project(str(project(tmp_path / "room.proj", change=rename)))
    assert found.labels == ("a", "a 1", "a 2", "a 2 1", "a 3", "a 1 1")


def test_many_groups_of_one_name_take_no_longer_than_others(tmp_path: Path) -> None:
    """Names and files that are looked for among all others would take minutes."""
    count = 20_000

    def fill(files: dict[str, bytes]) -> None:
        for row in range(count):
            files[f"instance1/{row}.finfo"] = struct.pack("<3I", 1, 0, 0)
        _groups(files, [("a", f"{row}.finfo") for row in range(count)])

    found = read_project(str(project(tmp_path / "room.proj", change=fill)))
    assert found.labels[-1] == f"a {count - 1}"


def test_a_project_after_a_calculation_is_the_project(tmp_path: Path) -> None:
    """Its folders of results hold copies."""

    def calculate(files: dict[str, bytes]) -> None:
        for name in list(files):
            files[name.replace("instance1/", "instance1/report/SPPS/2026-11-26_10h/")] = b"other"
        for hour in (10, 11):
            files[f"instance1/report/SPPS/2026-11-26_{hour}h/own.finfo"] = b"of the calculation"

    found = read_project(str(project(tmp_path / "room.proj", change=calculate)))
    assert found.labels == ("walls", "walls 1", "carpet")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.update({"instance2/projet_config.xml": b"<a/>"}), "one projet_config.xml.*two"),
        (lambda f: _groups(f, [(f"{i}", "a.finfo") for i in range(9)]), "another group's"),
        (lambda f: f.update({"instance1/projet_config.xml": b"<!DOCTYPE a []><a/>"}), "without a DOCTYPE"),
        (lambda f: f.update({"instance1/projet_config.xml": "<a/>".encode("utf-16")}), "UTF-8"),
        (lambda f: f.update({"instance1/projet_config.xml": b"<a>" + b"<b/>" * 2**21 + b"</a>", "instance1/x.finfo": np.random.default_rng(0).bytes(10**5)}), "elements"),
    ],
)  # fmt: skip
def test_hostile_projects(
    tmp_path: Path, change: Callable[[dict[str, bytes]], object], message: str
) -> None:
    with pytest.raises(ss.SceneError, match=message):
        ss.load_scene(project(tmp_path / "room.proj", change=change))


def test_parts_of_a_mesh_do_not_overlap(tmp_path: Path) -> None:
    """Each could hold all that follows: memory would grow with the square of the file."""

    def overlap(files: dict[str, bytes]) -> None:
        mesh = bytearray(files["instance1/sceneMesh.bin"])
        first = struct.unpack_from("<I", mesh, 16)[0]
        mesh[first + 8 : first + 12] = struct.pack("<I", first + 13)
        files["instance1/sceneMesh.bin"] = bytes(mesh)

    with pytest.raises(ss.SceneError, match="overlap"):
        ss.load_scene(project(tmp_path / "room.proj", change=overlap))


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
@pytest.mark.parametrize("end", ["proj", "3mf"])
def test_other_methods_of_zip_are_refused(tmp_path: Path, method: int, end: str) -> None:
    """Python unpacks them whole, whatever the archive says of their size; damaged ones raise errors of their own."""
    path = tmp_path / f"a.{end}"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("instance1/projet_config.xml", b"<a/>")
        archive.writestr("3D/a.model", b"<a/>")
    with (
        open(path, "rb") as file,
        pytest.raises(ss.SceneError, match=f"a.{end}: expected files packed by"),
    ):
        check_3mf(path, file) if end == "3mf" else read_project(str(path))


def test_a_mesh_that_goes_in_a_circle_ends(tmp_path: Path) -> None:
    def turn(files: dict[str, bytes]) -> None:
        mesh = bytearray(files["instance1/sceneMesh.bin"])
        mesh[16:20] = struct.pack("<I", 8)  # the part after the vertices is the vertices
        files["instance1/sceneMesh.bin"] = bytes(mesh)

    with pytest.raises(ss.SceneError, match="circle"):
        ss.load_scene(project(tmp_path / "room.proj", change=turn))
