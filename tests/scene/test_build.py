"""Scenes from arrays, from trimesh objects, and rectangular rooms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.scene.materials import load_materials
from tests.rooms import box, table

ROOM = box((6.0, 4.0, 2.5), table(0.1, 0.1))


def _of_faces(scene: ss.Scene) -> np.ndarray:
    """(F, 3) absorption, scattering, transmission at 1 kHz of every face."""
    k = int(np.searchsorted(scene.materials.frequency_hz, 1000.0))
    m = scene.materials
    return np.stack(
        [v[scene.face_material, k] for v in (m.absorption, m.scattering, m.transmission)], axis=1
    )


def test_arrays_with_one_absorption_one_per_face_and_names() -> None:
    v, f = ROOM.vertices, ROOM.faces
    np.testing.assert_allclose(
        _of_faces(ss.Scene.from_arrays(v, f, 0.2)), np.tile([0.2, 0.5, 0.0], (12, 1))
    )
    each = np.linspace(0.0, 1.0, 12)
    scene = ss.Scene.from_arrays(v.tolist(), f.tolist(), each, scattering=0.3, transmission=0.0)
    np.testing.assert_allclose(
        _of_faces(scene), np.stack([each, np.full(12, 0.3), np.zeros(12)], axis=1)
    )
    named = ss.Scene.from_arrays(v, f, "brick")
    built_in = load_materials()
    np.testing.assert_allclose(_of_faces(named)[:, 0], built_in.absorption[built_in.index("brick"), 3])
    mixed = ss.Scene.from_arrays(v, f, ["brick"] * 6 + ["glass"] * 6)
    assert [mixed.materials.names[i] for i in mixed.face_material] == ["brick"] * 6 + ["glass"] * 6
    own = ss.MaterialTable(("cork",), np.array([1000.0]), *np.array([[[0.33]], [[0.1]], [[0.0]]]))
    assert _of_faces(ss.Scene.from_arrays(v, f, "cork", materials=own))[0].tolist() == [0.33, 0.1, 0.0]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"faces": [[0, 1, 99]]}, ss.SceneError, "reach 0..99, but there are 8 vertices"),
        ({"faces": [[0, 1, -1]]}, ss.SceneError, r"reach -1\.\.1"),
        ({"faces": [[0, 1]]}, ss.SceneError, "faces need shape"),
        ({"faces": [[0, 1], [2]]}, ss.SceneError, "faces need shape"),
        ({"faces": [[0.0, 1.0, 2.0]]}, ss.SceneError, "integers"),
        ({"vertices": []}, ss.SceneError, "vertices need shape"),
        ({"vertices": [["a", "b", "c"]]}, ss.SceneError, "expected numbers"),
        ({"absorption": 1.5}, ss.MaterialError, r"must lie in \[0, 1\]"),
        ({"absorption": float("nan")}, ss.MaterialError, r"must lie in \[0, 1\]"),
        ({"absorption": [0.1, 0.2]}, ss.MaterialError, r"one per face \(12\), got 2"),
        ({"absorption": 0.7, "transmission": 0.7}, ss.MaterialError, "may not exceed 1"),
        ({"absorption": "fog"}, ss.MaterialError, "no material 'fog'"),
        ({"absorption": ["brick"] + [0.1] * 11}, ss.MaterialError, "got both"),
        ({"scattering": [0.1, 0.2]}, ss.MaterialError, "scattering: expected"),
    ],
)
def test_bad_arrays(change: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        ss.Scene.from_arrays(**{"vertices": ROOM.vertices, "faces": ROOM.faces, **change})


def test_scene_itself_refuses_what_is_no_scene() -> None:
    with pytest.raises(ss.SceneError, match="there are 0 vertices"):
        ss.Scene(np.empty((0, 3)), np.array([[0, 1, 2]]), np.array([0]), table(0.1, 0.1))
    with pytest.raises(ss.SceneError, match=r"expected a MaterialTable, got str.*from_arrays"):
        ss.Scene(ROOM.vertices, ROOM.faces, np.zeros(12, int), "brick")  # type: ignore[arg-type]
    with pytest.raises(ss.SceneError, match="arrays of numbers"):
        ss.Scene([["x"]], ROOM.faces, np.zeros(12, int), table(0.1, 0.1))  # type: ignore[arg-type]


def _named(low: float, name: str) -> Any:
    mesh: Any = trimesh.creation.box(bounds=[[low, 0.0, 0.0], [low + 1.0, 1.0, 1.0]])
    visual: Any = trimesh.visual
    mesh.visual = visual.TextureVisuals(material=visual.material.SimpleMaterial(name=name))
    return mesh


def test_trimesh_objects() -> None:
    plain = trimesh.creation.box(extents=[4.0, 3.0, 2.5])
    scene = ss.Scene.from_trimesh(plain, absorption=0.25, name="mine")
    assert scene.name == "mine" and len(scene.faces) == 12 and _of_faces(scene)[0, 0] == 0.25
    assert (
        ss.Scene.from_trimesh(plain, "marble").materials.names[
            ss.Scene.from_trimesh(plain, "marble").face_material[0]
        ]
        == "marble"
    )
    default = ss.Scene.from_trimesh(plain)
    assert {default.materials.names[i] for i in default.face_material} == {"default"}
    both = trimesh.Scene([_named(0.0, "brick wall"), _named(2.0, "gizmo")])
    both.apply_translation([10.0, 0.0, 0.0])
    scene = ss.Scene.from_trimesh(both, labels={"gizmo": "glass"})
    np.testing.assert_allclose(scene.bounds, [[10, 0, 0], [13, 1, 1]])
    left = scene.corners[:, :, 0].max(axis=1) < 11.5
    names = np.array(scene.materials.names)[scene.face_material]
    assert set(names[left]) == {"brick"} and set(names[~left]) == {"glass"}
    with pytest.raises(ss.SceneError, match=r"expected a trimesh\.Trimesh.*got dict"):
        ss.Scene.from_trimesh({})
    broken = trimesh.Trimesh(ROOM.vertices, [[0, 1, 99]], process=False, validate=False)
    with pytest.raises(ss.SceneError, match=r"reach 0\.\.99"):
        ss.Scene.from_trimesh(broken)


def test_load_scene_takes_what_simulate_takes(tmp_path: Path) -> None:
    mesh = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [6.0, 4.0, 2.5]])
    scene = ss.load_scene(mesh, ceiling=False)
    np.testing.assert_allclose(scene.bounds, [[0.0, 0.0, 0.0], [6.0, 4.0, 2.5]])
    assert ss.load_scene(scene) is scene
    with pytest.raises(ss.SceneError, match="is a Scene already"):
        ss.load_scene(scene, unit="cm")
    for wrong in (3, None, [1, 2], object()):
        with pytest.raises(ss.SceneError, match="expected a scene's name, a path"):
            ss.load_scene(wrong)
    config = ss.SimulationConfig(
        walks=16,
        connections=ss.ConnectionsConfig(subpaths=0),
        radiance_transfer=ss.RadianceTransferConfig(enabled=False),
        duration=0.05,
    )
    mesh.export(tmp_path / "room.stl")
    points = [[1.0, 1.0, 1.2]], [[4.0, 2.0, 1.2]]
    direct = [
        ss.simulate(source, *points, config)[0, 0].direct
        for source in (scene, mesh, tmp_path / "room.stl", "demo")
    ]
    assert direct[0] is not None and direct[1] is not None and direct[2] is not None
    assert direct[0].delay == direct[1].delay == pytest.approx(np.sqrt(10.0) / 343.0)
    for function in (ss.make_grid, ss.inspect_scene):
        with pytest.raises(ss.SceneError, match="expected a Scene, got str"):
            function("demo")  # type: ignore[arg-type]


def test_shoebox() -> None:
    """Walls where pyroomacoustics has them: west and east across x, south and north across y."""
    walls = {"west": 0.1, "east": 0.2, "south": 0.3, "north": 0.4, "floor": 0.5, "ceiling": 0.6}
    scene = ss.shoebox((5.0, 4.0, 3.0), walls)
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [5, 4, 3]])
    middle = scene.corners.mean(axis=1)
    absorption = _of_faces(scene)[:, 0]
    for wall, axis, at in (
        ("west", 0, 0),
        ("east", 0, 5),
        ("south", 1, 0),
        ("north", 1, 4),
        ("floor", 2, 0),
        ("ceiling", 2, 3),
    ):
        chosen = np.isclose(middle[:, axis], at)
        assert chosen.sum() == 2 and np.all(absorption[chosen] == walls[wall])
    inward = (scene.normals * (np.array([2.5, 2.0, 1.5]) - middle)).sum(axis=1)
    assert np.all(inward > 0.0)
    assert trimesh.Trimesh(scene.vertices, scene.faces, process=False).volume == pytest.approx(-60.0)
    named = ss.shoebox((5.0, 4.0, 3.0), dict.fromkeys(walls, "brick"))
    assert {named.materials.names[i] for i in named.face_material} == {"brick"}
    for bad in ((5.0, 4.0), (5.0, 4.0, 0.0), (5.0, 4.0, float("nan")), "large"):
        with pytest.raises(ss.SceneError, match="size"):
            ss.shoebox(bad)
    with pytest.raises(
        ss.MaterialError, match=r"each of west, east, south, north, floor, ceiling, got west"
    ):
        ss.shoebox((5.0, 4.0, 3.0), {"west": 0.1})
