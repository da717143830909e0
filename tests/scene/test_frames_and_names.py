"""What files say of axes, units and materials, and what is made of names."""

from __future__ import annotations

import base64
import json
import logging
import struct
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.build.inspect import report_text
from soundspaces_sim.scene.formats import FORMATS
from soundspaces_sim.scene.labels import find_material, load_labels
from soundspaces_sim.scene.materials import load_materials
from tests.marks import few
from tests.rooms import box, table

ROOM = box((6.0, 4.0, 2.5), table(0.1, 0.1))


def _size(scene: ss.Scene) -> np.ndarray:
    return np.asarray(scene.bounds[1] - scene.bounds[0])


def _names(scene: ss.Scene) -> dict[str, float]:
    areas = np.bincount(scene.face_material, scene.areas, len(scene.materials.names))
    return {n: round(float(a), 3) for n, a in zip(scene.materials.names, areas, strict=True) if a > 0}


@pytest.mark.parametrize(
    ("floor", "up"),
    few(
        product((-0.05, -0.1, -0.2, 0.35, 0.7, 1 / 3, 0.0), "yz"),
        (-0.1, "z"), (0.35, "y"), (1 / 3, "z"), (0.0, "y"),
    ),
)  # fmt: skip
def test_a_floor_at_any_height(tmp_path: Path, floor: float, up: str) -> None:
    """The mean of equal heights may round to just below the least of them."""
    v = ROOM.vertices + [0.0, 0.0, floor]
    if up == "y":
        v = np.stack([v[:, 0], v[:, 2], -v[:, 1]], axis=1)
    trimesh.Trimesh(v, ROOM.faces, process=False).export(tmp_path / "room.obj")
    np.testing.assert_allclose(_size(ss.load_scene(tmp_path / "room.obj")), [6.0, 4.0, 2.5], atol=1e-5)


def test_glb_is_y_up_and_metres(tmp_path: Path) -> None:
    """A mast of 30 x 1 x 1 m along Y, which no guess would take for up."""
    trimesh.creation.box(extents=[1.0, 30.0, 1.0]).export(tmp_path / "mast.glb")
    np.testing.assert_allclose(
        _size(ss.load_scene(tmp_path / "mast.glb", ceiling=False)), [1.0, 1.0, 30.0]
    )
    trimesh.creation.box(extents=[500.0, 900.0, 400.0]).export(tmp_path / "large.glb")
    np.testing.assert_allclose(
        _size(ss.load_scene(tmp_path / "large.glb", ceiling=False)), [500.0, 400.0, 900.0]
    )


@pytest.mark.parametrize("suffix", ["gltf", "glb"])
def test_materials_of_a_gltf_bring_their_extras(tmp_path: Path, suffix: str) -> None:
    """A file by hand: names of materials are labels, and coefficients among their extras are theirs, ahead of the
    database's; one in all octaves, some in octaves, none."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
    data = corners.tobytes() + np.array([0, 1, 2, 0, 2, 3], "<u4").tobytes()
    extras: list[dict[str, Any]] = [
        {"extras": {"absorption": [0.1, 0.2, 0.4], "scattering": 0.3}},
        {"extras": {"absorption": 0.9, "note": "x"}},
        {},
    ]
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [{"mesh": i, "translation": [0, 0, 2 * i]} for i in range(3)],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": i}]} for i in range(3)],
        "materials": [{"name": n} | e for n, e in zip(("felt", "concrete", "brick"), extras, strict=True)],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
    }  # fmt: skip

    def write(path: Path) -> Path:
        if suffix == "gltf":
            uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
            path.write_text(json.dumps(tree | {"buffers": [{"byteLength": len(data), "uri": uri}]}))
        else:
            text = json.dumps(tree | {"buffers": [{"byteLength": len(data)}]}).encode()
            text += b" " * (-len(text) % 4)
            chunks = (
                struct.pack("<II", len(text), 0x4E4F534A)
                + text
                + struct.pack("<II", len(data), 0x004E4942)
                + data
            )
            path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path

    scene = ss.load_scene(write(tmp_path / f"three.{suffix}"), ceiling=False)
    bands = (100.0, 150.0, 450.0, 550.0, 7900.0, 8100.0)
    absorption, scattering = scene.materials.in_bands(bands)[:2]
    found = {scene.labels[row]: m for row, m in zip(scene.face_label, scene.face_material, strict=True)}
    np.testing.assert_allclose(absorption[found["felt"]][[0, 2, 4]], [0.1, 0.4, 0.4], atol=0.01)
    np.testing.assert_allclose(scattering[found["felt"]], 0.3, atol=1e-12)
    np.testing.assert_allclose(absorption[found["concrete"]], 0.9, atol=1e-12)
    assert scene.materials.names[found["brick"]] == "brick"
    for wrong in (1.5, "much", [], [0.1] * 9, [True], None):
        tree["materials"][0]["extras"] = {"absorption": wrong}  # type: ignore[index]
        with pytest.raises(ss.SceneError, match="material 'felt'"):
            ss.load_scene(write(tmp_path / f"bad.{suffix}"))


def test_names_of_glb_nodes_are_labels_where_there_is_no_material(tmp_path: Path) -> None:
    scene: Any = trimesh.Scene()
    for name, z in (("brick_wall", 0.0), ("Mesh_3", 2.0)):
        scene.add_geometry(
            trimesh.creation.box(bounds=[[0, z, 0], [1, z + 1, 1]]), node_name=name, geom_name=name
        )
    scene.export(tmp_path / "named.glb")
    assert _names(ss.load_scene(tmp_path / "named.glb", ceiling=False)) == {"default": 6.0, "brick": 6.0}


_QUADS = [[1, 3, 7, 5], [2, 4, 8, 6], [1, 2, 6, 5], [3, 4, 8, 7], [1, 2, 4, 3], [5, 6, 8, 7]]


def _obj(path: Path, names: list[str], key: str, head: str = "") -> Path:
    lines = [head] + [f"v {x} {y} {z}" for x in (0, 4) for y in (0, 3) for z in (0, 2.5)]
    for name, quad in zip(names, _QUADS, strict=True):
        lines += [f"{key} {name}" if key else "", "f " + " ".join(map(str, quad))]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("key", ["usemtl", "g", "o"])
@pytest.mark.parametrize("head", ["", "mtllib gone.mtl"])
def test_names_of_an_obj_without_its_mtl(tmp_path: Path, key: str, head: str) -> None:
    names = ["Wooden floor", "ceiling", "brick", "brick", "Glass door", "brick"]
    scene = ss.load_scene(_obj(tmp_path / "room.obj", names, key, head), up="z")
    assert _names(scene) == {"acoustic-tile": 12.0, "brick": 27.5, "glass": 7.5, "wood-thick": 12.0}
    assert any("'Glass door' by 'glass' glass" in note for note in scene.notes)


def test_made_up_names_are_no_labels(tmp_path: Path) -> None:
    scene = ss.load_scene(_obj(tmp_path / "scan.obj", [f"Object.{k}" for k in range(6)], "o"), up="z")
    assert scene.labels == () and any("no labels" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("label", "material"),
    [
        ("acoustic panel", "rockwool-panel"), ("Acoustic_Panel.002", "rockwool-panel"), ("plush chair", "upholstery"),
        ("altar", "marble"), ("audience", "audience"), ("Audience area balcony", "audience"), ("stage", "stage-floor"),
        ("panel wall", "wood-panel"), ("Stage reflector", "plywood"), ("curtain wall", "window-double"),
        ("red stage curtains", "curtain"), ("glass door", "glass"), ("BrickWall_ext", "brick"), ("wall clock", "default"),
        ("ceiling-north", "acoustic-tile"), ("church pews", "chair-wooden"), ("Concrete floor 20cm", "concrete-floor"),
        ("wall / Basic Wall 200 / Gypsum board", "gypsum-board"), ("left window upper", "glass"),
        ("Door - Panel", "wood-thick"), ("Door Panel", "wood-thick"), ("Panel", "gypsum-board"),
        ("Sofa - Furniture", "curtain"), ("floor covering", "carpet"), ("Curtain Panel", "window-double"),
        ("Mullion", "window-double"), ("Rectangular Mullion 50 x 150", "window-double"),
        ("Bed Textile/Wood", "upholstery"), ("Textile/Wood", "upholstery"), ("Table Wood/Metal", "wood-thick"),
        ("wall / Basic Wall / Metal stud / Gypsum", "gypsum-board"), ("slab / zorp/oak", "wood-thick"),
        ("zorp", None), ("xwallx", None), ("", None), ("123", None),
    ],
)  # fmt: skip
def test_labels_are_matched_by_words(label: str, material: str | None) -> None:
    assert find_material(label, load_labels(), load_materials())[0] == material


def test_words_of_ones_own_and_bad_label_files(tmp_path: Path) -> None:
    own = tmp_path / "labels.toml"
    own.write_text('[labels]\nnave = "stone"\n[words]\nzorp = "cork"\n')
    labels = load_labels(own)
    assert labels.words["zorp"] == "cork" and labels.labels["nave"] == "stone"
    own.write_text(
        "frequency_hz = [125, 1000]\n[materials.felt]\nabsorption = [0.1, 0.2]\n[labels]\nnave = 'felt'\n"
    )
    assert load_labels(own).labels["nave"] == "felt"  # one file may hold materials as well
    for text, message in (
        ("[label]\na = 'brick'\n", "unknown setting 'label'"),
        ("[labels]\na = 3\n", "names of"),
    ):
        own.write_text(text)
        with pytest.raises(ss.MaterialError, match=message):
            load_labels(own)


def test_the_registry_lists_what_it_reads() -> None:
    assert list(FORMATS) == [
        "demo",
        "replica",
        "matterport",
        "elsewhere",
        "obj",
        "mesh",
    ]
    with pytest.raises(
        ss.SceneError, match=r"unknown scene 'x'.*'demo'.*Replica.*Matterport3D.*IFC.*COLLADA"
    ):
        ss.load_scene("x")


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        *((f"hall.{end}", "room_programs") for end in ("geo", "par", "proj", "ply")),
        ("hall.dae", "scene_formats"),
        ("hall.IFC", "scene_formats"),
        ("00800-Room/Room.glb", "scene_formats"),
        ("Room.basis.glb", "scene_formats"),
        ("Room.semantic.txt", "scene_formats"),
        ("Habitat.glb", "scene_formats"),
        ("raw/mesh_z_up.obj", "scene_formats"),
        ("home-7", "buildings"),
    ],
)
def test_what_a_neighbour_reads_is_refused_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, folder: str
) -> None:
    layers = (
        "ply\nformat ascii 1.0\nelement vertex 0\nelement layer 1\nproperty uchar a\nend_header\n1\n"
    )
    monkeypatch.setattr("soundspaces_sim.core.registry.find_spec", lambda _: None)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(layers)
    (tmp_path / "Habitat.navmesh").touch()
    source = name if folder == "buildings" else str(tmp_path / name)
    assert FORMATS["elsewhere"].detects(source)
    with pytest.raises(ss.SceneError, match=rf"not installed; .*\./neighbours/{folder}$"):
        FORMATS["elsewhere"].read(source)


@pytest.mark.parametrize(("axis", "far"), few(product(range(3), (1e5, -1e6)), (0, 1e5), (2, -1e6)))
def test_a_stray_vertex_is_dropped_and_said(tmp_path: Path, axis: int, far: float) -> None:
    """One triangle of a room of 192 reaches 100 km: the room is loaded, in metres, upright, without it."""
    mesh = trimesh.Trimesh(ROOM.vertices, ROOM.faces, process=False).subdivide().subdivide()
    v = np.concatenate([mesh.vertices, [[1.0, 1.0, 1.0], [2.0, 1.0, 1.0], [1.0, 2.0, 1.0]]])
    v[-1, axis] = far
    f = np.concatenate([mesh.faces, [[len(v) - 3, len(v) - 2, len(v) - 1]]])
    trimesh.Trimesh(v, f, process=False).export(tmp_path / "room.obj")
    scene = ss.load_scene(tmp_path / "room.obj")
    np.testing.assert_allclose(_size(scene), [6.0, 4.0, 2.5])
    assert any("1 of 193 faces were dropped" in note for note in scene.notes)
    assert len(ss.make_grid(scene, 1.0)) == 24


@pytest.mark.parametrize("far", [1e38, -1e300, 3e38])
def test_absurd_coordinates_are_refused(tmp_path: Path, far: float) -> None:
    v = ROOM.vertices.copy()
    v[3, 0] = far
    text = "".join(f"v {a!r} {b!r} {c!r}\n" for a, b, c in v.tolist())
    text += "".join(f"f {a} {b} {c}\n" for a, b, c in (ROOM.faces + 1).tolist())
    (tmp_path / "room.obj").write_text(text)
    with pytest.raises(ss.SceneError, match="coordinates reach"):
        ss.load_scene(tmp_path / "room.obj")
    with pytest.raises(ss.SceneError, match="coordinates reach"):
        ss.Scene.from_arrays(v, ROOM.faces)


@pytest.mark.usefixtures("no_t30")
def test_inspect_says_what_fell_to_default(tmp_path: Path) -> None:
    """12 m² of 'zorp' of 59 m², beside names that are known."""
    names = ["ceiling", "zorp", "brick", "brick", "brick", "zorp"]
    path = _obj(tmp_path / "room.obj", names, "usemtl")
    scene = ss.load_scene(path, up="z", ceiling=False)
    areas = scene.areas[scene.face_label == scene.labels.index("zorp")].sum()
    report = ss.inspect_scene(scene, ss.GridConfig(spacing=1.0))
    assert report.default_area == pytest.approx(areas) and report.default_labels == {
        "zorp": pytest.approx(areas)
    }
    share = f"{100 * areas / 59.0:.0f} % of the area fell to the default material"
    assert any(share in w for w in report.warnings)
    assert any("labels without an entry: zorp" in note for note in scene.notes)
    assert report_text(report).count("zorp") == 1


def test_what_fell_to_default_is_logged_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = _obj(tmp_path / "room.obj", ["ceiling", "zorp", *["brick"] * 4], "usemtl")
    with caplog.at_level(logging.INFO, "soundspaces_sim"):
        ss.load_scene(path, up="z", ceiling=False)
    (record,) = [r for r in caplog.records if "zorp" in r.getMessage()]
    assert record.levelno == logging.WARNING


@pytest.mark.parametrize(
    ("said", "metre"),
    [
        ("# Alias OBJ Model File\n# Exported from SketchUp\n# File units = feet", 0.3048),
        ("# File units = inches\n", 0.0254),
        ("# File units = millimeters", 0.001),
        ("# Units: centimetres", 0.01),
        ("# units m", 1.0),
    ],
)
def test_the_unit_that_an_obj_says(tmp_path: Path, said: str, metre: float) -> None:
    """4 x 3 x 2.5 of it, which by its height alone would be metres."""
    path = _obj(tmp_path / "room.obj", ["wall"] * 6, "usemtl", said)
    scene = ss.load_scene(path, up="z", ceiling=False)
    np.testing.assert_allclose(_size(scene), np.array([4.0, 3.0, 2.5]) * metre)
    assert metre == 1.0 or any("so says the file" in note for note in scene.notes)
    np.testing.assert_allclose(
        _size(ss.load_scene(path, up="z", unit="m", ceiling=False)), [4.0, 3.0, 2.5]
    )


def test_an_unknown_unit_is_said_and_guessed(tmp_path: Path) -> None:
    path = _obj(tmp_path / "room.obj", ["wall"] * 6, "usemtl", "# File units = cubits")
    scene = ss.load_scene(path, up="z", ceiling=False)
    np.testing.assert_allclose(_size(scene), [4.0, 3.0, 2.5])
    assert any("'cubits'" in note and "--unit" in note for note in scene.notes)


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_booth_stands_upright(tmp_path: Path, up: str) -> None:
    """0.9 x 0.9 x 2.1 m: its sides are larger and more level than its floor, but nobody could stand in it."""
    size = {"y": (0.9, 2.1, 0.9), "z": (0.9, 0.9, 2.1)}[up]
    trimesh.creation.box(extents=size).export(tmp_path / "booth.stl")
    scene = ss.load_scene(tmp_path / "booth.stl")
    np.testing.assert_allclose(_size(scene), [0.9, 0.9, 2.1], atol=1e-6)
    assert any("one can stand in 2.10 m" in note for note in scene.notes)
