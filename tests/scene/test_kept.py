"""What is kept on disk of loading a large mesh: the same scene to the bit, or made again."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.core.io import disk_cache
from soundspaces_sim.scene import kept, load, scene
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.rays import overlaps
from tests.marks import CI_SLOW, few

MAKERS = (load, "to_scene_frame"), (kept, "add_ceiling"), (scene, "find_overlaps")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache that takes everything, of meshes of any size."""
    monkeypatch.setenv("SOUNDSPACES_SIM_CACHE", str(tmp_path))
    monkeypatch.setattr(disk_cache, "_WORTH_S", -1.0)
    monkeypatch.setattr(scene, "_LARGE", 100)
    return tmp_path / "scenes"


def _mesh(labels: tuple[str, ...] = ("wall", "carpet")) -> LabelledMesh:
    """A room without a ceiling, in mm and Y up as nobody says, with a hole and a carpet in the floor's plane."""
    room: Any = trimesh.creation.box([6000.0, 2800.0, 5000.0]).subdivide_to_size(150.0)
    top = (room.triangles[:, :, 1] > 1399.0).all(axis=1)
    faces = np.delete(room.faces[~top], 40, axis=0)
    carpet = np.array([[-900.0, -1400.0, -900.0], [900.0, -1400.0, -900.0], [0.0, -1400.0, 900.0]])
    count = len(room.vertices)
    return LabelledMesh(
        np.concatenate([room.vertices, carpet]),
        np.concatenate([faces, [[count, count + 1, count + 2]]]),
        labels,
        np.concatenate(
            [np.zeros(len(faces), int) if labels else np.full(len(faces), -1), [len(labels) - 1]]
        ),
        "room",
        up=None,
        metre=None,
    )


def _forbidden(*_: Any, **__: Any) -> None:
    raise AssertionError("it was kept")


def _same(one: ss.Scene, other: ss.Scene) -> None:
    for name in ("vertices", "faces", "face_material", "face_label"):
        first, second = getattr(one, name), getattr(other, name)
        np.testing.assert_array_equal(first, second)
        assert first.dtype == second.dtype
    assert one.notes == other.notes and one.labels == other.labels and one.digest == other.digest
    for first, second in zip(one.overlaps, other.overlaps, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    "labels",
    [
        ("wall", "an unknown thing"),
        *(pytest.param(labels, marks=CI_SLOW) for labels in (("wall", "carpet"), ())),
    ],
)
def test_a_kept_scene_is_the_same(
    labels: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """And the same is said of it, warnings too, without what takes long."""
    mesh = _mesh(labels)
    with monkeypatch.context() as patch:
        patch.setattr(scene, "_LARGE", 10**9)
        plain = ss.load_scene(mesh)
    assert any("holes" in note for note in plain.notes) and any("ceiling" in n for n in plain.notes)
    assert any("Y is taken" in note for note in plain.notes)
    told = []
    for again in (False, True):
        caplog.clear()
        with caplog.at_level(logging.INFO), monkeypatch.context() as patch:
            for module, name in MAKERS if again else ():
                patch.setattr(module, name, _forbidden)
            _same(ss.load_scene(mesh), plain)
        told.append([(r.levelname, r.getMessage()) for r in caplog.records])
    assert told[0] == told[1] and len(told[0]) > 0


def test_other_options_and_meshes_are_others() -> None:
    mesh = _mesh()
    one = ss.load_scene(mesh)
    assert ss.load_scene(mesh, ceiling=False).notes != one.notes
    assert ss.load_scene(mesh, up="y", unit="ft").bounds[1, 2] > 100.0 * one.bounds[1, 2]
    moved = replace(mesh, vertices=mesh.vertices + [1000.0, 0.0, 0.0])
    np.testing.assert_allclose(ss.load_scene(moved).center - one.center, [1.0, 0.0, 0.0], atol=1e-9)
    labelled = ss.load_scene(replace(mesh, labels=("carpet", "wall")))
    assert labelled.digest != one.digest


@pytest.mark.parametrize("damage", few(["cut", "flipped", "another's"], "flipped"))
def test_what_is_damaged_is_made_again(
    damage: str, cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = _mesh()
    one = ss.load_scene(mesh)
    files = sorted(cache.glob("*.arrays"))
    assert len(files) >= 3
    contents = [file.read_bytes() for file in files]
    for k, file in enumerate(files):
        content = bytearray(contents[k - 1] if damage == "another's" else contents[k])
        if damage == "flipped":
            content[len(content) // 2] ^= 1
        file.write_bytes(content[:-5] if damage == "cut" else content)
    _same(ss.load_scene(mesh), one)
    assert sum("made again" in record.getMessage() for record in caplog.records) >= 3


@pytest.mark.parametrize("what", ["index", "label", "nan", "notes", "type"])
def test_what_does_not_fit_is_refused(what: str) -> None:
    """As a file would have it that is sealed with the right digest."""
    notes = kept._packed(("one", "two"))
    faces, label = np.array([[0, 1, 2]]), np.array([0])
    vertices = np.eye(3)
    good = kept._Mesh(vertices, faces, label, notes)
    assert kept._fits(good, kept._MESH) and kept._notes(notes) == ("one", "two")
    bad = {
        "index": good._replace(faces=faces + 1),
        "label": good._replace(face_label=label[:0]),
        "nan": good._replace(vertices=vertices * np.nan),
        "notes": good._replace(notes=np.frombuffer(b"[1, 2]", np.uint8)),
        "type": good._replace(vertices=vertices.astype(np.float32)),
    }[what]
    try:
        assert not kept._fits(bad, kept._MESH)
    except Exception as error:
        assert type(error).__module__.startswith("msgspec")


def test_overlaps_beyond_the_faces_are_refused() -> None:
    row, area, flag = np.array([1]), np.array([0.5]), np.array([False])
    found = overlaps.Overlaps(row, row, area, flag)
    assert overlaps.are_pairs(found, 2)
    assert not overlaps.are_pairs(found, 1)
    assert not overlaps.are_pairs(found._replace(below=-row), 2)
    assert not overlaps.are_pairs(found._replace(area=area * np.nan), 2)
