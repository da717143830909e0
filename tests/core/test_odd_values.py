"""Values that pass a first look and would end in an error of another's: each is told, with its setting or its place."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.io.untrusted import parse_json
from soundspaces_sim.dataset.format.collection_manifest import BesideEntry, CollectedScene
from soundspaces_sim.rendering.auralise import as_mono
from soundspaces_sim.transport.model import air_transmission

POINTS = np.array([[1.0, 1.0, 1.2], [3.0, 2.0, 1.2]])


@pytest.mark.parametrize(
    ("given", "setting"),
    [
        ({"duration": 1e-12}, "simulation.duration"),
        ({"duration": 5e-324}, "simulation.duration"),
        ({"max_duration": 1e-12}, "simulation.max_duration"),
        ({"time_grid": ((0, 1e300),)}, "simulation.time_grid"),
        ({"time_grid": ((0, 100.0),)}, "simulation.time_grid"),
        ({"time_grid": ((0, 0.001), (1e300, 0.002))}, "simulation.time_grid"),
        ({"time_grid": ((0, float("nan")),)}, "simulation.time_grid"),
    ],
)
def test_settings_of_a_simulation(given: dict[str, Any], setting: str) -> None:
    with pytest.raises(ss.ConfigError, match=f"{setting}: expected .*got"):
        ss.SimulationConfig(**given)


@pytest.mark.parametrize("spacing", [1e-300, 1e-4, float("nan"), float("inf")])
def test_spacing(spacing: float) -> None:
    with pytest.raises(ss.ConfigError, match=r"grid\.spacing: expected 0\.001 to 1000 m"):
        ss.GridConfig(spacing=spacing)


@pytest.mark.parametrize("duration", [1e-3, 0.0011])
def test_the_least_duration_is_simulated(duration: float) -> None:
    config = ss.SimulationConfig(walks=16, duration=duration)
    found = ss.simulate(ss.shoebox((4.0, 3.0, 2.5)), POINTS[:1], POINTS[1:], config)
    assert np.isfinite(found.energy).all()


@pytest.mark.parametrize("audio", ["x", [object()], [[1.0], [1.0, 2.0]], [1j], ["1", "x"], [10**400]])
def test_sounds_that_are_none(audio: Any) -> None:
    with pytest.raises(ss.ConfigError, match="audio: expected a mono signal of numbers, got"):
        as_mono(audio)


def test_scenes_beyond_measure() -> None:
    with pytest.raises(ss.SceneError, match="is no room; expected lengths in m"):
        ss.shoebox((1e5, 1e5, 1e5))
    box = ss.shoebox((4.0, 3.0, 2.5))
    with pytest.raises(
        ss.SceneError, match=r"span 4e\+05 m, where 20,000 m is the most .*check the unit"
    ):
        ss.Scene(1e5 * box.vertices, box.faces, box.face_material, box.materials)


@pytest.mark.parametrize("length", [1e9, float("inf"), float("nan")])
def test_far_points_are_told_before_air_is_tabulated(length: float) -> None:
    with pytest.raises(ss.PointError, match="sound goes"):
        air_transmission(ss.SimulationConfig(), np.array([1.0, length]))


@pytest.mark.parametrize("end", ["\n", "\r\n", "\x00", " "])
def test_names_do_not_end_in_a_line(end: str) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"file": f"a{end}", "bytes": 0, "sha256": ""}, BesideEntry)
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"scene": f"a{end}", "points": 0, "bytes": 0, "sha256": ""}, CollectedScene)


def test_files_of_the_longest_names_are_published(tmp_path: Path) -> None:
    path = tmp_path / ("n" * 252 + ".h5")
    publish(path, b"x")
    assert path.read_bytes() == b"x" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("number", ["9" * 400, "-" + "9" * 400, "1e400", "-1e999", "9" * 5000])
def test_numbers_of_json_are_finite(number: str) -> None:
    with pytest.raises(DatasetError, match=r"a\.json: this file is not valid JSON"):
        parse_json(f'{{"x": {number}}}', "a.json", DatasetError, "file")


_TRIANGLE = (
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
)


def _gltf(path: Path, **more: Any) -> Path:
    data = "data:application/octet-stream;base64," + base64.b64encode(_TRIANGLE).decode()
    views = [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}]
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
    ]
    tree = {
        "asset": {"version": "2.0"}, "buffers": [{"byteLength": len(_TRIANGLE), "uri": data}], "bufferViews": views,
        "accessors": accessors, "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"children": [1], "translation": [5, 0, 0]}, {"mesh": 0}],
    }  # fmt: skip
    path.write_text(json.dumps({**tree, **more}))
    return path


@pytest.mark.parametrize("more", [{}, {"scenes": []}, {"scenes": [{"nodes": [0]}]}])
def test_a_gltf_without_a_scene_is_all_its_nodes(tmp_path: Path, more: dict[str, Any]) -> None:
    """glTF 2.0, 3.5.1: a file may have none. A node within another stands where that puts it, and once."""
    scene = ss.load_scene(_gltf(tmp_path / "a.gltf", **more), up="z")
    assert len(scene.faces) == 1 and scene.vertices[:, 0].min() == 5.0


@pytest.mark.parametrize("scene", [5, -1, "x", True, 0.5])
def test_a_scene_of_a_gltf_that_there_is_not(tmp_path: Path, scene: Any) -> None:
    with pytest.raises(ss.SceneError, match=r"a\.gltf: .*it names scene .* of 1"):
        ss.load_scene(_gltf(tmp_path / "a.gltf", scene=scene, scenes=[{"nodes": [0]}]))


def test_3mf_without_lxml_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.3mf").write_bytes(b"PK")
    monkeypatch.setattr("soundspaces_sim.scene.formats.mesh.find_spec", lambda _: None)
    with pytest.raises(
        ss.SceneError, match=r"a\.3mf: 3MF files need the lxml package: `pip install lxml`"
    ):
        ss.load_scene(tmp_path / "a.3mf")
