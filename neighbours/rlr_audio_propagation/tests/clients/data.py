"""The folders that clients' scripts read, with made-up buildings: names and layout of Matterport3D and Gibson.

The building has a floor at 0 m from x -12 to 8 and y -6 to 6 (Z up), two rooms with a door between them at x = -4,
two chairs and a sofa.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh

from tests.ply import write_ply

MP3D = ("UwV83HsGsw3", "17DRP5sb8fy")
_LABELS = ("wall", "chair", "sofa")
_SHELL = ((-12.0, -6.0, 0.0), (8.0, 6.0, 2.8))
_INSIDE = (
    (((-4.1, -6.0, 0.0), (-3.9, -1.0, 2.8)), 0),
    (((-4.1, 1.0, 0.0), (-3.9, 6.0, 2.8)), 0),
    (((-8.0, 3.0, 0.0), (-7.4, 3.6, 0.9)), 1),
    (((2.0, -3.0, 0.0), (2.6, -2.4, 0.9)), 1),
    (((4.0, 4.0, 0.0), (6.0, 5.0, 0.8)), 2),
)


def building() -> tuple[trimesh.Trimesh, np.ndarray]:
    """The mesh, Z up, m, and the (F,) label row of each face."""
    boxes = [(trimesh.creation.box(bounds=_SHELL), 0)]
    boxes += [(trimesh.creation.box(bounds=bounds), label) for bounds, label in _INSIDE]
    whole = trimesh.util.concatenate([box for box, _ in boxes])
    assert isinstance(whole, trimesh.Trimesh)
    return whole, np.repeat([label for _, label in boxes], [len(box.faces) for box, _ in boxes])


def write_tree(root: Path) -> None:
    """Write `data/…` under a folder."""
    mesh, label = building()
    scenes = root / "data" / "scene_datasets"
    for name in MP3D:
        for folder in (scenes / "mp3d" / name, scenes / "mp3d_example" / name, root / "mp3d" / name):
            _write_matterport(folder, name, mesh, label)
    gibson = scenes / "gibson"
    gibson.mkdir(parents=True, exist_ok=True)
    y_up = mesh.copy()
    y_up.vertices = mesh.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    y_up.export(gibson / "Oyens.glb")
    up = {"stages": {"default_attributes": {"up": [0.0, 1.0, 0.0], "front": [0.0, 0.0, -1.0]}}}
    (gibson / "gibson_semantic.scene_dataset_config.json").write_text(json.dumps(up))
    z_up = {"stages": {"default_attributes": {"up": [0.0, 0.0, 1.0], "front": [0.0, 1.0, 0.0]}}}
    for of in ("mp3d", "mp3d_example"):
        (scenes / of / "mp3d.scene_dataset_config.json").write_text(json.dumps(z_up))
    for path in (
        root / "data" / "mp3d_material_config.json",
        root / "src/deps/rlr-audio-propagation/RLRAudioPropagationPkg/data/mp3d_material_config.json",
        root / "SonicSet/material/mp3d_material_config.json",
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            json.dumps({"materials": [_material(n, a) for n, a in (("wall", 0.1), ("chair", 0.6))]})
        )
    (root / "SonicSet/material/mp3d.scene_dataset_config.json").write_text(json.dumps(z_up))


def _material(name: str, absorption: float) -> dict[str, object]:
    """A row of RLR's database, the same at all frequencies."""
    curves = {"absorption": absorption, "scattering": 0.3, "transmission": 0.0, "damping": 0.0}
    flat = {key: [20.0, value, 20000.0, value] for key, value in curves.items()}
    return {"name": name.title(), "labels": [name], "speed": 1484.0, "density": 998.7, **flat}


def _write_matterport(folder: Path, name: str, mesh: trimesh.Trimesh, label: np.ndarray) -> None:
    """A scene in the layout of Matterport3D: `.glb`, `.house`, `_semantic.ply`, and an empty `.navmesh`."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh.export(folder / f"{name}.glb")
    (folder / f"{name}.navmesh").touch()
    categories = "".join(
        f"C {i} {500 + i} {n}_raw {i + 1} {n} 0 0 0 0 0\n" for i, n in enumerate(_LABELS)
    )
    things = "".join(
        f"O {i} 0 {i} 0 0 0 1 0 0 0 1 0 1 1 1 0 0 0 0 0 0 0 0\n" for i in range(len(_LABELS))
    )
    (folder / f"{name}.house").write_text(f"ASCII 1.1\n{categories}{things}")
    kinds = [(axis, "f4") for axis in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")]
    shade = 60.0 + 40.0 * (mesh.vertices[:, 2] / 2.8)
    vertices = np.array([(*v, s, s, 200) for v, s in zip(mesh.vertices, shade, strict=True)], kinds)
    rows = [(f, n) for f, n in zip(mesh.faces, label, strict=True)]
    faces = np.array(rows, [("vertex_indices", "i4", (3,)), ("object_id", "i4")])
    write_ply(folder / f"{name}_semantic.ply", vertices, faces)
