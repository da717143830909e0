"""Which axis is up and how long the unit is, guessed from meshes of known frame and said by files beside them."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from tests.marks import few
from tests.rooms import box, table

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def _boxes(*bounds: Box) -> Any:
    return trimesh.util.concatenate([trimesh.creation.box(bounds=b) for b in bounds])


def _corridor() -> Any:
    return _boxes(((0, 0, 0), (12, 2, 2.6)))


def _booth() -> Any:
    return _boxes(((0, 0, 0), (2, 2, 2.6)))


def _house() -> Any:
    """Two storeys of 2.6 m over an L of 10 x 8 m with arms 4 m wide, as closed rooms, a slab of 20 cm between."""
    storey: list[Any] = [((0, 0, 0), (10, 4, 2.6)), ((0, 4, 0), (4, 8, 2.6))]
    return _boxes(*storey, *(((a, b, c + 2.8), (d, e, f + 2.8)) for (a, b, c), (d, e, f) in storey))


def _cube() -> Any:
    return _boxes(((0, 0, 0), (3, 3, 3)))


_SHAPES = {
    "corridor": (_corridor, 1.0),
    "booth": (_booth, 0.5),
    "house": (_house, 1.0),
    "cube": (_cube, 0.8),
}
_EXTENT = {"corridor": (12, 2, 2.6), "booth": (2, 2, 2.6), "house": (10, 8, 5.4), "cube": (3, 3, 3)}


def _furnished(mesh: Any, scale: float) -> Any:
    """A table on four legs, a cupboard and a lamp on the ceiling."""
    top = float(mesh.bounds[1, 2]) if mesh.bounds[1, 2] < 4 else 2.6
    s = scale
    legs = [
        ((0.2 + x * s, 0.2 + y * s, 0), (0.25 + x * s, 0.25 + y * s, 0.7))
        for x in (0, 1)
        for y in (0, 1)
    ]
    items: list[Box] = [
        *legs, ((0.2, 0.2, 0.7), (0.25 + s, 0.25 + s, 0.75)), ((1.5 * s, 0.1, 0), (1.9 * s, 0.5, 1.8)),
        ((0.9 * s, 0.9 * s, top - 0.3), (s, s, top - 0.1)),
    ]  # fmt: skip
    return trimesh.util.concatenate([mesh, _boxes(*items)])


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("furnished", [False, True])
@pytest.mark.parametrize("shape", ["corridor", "booth", "house", "cube"])
@pytest.mark.parametrize("kind", few(["ply", "obj"], "ply"))
def test_rooms_are_set_upright(tmp_path: Path, shape: str, furnished: bool, up: str, kind: str) -> None:
    make, scale = _SHAPES[shape]
    mesh = _furnished(make(), scale) if furnished else make()
    x, y, z = mesh.vertices.T
    v = mesh.vertices if up == "z" else np.stack([x, z, -y], axis=1)
    trimesh.Trimesh(v, mesh.faces, process=False).export(tmp_path / f"room.{kind}")
    scene = ss.load_scene(tmp_path / f"room.{kind}", ceiling=False)
    np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], _EXTENT[shape], atol=1e-4)
    if shape != "cube" or furnished:
        np.testing.assert_allclose(scene.vertices[:, 2], z, atol=1e-4)
    assert any("in doubt" in note for note in scene.notes) == (shape == "cube")


@pytest.mark.usefixtures("no_t30")
def test_doubts_are_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    _cube().export(tmp_path / "cube.ply")
    with caplog.at_level(logging.WARNING):
        scene = ss.load_scene(tmp_path / "cube.ply")
    assert "Z is taken as up" in caplog.text and "--up" in caplog.text
    report = ss.inspect_scene(scene, ss.GridConfig(spacing=1.0, rays=100))
    assert any("--up" in warning for warning in report.warnings)
    caplog.clear()
    ss.load_scene(tmp_path / "cube.ply", up="z", unit="m")
    assert "taken as" not in caplog.text


def _stage(folder: Path, name: str, **attributes: object) -> None:
    (folder / name).write_text(json.dumps(attributes))


@pytest.mark.parametrize("named", [True, False])
def test_a_stage_configuration_beside_a_glb(tmp_path: Path, named: bool) -> None:
    """Z up and centimetres, which habitat's file says and the format does not."""
    trimesh.creation.box(bounds=[[0, 0, 0], [600, 400, 250]]).export(tmp_path / "home.glb")
    asset = {"render_asset": "home.glb"} if named else {}
    _stage(
        tmp_path, "home.stage_config.json", **asset, up=[0, 0, 1], front=[0, 1, 0], units_to_meters=0.01
    )
    _stage(tmp_path, "other.stage_config.json", render_asset="other.glb", up=[0, 1, 0])
    scene = ss.load_scene(tmp_path / "home.glb", ceiling=False)
    np.testing.assert_allclose(scene.bounds, [[0.0, 0.0, 0.0], [6.0, 4.0, 2.5]], atol=1e-6)
    assert sum("so says home.stage_config.json" in note for note in scene.notes) == 2
    turned = ss.load_scene(tmp_path / "home.glb", up="y", unit="cm", ceiling=False)
    np.testing.assert_allclose(turned.bounds[1] - turned.bounds[0], [6.0, 2.5, 4.0], atol=1e-6)


def test_another_name_and_the_datasets_configuration(tmp_path: Path) -> None:
    folder = tmp_path / "stages"
    folder.mkdir()
    for name in ("a.glb", "b.ply"):
        trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [6.0, 4.0, 2.5]]).export(folder / name)
    _stage(folder, "first.stage_config.json", render_asset="a.glb", up=[0, 0, 1])
    _stage(tmp_path, "all.scene_dataset_config.json", stages={"default_attributes": {"up": [0, 1, 0]}})
    sizes: list[tuple[str, list[float]]] = [("a.glb", [6.0, 4.0, 2.5]), ("b.ply", [6.0, 2.5, 4.0])]
    for name, size in sizes:
        scene = ss.load_scene(folder / name, ceiling=False)
        np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], size, atol=1e-6)


@pytest.mark.parametrize(
    "attributes",
    [{"up": [0, 0, -1]}, {"up": "z"}, {"up": [0, 0, 1], "units_to_meters": 0}, {"scale": [1, 2, 1]}],
)
def test_what_a_configuration_cannot_say(tmp_path: Path, attributes: dict[str, object]) -> None:
    trimesh.creation.box(extents=[6, 4, 2.5]).export(tmp_path / "home.glb")
    _stage(tmp_path, "home.stage_config.json", **attributes)
    with pytest.raises(
        ss.SceneError, match=r"home\.stage_config\.json: (up|units_to_meters|scale): expected"
    ):
        ss.load_scene(tmp_path / "home.glb")


@pytest.mark.parametrize(
    ("size", "unit", "doubt"),
    [
        ((32.8, 26.2, 8.9), "m", True),  # 10 x 8 x 2.7 m in feet
        ((12.0, 9.0, 2.7), "m", False),
        ((394.0, 315.0, 106.0), "in", False),
        ((1000.0, 800.0, 270.0), "cm", False),
        ((10000.0, 8000.0, 2700.0), "mm", False),
    ],
)
def test_the_unit_in_which_rooms_are_rooms(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    size: tuple[float, float, float],
    unit: str,
    doubt: bool,
) -> None:
    scene = box(size, table(0.1, 0.1))
    trimesh.Trimesh(scene.vertices, scene.faces, process=False).export(tmp_path / "room.obj")
    with caplog.at_level(logging.WARNING):
        found = ss.load_scene(tmp_path / "room.obj", up="z", ceiling=False)
    metre = {"m": 1.0, "in": 0.0254, "cm": 0.01, "mm": 0.001}[unit]
    np.testing.assert_allclose(found.bounds[1], np.array(size) * metre, rtol=1e-6)
    assert ("--unit" in caplog.text) == doubt
    assert ("2.71 m in ft" in caplog.text) == doubt
    ss.load_scene(tmp_path / "room.obj", up="z", unit="ft", ceiling=False)


def test_the_storeys_of_a_house_in_inches(tmp_path: Path) -> None:
    """5.4 m are 213 inches, which as centimetres is a low room; its storeys are 102 inches high."""
    mesh = _house()
    trimesh.Trimesh(mesh.vertices / 0.0254, mesh.faces, process=False).export(tmp_path / "house.obj")
    scene = ss.load_scene(tmp_path / "house.obj", up="z", ceiling=False)
    np.testing.assert_allclose(scene.bounds[1], [10.0, 8.0, 5.4], rtol=1e-6)
