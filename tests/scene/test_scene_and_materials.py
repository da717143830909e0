"""Scenes, materials, loaders: what is accepted, what is refused, and with which words."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.scene.materials import load_labels, load_materials
from tests.rooms import box, table


def test_the_database_is_usable_and_every_label_maps() -> None:
    materials = load_materials()
    assert "gypsum-board" in materials.names
    for material in set(load_labels().labels.values()):
        materials.index(material)
    assert np.all(materials.absorption + materials.transmission <= 1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"absorption": [[1.2]]}, "absorption of 'a'"),
        ({"scattering": [[-0.1]]}, "scattering of 'a'"),
        ({"absorption": [[0.7]], "transmission": [[0.5]]}, "absorption \\+ transmission of 'a'"),
        ({"absorption": [[0.1, 0.2]]}, "shape"),
        ({"frequency_hz": [-5.0]}, "frequency_hz"),
        ({"names": ()}, "names"),
    ],
)
def test_bad_materials(change: dict[str, object], message: str) -> None:
    good = {"names": ("a",), "frequency_hz": [1000.0], "absorption": [[0.1]], "scattering": [[0.2]],
            "transmission": [[0.0]]}  # fmt: skip
    ss.MaterialTable(**good)  # type: ignore[arg-type]
    with pytest.raises(ss.MaterialError, match=message):
        ss.MaterialTable(**{**good, **change})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("vertices", "faces", "material", "message"),
    [
        (np.eye(3), np.empty((0, 3), int), [], "no faces"),
        (np.eye(3), [[0, 1, 5]], [0], "indices"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], [0], "not finite"),
        (np.eye(3), [[0, 1, 1]], [0], "no face with an area"),
        (np.eye(3), [[0, 1, 2]], [7], "materials"),
        (np.eye(3), [[0, 1, 2]], [0, 0], "face_material"),
        (np.zeros((3, 2)), [[0, 1, 2]], [0], "shape"),
    ],
)
def test_bad_scenes(vertices: object, faces: object, material: object, message: str) -> None:
    with pytest.raises(ss.SceneError, match=message):
        ss.Scene(vertices, np.array(faces), np.array(material), table(0.1, 0.1))  # type: ignore[arg-type]


def test_demo_is_a_furnished_apartment() -> None:
    scene = ss.load_scene("demo")
    assert {"wall", "floor", "ceiling", "door", "window", "bed", "sofa"} <= set(scene.labels)
    assert scene.bounds[1, 2] - scene.bounds[0, 2] == pytest.approx(3.0)
    assert 85.0 < 10.8 * 8.4 < 95.0
    assert len(scene.faces) / 12 > 25 + 20  # boxes: structure and objects


def test_unknown_scene() -> None:
    with pytest.raises(ss.SceneError, match=r"unknown scene 'nowhere'.*demo"):
        ss.load_scene("nowhere")


def test_unreadable_files(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("nonsense\n")
    (tmp_path / "b.xyz9").write_text("?")
    (tmp_path / "c.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    (tmp_path / "folder").mkdir()
    for name in ("a.obj", "b.xyz9", "c.ply", "folder"):
        with pytest.raises(ss.SceneError, match=name):
            ss.load_scene(tmp_path / name)


@pytest.mark.parametrize(
    ("scale", "unit"), [(1.0, "m"), (100.0, "cm"), (1000.0, "mm"), (1 / 0.0254, "in")]
)
@pytest.mark.parametrize("up", ["y", "z"])
def test_axis_and_unit_are_found(tmp_path: Path, scale: float, unit: str, up: str) -> None:
    room = box((6.0, 5.0, 2.7), table(0.1, 0.1))
    v = room.vertices * scale
    if up == "y":
        v = np.stack([v[:, 0], v[:, 2], -v[:, 1]], axis=1)
    trimesh.Trimesh(v, room.faces, process=False).export(tmp_path / "room.obj")
    scene = ss.load_scene(tmp_path / "room.obj")
    np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], [6.0, 5.0, 2.7], rtol=1e-4)
    assert any(f"taken as {unit}" in note for note in scene.notes)
    assert any(f"{up.upper()} is taken as up" in note for note in scene.notes)


def _replica(folder: Path, object_id: list[int], info: dict[str, object], quads: bool = False) -> Path:
    """A floor and a wall in Replica's layout."""
    v = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1]], "<f4")
    faces = [[0, 1, 2, 3], [0, 1, 5, 4]] if quads else [[0, 1, 2], [0, 2, 3], [0, 1, 5], [0, 5, 4]]
    k = 4 if quads else 3
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(v)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\n"
        "property int object_id\nend_header\n"
    )
    body = np.array([(k, f, i) for f, i in zip(faces, object_id, strict=True)],
                    [("n", "u1"), ("v", "<i4", k), ("id", "<i4")])  # fmt: skip
    (folder / "habitat").mkdir(parents=True)
    (folder / "habitat" / "mesh_semantic.ply").write_bytes(
        header.encode() + v.tobytes() + body.tobytes()
    )
    (folder / "habitat" / "info_semantic.json").write_text(json.dumps(info))
    return folder


INFO = {
    "classes": [{"id": 40, "name": "floor"}, {"id": 93, "name": "wall"}],
    "objects": [{"id": 7, "class_id": 40, "class_name": "floor"}],
    "id_to_label": [-1, -1, -1, 93],
}


@pytest.mark.parametrize("quads", [False, True])
def test_replica_layout(tmp_path: Path, quads: bool) -> None:
    ids = [7, 3] if quads else [7, 7, 3, 3]
    scene = ss.load_scene(_replica(tmp_path / "room_0", ids, INFO, quads))
    names = [scene.materials.names[i] for i in scene.face_material]
    assert names == ["carpet"] * 2 + ["gypsum-board"] * 2
    assert scene.name == "room_0"


def test_labels_can_be_overridden_and_unknown_ones_are_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = _replica(tmp_path / "r", [7, 7, 99, 99], INFO)
    with caplog.at_level(logging.WARNING):
        scene = ss.load_scene(folder, labels={"Floor": "brick"})
    assert [scene.materials.names[i] for i in scene.face_material] == ["brick"] * 2 + ["default"] * 2
    assert "2 faces (1.0 m2, 50.0 % of the area)" in caplog.text


def test_own_materials_go_on_top_of_the_database(tmp_path: Path) -> None:
    folder = _replica(tmp_path / "r", [7, 7, 3, 3], INFO)
    own = ss.MaterialTable(("carpet", "cork"), [500.0], [[0.3], [0.2]], [[0.1], [0.1]], [[0.0], [0.0]])
    scene = ss.load_scene(folder, materials=own, labels={"wall": "cork"})
    absorption = dict(
        zip(scene.materials.names, scene.materials.in_bands((0, 20000))[0][:, 0], strict=True)
    )
    assert [scene.materials.names[i] for i in scene.face_material] == ["carpet"] * 2 + ["cork"] * 2
    assert absorption["carpet"] == pytest.approx(0.3) and absorption["cork"] == pytest.approx(0.2)
    built_in = load_materials()
    kept, row = scene.materials, built_in.index("brick")
    np.testing.assert_array_equal(kept.absorption[kept.index("brick")], built_in.absorption[row])
    with pytest.raises(ss.MaterialError, match="no material 'fog'"):
        ss.load_scene(folder, labels={"wall": "fog"})


def test_aws_small_house(shared: Path) -> None:
    scene = ss.load_scene(shared / "scenes" / "aws_small_house")
    assert len(scene.faces) > 145_000
    assert {"carpet", "gypsum-board", "acoustic-tile"} <= {
        scene.materials.names[i] for i in scene.face_material
    }


def test_raw_scan(shared: Path) -> None:
    scene = ss.load_scene(shared / "scenes" / "riken_office" / "WACRO8.obj")
    assert 2.0 < scene.bounds[1, 2] - scene.bounds[0, 2] < 4.0
    assert len(scene.notes) == 4 and "lid" in scene.notes[3]
