"""Loaders on faithful small files of each format, and on damaged ones."""

from __future__ import annotations

import json
import logging
import struct
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import integrate
from scipy.optimize import brentq

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.labels import find_material, load_labels
from soundspaces_sim.scene.load import decimate_mesh
from soundspaces_sim.scene.materials import load_materials
from tests import iso9613
from tests.marks import CI_SLOW, ci_slow, few
from tests.rooms import box, table

# A room of 4 x 3 x 2.5 m as quads, without a ceiling if told so.
_V = np.array([[x, y, z] for x in (0, 4) for y in (0, 3) for z in (0, 2.5)], float)
_QUADS = {
    "floor": [0, 2, 6, 4], "wall_w": [0, 1, 3, 2], "wall_e": [4, 6, 7, 5], "wall_s": [0, 4, 5, 1],
    "wall_n": [2, 3, 7, 6], "ceiling": [1, 5, 7, 3],
}  # fmt: skip


def _ply(
    path: Path, polygons: list[list[int]], numbers: dict[str, tuple[str, list[int]]], extra: bool = False
) -> None:
    """Binary PLY with any polygons; `numbers`: PLY type and a value per face."""
    kinds = {"int": "i", "ushort": "H", "uchar": "B"}
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(_V)}"]
    head += [f"property float {a}" for a in "xyz"]
    if extra:
        head += [f"property float n{a}" for a in "xyz"] + [
            f"property uchar {c}" for c in ("red", "green", "blue")
        ]
    head += [f"element face {len(polygons)}", "property list uchar int vertex_indices"]
    head += [f"property {kind} {name}" for name, (kind, _) in numbers.items()] + ["end_header", ""]
    body = b""
    for x, y, z in _V:
        body += struct.pack("<3f", x, y, z) + (struct.pack("<3f3B", 0, 0, 1, 9, 9, 9) if extra else b"")
    for k, polygon in enumerate(polygons):
        body += struct.pack(f"<B{len(polygon)}i", len(polygon), *polygon)
        for kind, values in numbers.values():
            body += struct.pack("<" + kinds[kind], values[k])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(head).encode() + body)


_CLASS = {"floor": 40, "wall": 93, "ceiling": 31}


def _replica(folder: Path, mixed: bool, kind: str = "int", ceiling: bool = True) -> Path:
    polygons, ids = [], []
    for name, quad in _QUADS.items():
        if name == "ceiling" and not ceiling:
            continue
        pieces = (
            [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
            if mixed and name != "floor"
            else [quad]
        )
        polygons += pieces
        ids += [_CLASS[name.split("_")[0]] + 100] * len(pieces)
    _ply(folder / "habitat" / "mesh_semantic.ply", polygons, {"object_id": (kind, ids)}, extra=True)
    info = {
        "classes": [{"id": i, "name": n} for n, i in _CLASS.items()],
        "objects": [{"id": 140, "class_id": 40, "class_name": "floor"}],
        "id_to_label": [-1] * 131 + [31] + [-1] * 61 + [93],
    }
    (folder / "habitat" / "info_semantic.json").write_text(json.dumps(info))
    return folder


def _names(scene: ss.Scene) -> dict[str, float]:
    area = np.bincount(scene.face_material, scene.areas, len(scene.materials.names))
    return {n: round(float(a), 6) for n, a in zip(scene.materials.names, area, strict=True) if a}


ROOM = {"carpet": 12.0, "gypsum-board": 35.0, "acoustic-tile": 12.0}


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("kind", ["int", "ushort"])
def test_replica_quads_triangles_and_id_types(tmp_path: Path, mixed: bool, kind: str) -> None:
    assert _names(ss.load_scene(_replica(tmp_path / "s", mixed, kind))) == ROOM


_MPCAT = {"floor": 2, "wall": 1, "ceiling": 17}


def _house(version: str = "ASCII 1.1") -> str:
    lines = [version, "H name label 1 1 1 1 1 1 1 1 1 0 0 0 0 0 0 0 0 0 0 0 0"]
    lines += [f"C  {k}  {k + 500} {name}_raw  {index} {name}  0 0 0 0 0"
              for k, (name, index) in enumerate(_MPCAT.items())]  # fmt: skip
    lines += [
        f"O  {o} 0 {k}  0 0 0  1 0 0  0 1 0  1 1 1  0 0 0 0 0 0 0 0" for o, k in enumerate((0, 1, 2, -1))
    ]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("native", [False, True])
def test_matterport(tmp_path: Path, native: bool, caplog: pytest.LogCaptureFixture) -> None:
    folder = tmp_path / "17DRP5sb8fy"
    order = {"floor": 0, "wall": 1, "ceiling": 2}
    rows = [order[n.split("_")[0]] for n in _QUADS]
    if native:
        numbers = {"face_material": ("int", [0] * 6), "face_segment": ("int", [0] * 6),
                   "face_category": ("int", [r + 500 for r in rows])}  # fmt: skip
        _ply(folder / "house_segmentations" / "17DRP5sb8fy.ply", list(_QUADS.values()), numbers)
        (folder / "house_segmentations" / "17DRP5sb8fy.house").write_text(_house())
    else:
        rows[1] = 3  # an object whose category is -1
        _ply(folder / "17DRP5sb8fy_semantic.ply", list(_QUADS.values()), {"object_id": ("int", rows)})
        (folder / "17DRP5sb8fy.house").write_text(_house())
    with caplog.at_level(logging.WARNING):
        names = _names(ss.load_scene(folder))
    assert names == (ROOM if native else {**ROOM, "gypsum-board": 27.5, "default": 7.5})
    assert native or "2 faces (7.5 m2" in caplog.text


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb", "stl", "off"])
def test_any_mesh(tmp_path: Path, suffix: str) -> None:
    """A house-like room written by trimesh: two-thirds floor area, 2.5 m high, whatever is up."""
    room = box((6.0, 4.0, 2.5), table(0.1, 0.1))
    y_up = suffix == "glb"
    vertices = room.vertices[:, [0, 2, 1]] * [1, 1, -1] if y_up else room.vertices
    mesh = trimesh.Trimesh(vertices, room.faces, process=False)
    path = tmp_path / f"room.{suffix}"
    mesh.export(path)
    scene = ss.load_scene(path)
    np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], [6.0, 4.0, 2.5], atol=1e-5)
    assert any("up" in note for note in scene.notes) and any("labels" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("unit", "factor", "up"),
    few(
        [(*u, up) for u in (("mm", 1000.0), ("in", 1 / 0.0254), ("cm", 100.0), ("m", 1.0)) for up in "yz"],
        ("mm", 1000.0, "y"), ("in", 1 / 0.0254, "z"), ("cm", 100.0, "y"), ("m", 1.0, "z"),
    ),
)  # fmt: skip
def test_units_and_axes_are_found_and_can_be_said(
    tmp_path: Path, unit: str, factor: float, up: str
) -> None:
    room = box((6.0, 4.0, 2.5), table(0.1, 0.1))
    vertices = room.vertices * factor
    if up == "y":
        vertices = np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)
    path = tmp_path / "room.obj"
    trimesh.Trimesh(vertices, room.faces, process=False).export(path)
    for scene in (ss.load_scene(path), ss.load_scene(path, up=up, unit=unit)):
        np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], [6.0, 4.0, 2.5], atol=1e-3)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"unit": "furlong"}, "unit: expected one of m, cm, mm, in, ft, got 'furlong'"),
        ({"up": "x"}, "up: expected"),
    ],
)
def test_unknown_units_and_axes_are_refused(
    tmp_path: Path, setting: dict[str, str], message: str
) -> None:
    room = box((6.0, 4.0, 2.5), table(0.1, 0.1))
    trimesh.Trimesh(room.vertices, room.faces, process=False).export(tmp_path / "room.obj")
    with pytest.raises(ss.SceneError, match=message):
        ss.load_scene(tmp_path / "room.obj", **setting)  # type: ignore[arg-type]


def test_materials_of_an_obj_file_are_labels(tmp_path: Path) -> None:
    (tmp_path / "room.mtl").write_text("newmtl Floor.001\nKd 1 1 1\nnewmtl brick\nKd 1 0 0\n")
    lines = ["mtllib room.mtl"] + [f"v {x} {y} {z}" for x, y, z in _V]
    for name, quad in _QUADS.items():
        material = "Floor.001" if name == "floor" else "brick"
        lines += [f"usemtl {material}", "f " + " ".join(str(i + 1) for i in quad)]
    (tmp_path / "room.obj").write_text("\n".join(lines) + "\n")
    assert _names(ss.load_scene(tmp_path / "room.obj", up="z")) == {"carpet": 12.0, "brick": 47.0}


def test_a_missing_ceiling_is_covered_and_said(tmp_path: Path) -> None:
    """4 x 3 m without a ceiling: a ceiling at the walls' upper end, 2.5 m, over the floor and the walls."""
    scene = ss.load_scene(_replica(tmp_path / "frl", True, ceiling=False))
    ceiling = scene.areas[scene.face_material == scene.materials.index("acoustic-tile")].sum()
    assert 12.0 <= ceiling < 17.0
    note = next(n for n in scene.notes if "synthetic ceiling of" in n)
    assert "100 % of the floor at z = 0.00 m" in note and "z = 2.50 m" in note
    closed = ss.make_grid(scene, 0.5)
    assert closed.closedness.min() > 0.99 and len(closed) == 48
    open_ = ss.load_scene(_replica(tmp_path / "open", True, ceiling=False), ceiling=False)
    assert len(open_.faces) == 10 and not open_.notes
    whole = ss.load_scene(_replica(tmp_path / "whole", True))
    assert not any("ceiling" in n for n in whole.notes)


def test_a_yard_gets_no_lid(tmp_path: Path) -> None:
    """A floor with one wall is outdoors."""
    polygons = [_QUADS["floor"], _QUADS["wall_w"]]
    _ply(tmp_path / "y" / "habitat" / "mesh_semantic.ply", polygons, {"object_id": ("int", [140, 193])})
    _replica(tmp_path / "y2", False)
    info = (tmp_path / "y2" / "habitat" / "info_semantic.json").read_text()
    (tmp_path / "y" / "habitat" / "info_semantic.json").write_text(info)
    assert not ss.load_scene(tmp_path / "y").notes


def test_decimation_keeps_shape_and_labels() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    upper = (sphere.triangles_center[:, 2] > 0).astype(int)
    mesh = LabelledMesh(
        np.asarray(sphere.vertices), np.asarray(sphere.faces), ("floor", "ceiling"), upper, "ball"
    )
    mesh = replace(mesh, materials={"floor": table(0.1, 0.1)})
    small = decimate_mesh(mesh, 0.1)
    assert small.materials == mesh.materials
    assert 0.08 * len(mesh.faces) < len(small.faces) < 0.12 * len(mesh.faces)
    corners = small.vertices[small.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert area.sum() == pytest.approx(np.pi, rel=0.03)
    middle = corners.mean(axis=1)[:, 2]
    agree = (small.face_label == 1) == (middle > 0)
    assert agree[np.abs(middle) > 0.08].all()
    # A large flat part of few triangles stays: a room around the ball, of which the package would delete walls.
    room = box((6.0, 5.0, 5.0), table(0.1, 0.1))
    both = LabelledMesh(
        np.concatenate([mesh.vertices, room.vertices - 2.5]), np.concatenate([mesh.faces, room.faces + len(mesh.vertices)]),
        mesh.labels, np.concatenate([upper, np.zeros(12, int)]), "both",
    )  # fmt: skip
    fewer = decimate_mesh(both, 0.1)
    corners = fewer.vertices[fewer.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert area.sum() == pytest.approx(np.pi + 170.0, rel=0.001)
    with pytest.raises(ss.SceneError, match="share of the faces"):
        decimate_mesh(mesh, 1.5)


def test_forty_materials_and_every_known_class() -> None:
    table_, labels = load_materials(), load_labels()
    assert len(table_.names) >= 40
    replica = Path(__file__).parents[1] / "data" / "replica_classes.txt"
    mpcat = (
        "void wall floor chair door table picture cabinet cushion window sofa bed curtain chest_of_drawers plant sink "
        "stairs ceiling toilet stool towel mirror tv_monitor shower column bathtub counter fireplace lighting beam "
        "railing shelving blinds gym_equipment seating board_panel furniture appliances clothes objects misc unlabeled"
    ).split()
    scannet = (
        "wall floor cabinet bed chair sofa table door window bookshelf picture counter blinds desk shelves curtain "
        "dresser pillow mirror floor_mat clothes ceiling books refridgerator television paper towel shower_curtain box "
        "whiteboard person night_stand toilet sink lamp bathtub bag otherstructure otherfurniture otherprop"
    ).split()
    classes = replica.read_text().split()
    assert len(classes) == 101
    missing = [n for n in classes + mpcat + scannet if find_material(n, labels, table_)[0] is None]
    assert missing == ["refridgerator"]  # ScanNet's own spelling
    assert find_material("Chair.012", labels, table_)[0] == "wood-thick"
    assert find_material("windows", labels, table_)[0] == "glass"
    assert find_material("marble", labels, table_)[0] == "marble"
    assert find_material("gizmo", labels, table_)[0] is None
    # the paper: floor carpet, wall gypsum board, ceiling acoustic tile
    assert [find_material(n, labels, table_)[0] for n in ("floor", "wall", "ceiling")] == [
        "carpet", "gypsum-board", "acoustic-tile",
    ]  # fmt: skip


def test_every_material_has_a_source() -> None:
    import tomllib

    from soundspaces_sim.core.io.resources import resource

    raw = tomllib.loads(resource("materials", "materials.toml").read_text())
    assert all(row["source"].strip() for row in raw["materials"].values())


def test_strict_materials(tmp_path: Path) -> None:
    folder = _replica(tmp_path / "s", False)
    text = (folder / "habitat" / "info_semantic.json").read_text().replace('"ceiling"', '"gizmo"')
    (folder / "habitat" / "info_semantic.json").write_text(text)
    ss.load_scene(folder)
    with pytest.raises(ss.MaterialError, match=r"2 faces \(12\.0 m2.*gizmo.*--strict-materials"):
        ss.load_scene(folder, strict_materials=True)
    assert (
        _names(ss.load_scene(folder, strict_materials=True, labels={"gizmo": "glass"}))["glass"] == 12.0
    )


def _matterport(folder: Path, house: str) -> Path:
    _ply(folder / "s_semantic.ply", list(_QUADS.values()), {"object_id": ("int", [0, 1, 1, 1, 1, 2])})
    (folder / "s.house").write_text(house)
    return folder


@pytest.mark.parametrize("name", ["", "s.house", "s_semantic.ply", "s.glb"])
def test_a_file_of_a_matterport_scene_is_the_scene(tmp_path: Path, name: str) -> None:
    """Labels and Z up, though a .glb is Y up by its format."""
    folder = _matterport(tmp_path / "s", _house())
    trimesh.creation.box(extents=(1.0, 2.0, 3.0)).export(folder / "s.glb")
    scene = ss.load_scene(folder / name)
    np.testing.assert_array_equal(scene.corners, ss.load_scene(folder).corners)
    assert scene.labels == ss.load_scene(folder).labels and len(scene.labels) > 1


def test_a_matterport_mesh_without_labels(tmp_path: Path) -> None:
    folder = _matterport(tmp_path / "s", _house())
    trimesh.creation.box(extents=(1.0, 2.0, 3.0)).export(folder / "s.glb")
    (folder / "s_semantic.ply").unlink()
    with pytest.raises(ss.SceneError, match=r"s_semantic\.ply is missing"):
        ss.load_scene(folder / "s.glb")


@pytest.mark.parametrize(
    ("house", "message"),
    [
        (_house("ASCII 1.0"), r"expected 'ASCII 1\.1'"),
        ("", "an empty file"),
        ("ASCII 1.1\nC 0 x\n", "line 2"),
        ("ASCII 1.1\n", "no category"),
    ],
)
def test_bad_house_files(tmp_path: Path, house: str, message: str) -> None:
    with pytest.raises(ss.SceneError, match=message):
        ss.load_scene(_matterport(tmp_path / "s", house))


def test_bad_ply_files(tmp_path: Path) -> None:
    folder = _replica(tmp_path / "s", False)
    ply = folder / "habitat" / "mesh_semantic.ply"
    whole = ply.read_bytes()
    for damaged, message in (
        (whole[:-20], "cannot be read as a PLY mesh"),
        (whole.replace(b"element face 6", b"element face 9"), "cannot be read as a PLY mesh"),
        (whole.replace(b"vertex_indices", b"vertex_indicez"), "none of the lists"),
        (whole.replace(b"object_id", b"objectt_i"), "no object_id"),
        (b"", "cannot be read as a PLY mesh"),
    ):
        ply.write_bytes(damaged)
        with pytest.raises(ss.SceneError, match=message):
            ss.load_scene(folder)
    with pytest.raises(ss.SceneError, match=r"neither a Replica scene.*nor a Matterport3D"):
        ss.load_scene(tmp_path)


def test_a_mesh_with_no_floor_and_an_open_one_are_explained(tmp_path: Path) -> None:
    corners = np.array([[0, 0, 0], [5, 0, 0], [5, 0, 2.5], [0, 0, 2.5]], float)
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    mesh.export(tmp_path / "wall.ply")
    scene = ss.load_scene(tmp_path / "wall.ply")
    with pytest.raises(ss.SceneError, match="survived"):
        ss.make_grid(scene)
    report = ss.inspect_scene(scene)
    assert report.points == 0 and any("survived" in w for w in report.warnings)


def _eyring(per_m: float, band: tuple[float, float]) -> float:
    """Slope from -5 to -35 dB of the decay curve, the mean over a band of exp(-k x) / k, k what walls and air
    (ISO 9613-1) take per m; in s for 60 dB."""

    def level(x: float) -> float:
        def at(f: float) -> float:
            k = per_m + 0.1 * np.log(10.0) * iso9613.db_per_m(f)
            return float(np.exp(-k * x) / k)

        return float(integrate.quad(at, *band)[0])

    cuts = [
        brentq(lambda x, db=db: 10 * np.log10(level(x) / level(0.0)) - db, 0.0, 400.0)
        for db in (-5.0, -35.0)
    ]
    return 2.0 * (cuts[1] - cuts[0]) / 343.0


@pytest.mark.parametrize("through", [0.0, pytest.param(0.08, marks=CI_SLOW)])
def test_inspect_of_a_box(through: float) -> None:
    """5 x 4 x 2.5 m: V = 50, S = 85, mean free path 4 V / S; Eyring's formula with the air of each band. Walls
    reflect 0.8: what they let through is lost to the room as what they absorb is."""
    scene = box((5.0, 4.0, 2.5), table(0.2 - through, 0.5, through))
    report = ss.inspect_scene(scene)
    assert report.area == pytest.approx(85.0) and report.volume == pytest.approx(50.0, rel=0.02)
    assert report.free_path == pytest.approx(200.0 / 85.0, rel=0.02)
    assert report.escape == 0.0 and report.components == 1
    np.testing.assert_allclose(report.absorption, 0.2, atol=1e-9)
    eyring = np.array([_eyring(-85.0 * np.log(0.8) / 200.0, band) for band in pairwise(DEFAULT_BANDS)])
    np.testing.assert_allclose(report.eyring, eyring, rtol=0.02)
    assert report.closedness[0] == 1.0 and report.points == 80
    from soundspaces_sim.build.inspect import report_text

    # The spread of free paths makes diffuse decays in a box some 4 % longer than Eyring's (Kuttruff, ch. 5).
    assert report.t30_pairs == 12
    assert np.all((report.t30 / eyring > 1.0) & (report.t30 / eyring < 1.08)), report.t30 / eyring
    assert report.default_area == 0.0
    page = report_text(report)
    assert "T30, simulated" in page and "assumes a diffuse field" in page
    assert "mean free path of 2.3" in page and "no face has a label" in page


@ci_slow
def test_a_mesh_in_thousands_of_pieces_is_reported() -> None:
    """A room full of 1,500 loose triangles: loaded, and said."""
    room = box((5.0, 4.0, 2.5), table(0.2, 0.5))
    rng = np.random.default_rng(0)
    loose = rng.uniform([0.5, 0.5, 0.2], [4.5, 3.5, 0.4], (1500, 1, 3)) + rng.normal(
        0, 0.02, (1500, 3, 3)
    )
    vertices = np.concatenate([room.vertices, loose.reshape(-1, 3)])
    faces = np.concatenate([room.faces, len(room.vertices) + np.arange(4500).reshape(-1, 3)])
    scene = ss.Scene(vertices, faces, np.zeros(len(faces), int), room.materials, name="scan")
    report = ss.inspect_scene(scene)
    assert report.components == 1501 and any("1,501 pieces" in w for w in report.warnings)


def _fuzz(data: bytes, rng: np.random.Generator) -> bytes:
    """A mutation: flipped bytes, a piece cut out, doubled, or the end lost; digits made large."""
    out = bytearray(data)
    kind = rng.integers(5)
    if kind == 0 and out:
        for _ in range(int(rng.integers(1, 8))):
            out[int(rng.integers(len(out)))] = int(rng.integers(256))
    elif kind == 1:
        del out[int(rng.integers(len(out) + 1)) :]
    elif kind == 2:
        a, b = sorted(int(x) for x in rng.integers(0, len(out) + 1, 2))
        del out[a : min(b, a + 40)]
    elif kind == 3:
        a = int(rng.integers(len(out) + 1))
        out[a:a] = out[a : a + 30]
    else:
        digits = [i for i, c in enumerate(out) if 48 <= c < 58]
        if digits:
            i = digits[int(rng.integers(len(digits)))]
            out[i : i + 1] = b"99999"
    return bytes(out)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "form",
    ["replica-json", "glb"]
    + [
        pytest.param(f, marks=CI_SLOW)
        for f in ("obj", "replica-ply", "house", "mp3d-ply", "stl", "off", "ply")
    ],
)
def test_damaged_files_give_our_errors_only(tmp_path: Path, form: str) -> None:
    """150 mutations of each: a scene, or an error of ours; never a hang or another exception."""
    rng = np.random.default_rng(sum(form.encode()))
    if form.startswith("replica"):
        source = _replica(tmp_path / "s", True)
        victim = (
            source / "habitat" / ("mesh_semantic.ply" if form.endswith("ply") else "info_semantic.json")
        )
    elif form in ("house", "mp3d-ply"):
        source = _matterport(tmp_path / "s", _house())
        victim = source / ("s.house" if form == "house" else "s_semantic.ply")
    else:
        room = box((6.0, 4.0, 2.5), table(0.1, 0.1))
        source = victim = tmp_path / f"room.{form}"
        trimesh.Trimesh(room.vertices, room.faces, process=False).export(victim)
    whole = victim.read_bytes()
    loaded = 0
    for _ in range(150):
        victim.write_bytes(_fuzz(whole, rng))
        try:
            ss.load_scene(source, ceiling=False)
            loaded += 1
        except ss.SoundSpacesSimError:
            pass
    assert 0 < loaded < 150  # both ends are reached: some are still scenes


@pytest.mark.parametrize(("ceiling", "trees"), [(True, 1), (False, 2)])
def test_embree_builds_its_tree_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ceiling: bool, trees: int
) -> None:
    """The scene that was looked over for missing ceilings is the one that is returned, unless a ceiling was
    added."""
    from soundspaces_sim.scene.rays.caster import RayScene

    built = []
    build = RayScene.__init__

    def counted(self: RayScene, vertices: np.ndarray, faces: np.ndarray) -> None:
        built.append(len(faces))
        build(self, vertices, faces)

    monkeypatch.setattr(RayScene, "__init__", counted)
    scene = ss.load_scene(_replica(tmp_path / "s", True, ceiling=ceiling))
    _ = scene.geometry
    assert len(built) == trees
