"""Scenes, materials, loaders: what is accepted, what is refused, and with which words."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import ndimage

import soundspaces_sim as ss
from soundspaces_sim.scene.labels import load_labels
from soundspaces_sim.scene.materials import load_materials
from tests.marks import few
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
        (
            {
                "names": ("a", "a"),
                "absorption": [[0.1]] * 2,
                "scattering": [[0.2]] * 2,
                "transmission": [[0.0]] * 2,
            },
            "distinct names",
        ),
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


_CELL = 0.05


def _boxes(scene: ss.Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest and highest corners and labels of a scene's boxes, of twelve faces each."""
    corners = scene.corners.reshape(-1, 36, 3)
    return corners.min(axis=1), corners.max(axis=1), np.array(scene.labels)[scene.face_label[::12]]


def _free(lowest: np.ndarray, highest: np.ndarray, bounds: np.ndarray, z: float) -> np.ndarray:
    """Cells of a plan at height z that no box fills and that lie within the boxes on all four sides."""
    x, y = (
        np.arange(a + _CELL / 2, b, _CELL) for a, b in zip(bounds[0, :2], bounds[1, :2], strict=True)
    )
    filled = np.zeros((len(x), len(y)), bool)
    for low, high in zip(lowest, highest, strict=True):
        if low[2] < z < high[2]:
            filled |= np.outer((x > low[0]) & (x < high[0]), (y > low[1]) & (y < high[1]))
    return np.asarray(ndimage.binary_fill_holes(filled) & ~filled)


def test_demo_is_a_furnished_apartment() -> None:
    scene = ss.load_scene("demo")
    assert {"wall", "floor", "ceiling", "door", "window", "bed", "sofa"} <= set(scene.labels)
    assert scene.bounds[1, 2] - scene.bounds[0, 2] == pytest.approx(3.0)
    lowest, highest, label = _boxes(scene)
    walls = np.isin(label, ["wall"])
    # Above the doors partitions have no gaps: what they cut apart are the rooms.
    inside = _free(lowest[walls], highest[walls], scene.bounds, z=2.3)
    rooms, count = ndimage.label(inside)
    outside = rooms[0, 0]
    assert outside == 0 and count == 6  # living room, kitchen, hall, bathroom, study, bedroom
    assert inside.sum() * _CELL**2 == pytest.approx(
        90.0, rel=0.03
    )  # "about 90 m²", partitions taken off
    # Through the open doors they are one flat.
    assert ndimage.label(_free(lowest[walls], highest[walls], scene.bounds, z=1.0))[1] == 1
    furniture = ~np.isin(label, ["wall", "floor", "ceiling", "door", "window", "rug"])
    middle = ((0.5 * (lowest + highest) - scene.bounds[0]) / _CELL).astype(int)[furniture]
    of_room = [
        set(label[furniture][rooms[middle[:, 0], middle[:, 1]] == k]) for k in range(1, count + 1)
    ]
    assert min(len(names) for names in of_room) >= 2, of_room
    assert sum({"bed", "wardrobe"} <= names for names in of_room) == 1
    assert sum({"sofa"} <= names for names in of_room) == 1
    assert sum({"bathtub", "toilet"} <= names for names in of_room) == 1
    assert sum({"cooktop", "refrigerator"} <= names for names in of_room) == 1


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
    ("scale", "unit", "up"),
    few(
        [(*s, up) for s in ((1.0, "m"), (100.0, "cm"), (1000.0, "mm"), (1 / 0.0254, "in")) for up in "yz"],
        (1.0, "m", "y"), (100.0, "cm", "z"), (1000.0, "mm", "y"), (1 / 0.0254, "in", "z"),
    ),
)  # fmt: skip
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
    a, s, t = (np.array([[x], [y]]) for x, y in ((0.3, 0.2), (0.1, 0.1), (0.0, 0.0)))
    own = ss.MaterialTable(("carpet", "cork"), np.array([500.0]), a, s, t)
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
    assert len(scene.notes) == 5 and "ceiling=False" in scene.notes[4]
    assert "holes of up to 0.6 m" in scene.notes[3]
