"""Meshes and texts of strangers: what they declare, repeat, nest or point to costs no more than they are
large."""

from __future__ import annotations

import base64
import copy
import json
import os
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from tests.attack.victims import _gltf
from tests.rooms import box, table
from tests.scene.test_formats import _house, _matterport, _replica

ROOT = Path(__file__).resolve().parents[2]
ROOM = box((6.0, 4.0, 2.5), table(0.1, 0.1))
V, F = np.asarray(ROOM.vertices, "<f4"), np.asarray(ROOM.faces, "<u4")


def _tree(folder: Path, change: Callable[[dict], None]) -> Path:  # type: ignore[type-arg]
    path = folder / "room.gltf"
    _gltf(path, V, F)
    tree = json.loads(path.read_text())
    change(tree)
    path.write_text(json.dumps(tree))
    return path


def _as_it_is(_: dict) -> None:  # type: ignore[type-arg]
    pass


def _doubled(tree: dict) -> None:  # type: ignore[type-arg]
    """Thirty nodes, each of which holds the next one twice."""
    tree["nodes"] = [{"children": [i + 1, i + 31]} for i in range(30)] + [{"mesh": 0}]
    tree["nodes"] += [{"children": [i + 1 if i < 30 else 30]} for i in range(1, 31)]


def _chain(tree: dict) -> None:  # type: ignore[type-arg]
    tree["nodes"] = [{"children": [i + 1]} for i in range(5000)] + [{"mesh": 0}]


def _many(tree: dict) -> None:  # type: ignore[type-arg]
    """A mesh of a hundred equal parts at ten thousand places."""
    tree["meshes"][0]["primitives"] *= 100
    tree["nodes"] = [{"mesh": 0}] * 10**4
    tree["scenes"] = [{"nodes": list(range(10**4))}]


def _views(tree: dict) -> None:  # type: ignore[type-arg]
    tree["bufferViews"] += [tree["bufferViews"][0]] * 10**5


def written(path: Path, text: str | bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def _replica_of(folder: Path, old: str, new: str) -> Path:
    scene = _replica(folder, True)
    info = scene / "habitat" / "info_semantic.json"
    info.write_text(info.read_text().replace(old, new, 1))
    return scene


def _far_id(folder: Path) -> Path:
    scene = _replica(folder, True)
    mesh = scene / "habitat" / "mesh_semantic.ply"
    mesh.write_bytes(mesh.read_bytes()[:-4] + struct.pack("<i", 2**31 - 1))
    return scene


def zipped(path: Path, unpacked: int) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("room.obj", b"#" * unpacked)
        archive.writestr("room.dae", b" " * unpacked)
    return path


def _bomb(path: Path) -> Path:
    """A file of 10^7 bytes under a hundred names."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("room.obj", b"#" * 10**7)
        for k in range(99):
            again = copy.copy(archive.filelist[0])
            again.filename = f"room{k}.obj"
            archive.filelist.append(again)
    with zipfile.ZipFile(path) as archive:
        assert sum(entry.file_size for entry in archive.infolist()) == 10**9
    return path


def _house_of(folder: Path, text: str) -> Path:
    return _matterport(folder, text)


_PLY = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
#: What is made, and what the error says; None: it is read.
HOSTILE: dict[str, tuple[Callable[[Path], Path], str | None]] = {
    "binary PLY of 10^12 vertices": (lambda d: written(d / "a.ply", _PLY.format("binary_little_endian", 10**12)), "declares"),
    "PLY of 10^9 vertices": (lambda d: written(d / "a.ply", _PLY.format("ascii", 10**9)), "declares"),
    "Replica PLY of 10^12": (lambda d: written(_replica(d, True) / "habitat" / "mesh_semantic.ply", _PLY.format("ascii", 10**12)).parents[1], "declares"),
    "OFF of 10^12": (lambda d: written(d / "a.off", f"OFF\n{10**12} 1 0\n0 0 0\n"), "cannot be read"),
    "STL of 2^32 - 1": (lambda d: written(d / "a.stl", b" " * 80 + b"\xff" * 4 + b"\0" * 50), "cannot be read|no faces"),
    "archive": (lambda d: zipped(d / "a.zip", 100), "not supported"),
    "archive that unpacks to 10^9 bytes": (lambda d: _bomb(d / "a.zip"), "not supported"),
    "compressed tar": (lambda d: written(d / "a.tar.gz", b"\x1f\x8b" + b"\0" * 50), "not supported"),
    "glTF that declares 10^10 corners": (lambda d: _tree(d, lambda t: t["accessors"].append({"componentType": 5126, "count": 10**10, "type": "VEC3"})), "declares"),
    "glTF with a negative count": (lambda d: _tree(d, lambda t: t["accessors"][0].update(count=-3)), "whole number"),
    "glTF whose views overlap": (lambda d: _tree(d, _views), "declares"),
    "glTF that doubles thirty times": (lambda d: _tree(d, _doubled), "corners"),
    "glTF of a part at a million places": (lambda d: _tree(d, _many), "corners"),
    "glTF in itself": (lambda d: _tree(d, lambda t: t["nodes"][1].update(children=[0])), "in themselves"),
    "glTF 5,000 deep": (lambda d: _tree(d, _chain), "deep"),
    "glTF that reads elsewhere": (lambda d: _tree(d, lambda t: t["buffers"][0].update(uri="../secret.bin")), "not a file beside it"),
    "glTF that reads an absolute path": (lambda d: _tree(d, lambda t: t["buffers"][0].update(uri="/etc/passwd")), "not a file beside it"),
    "glTF that reads the net": (lambda d: _tree(d, lambda t: t["buffers"][0].update(uri="http://example.com/x")), "not a file beside it"),
    "glTF that is nested": (lambda d: written(d / "a.gltf", "[" * 10**5), "nested"),
    "glTF with a picture elsewhere": (lambda d: _tree(d, lambda t: t.update(images=[{"uri": "/dev/zero"}], textures=[{"source": 0}], materials=[{"name": "brick", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}])), None),
    "OBJ with a line of blanks": (lambda d: written(d / "a.obj", f"v 0 0 0\nusemtl a{' ' * 10**6}b\no a{' ' * 10**6}b\n"), "no faces"),
    "Replica's ids up to 2^31 - 1": (_far_id, None),
    "Replica's JSON 10^5 deep": (lambda d: _replica_of(d, "[", "[" * 10**5), "nested"),
    "Replica's JSON with a long label": (lambda d: _replica_of(d, '"ceiling"', json.dumps(" ".join(["wall"] * 10**5))), None),
    "Replica's JSON with a long number": (lambda d: _replica_of(d, "31", "9" * 5000), "not valid JSON|expected"),
    "a .house with long numbers": (lambda d: _house_of(d, _house().replace("C  0", "C  " + "9" * 5000)), "line"),
    "glTF whose mesh is compressed": (lambda d: _tree(d, lambda t: t.update(extensionsRequired=["KHR_draco_mesh_compression"])), "compressed"),
    "another kind": (lambda d: written(d / "a.xyz", "0 0 0\n"), "not supported"),
}  # fmt: skip

_LOAD = """
import json, logging, resource, sys
import soundspaces_sim as ss
logging.disable()
ss.load_scene(sys.argv[1])
held = int(open("/proc/self/statm").read().split()[0]) * 4096
resource.setrlimit(resource.RLIMIT_AS, (held + 2**30, held + 2**30))
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
for path in sys.argv[2:]:
    try:
        ss.load_scene(path, ceiling=False)
        said = None
    except ss.SceneError as error:
        said = str(error)
    except Exception as error:
        said = f"FOREIGN {error!r}"
    print(json.dumps(said), flush=True)
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str | None]:
    return said_of(HOSTILE, tmp_path_factory.mktemp("hostile"))


def said_of(
    hostile: Mapping[str, tuple[Callable[[Path], Path], str | None]], folder: Path
) -> dict[str, str | None]:
    """What loading each says, in one process of 1 GiB and 60 s."""
    trimesh.Trimesh(V, F, process=False).export(folder / "room.obj")
    paths = []
    for i, (make, _) in enumerate(hostile.values()):
        (folder / str(i)).mkdir()
        paths.append(make(folder / str(i)))
    done = subprocess.run(
        [sys.executable, "-c", _LOAD, str(folder / "room.obj"), *map(str, paths)],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(lines) == len(hostile), (list(hostile)[len(lines)], done.returncode, done.stderr[-2000:])
    return dict(zip(hostile, lines, strict=True))


@pytest.mark.parametrize("name", HOSTILE)
def test_costs_are_bounded_by_the_size(said: dict[str, str | None], name: str) -> None:
    import re

    expected = HOSTILE[name][1]
    if expected is None:
        assert said[name] is None
    else:
        assert said[name] is not None and re.search(expected, str(said[name])), said[name]


def test_buffers_and_labels_of_gltf_are_read(tmp_path: Path) -> None:
    """Inline, and from a file beside it; materials' names are labels; nodes' places are kept."""
    inline = _tree(tmp_path, _as_it_is)
    data = base64.b64decode(json.loads(inline.read_text())["buffers"][0]["uri"].split(",")[1])
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "room data.bin").write_bytes(data)
    beside = _tree(tmp_path / "b", lambda tree: tree["buffers"][0].update(uri="room%20data.bin"))
    for path in (inline, beside):
        scene = ss.load_scene(path, up="z")
        np.testing.assert_allclose(scene.bounds, np.array([[1.0, 0.0, 0.0], [7.0, 4.0, 2.5]]))
        assert set(scene.labels) == {"brick"}


@pytest.mark.parametrize("end", ["obj", "ply", "glb", "gltf", "stl", "toml", "house"])
def test_pipes_do_not_hang(tmp_path: Path, end: str) -> None:
    path = tmp_path / f"pipe.{end}"
    if end == "house":
        scene = _matterport(tmp_path / "s", _house())
        (scene / "s.house").unlink()
        path = scene / "s.house"
    os.mkfifo(path)
    with pytest.raises(ss.SoundSpacesSimError, match=r"not a regular file|unknown scene"):
        if end == "toml":
            ss.load_config(path)
        else:
            ss.load_scene(path.parent if end == "house" else path)


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 10**5, "a = " + "9" * 5000, "a.b." * 10**5 + "c = 1", "\xff", "[a]\n" * 2]
)
def test_toml_that_cannot_be(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ss.ConfigError):
        ss.load_config(path)
    with pytest.raises(ss.MaterialError):
        ss.load_scene(_replica(tmp_path / "s", True), materials=path)
