"""`load_scene`: a name or a path to a `Scene`."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from soundspaces_sim.base.errors import SceneError
from soundspaces_sim.loaders.formats.demo import demo_mesh
from soundspaces_sim.loaders.formats.matterport import find_matterport, load_matterport
from soundspaces_sim.loaders.formats.mesh import UNITS, UPS, load_mesh
from soundspaces_sim.loaders.formats.replica import find_replica, load_replica
from soundspaces_sim.loaders.labelled import LabelledMesh
from soundspaces_sim.loaders.mend.decimate import decimate_mesh
from soundspaces_sim.loaders.mend.lid import add_lid
from soundspaces_sim.scene.materials import (
    MaterialTable,
    assign_materials,
    load_labels,
    load_materials,
    overlay,
)
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import areas

_log = logging.getLogger(__name__)

BUILT_IN: Mapping[str, Callable[[], LabelledMesh]] = {"demo": demo_mesh}


def load_scene(
    source: str | Path,
    *,
    materials: MaterialTable | str | Path | None = None,
    labels: Mapping[str, str] | str | Path | None = None,
    up: str | None = None,
    unit: str | None = None,
    strict_materials: bool = False,
    lid: bool | None = None,
    decimate: float | None = None,
) -> Scene:
    """Load a scene by built-in name or path.

    Parameters
    ----------
    source : 'demo', a Replica or Matterport3D scene folder, or a mesh file (OBJ, PLY, GLB, STL, OFF, DAE, …)
    materials : a table, or a TOML file in the format of materials/materials.toml, put on top of the
        built-in database
    labels : material name per label, as a mapping or a TOML file; put on top of the built-in map
    strict_materials : a label without a material is an error
    lid : cover what has no ceiling; None does so where rays from the floor escape upward (see `lid`)
    decimate : share of the faces to keep, in (0, 1); see `decimate`
    up, unit : 'y' or 'z', and 'm', 'cm', 'mm', 'in' or 'ft': override what the file says or seems to say

    What was assumed is in `scene.notes` and is logged. Raises `SceneError` or `MaterialError`.
    """
    if up is not None and up not in UPS:
        raise SceneError(f"up: expected one of {', '.join(UPS)}, got {up!r}")
    if unit is not None and unit not in UNITS:
        raise SceneError(f"unit: expected one of {', '.join(UNITS)}, got {unit!r}")
    table = load_materials()
    if materials is not None:
        own = materials if isinstance(materials, MaterialTable) else load_materials(materials)
        table = overlay(table, own)
    mesh = _load(source, up, unit)
    if decimate is not None:
        mesh = decimate_mesh(mesh, decimate)
    label_map = load_labels(labels)
    area = areas(mesh.vertices[mesh.faces])
    rows = assign_materials(mesh.labels, mesh.face_label, area, table, label_map, strict_materials)
    scene = _scene(mesh, rows, table)
    if lid is not False:
        covered = add_lid(mesh, scene, always=lid is True)
        if covered is not mesh:
            added = covered.face_label[len(rows) :]
            of_lid = assign_materials(covered.labels, added, np.ones(len(added)), table, label_map)
            scene = _scene(covered, np.concatenate([rows, of_lid]), table)
    for note in scene.notes:
        _log.info("%s: %s", scene.name, note)
    return scene


def _scene(mesh: LabelledMesh, rows: np.ndarray, table: MaterialTable) -> Scene:
    return Scene(
        mesh.vertices, mesh.faces, rows, table, mesh.labels, mesh.face_label, mesh.name, mesh.notes
    )


def _load(source: str | Path, up: str | None, unit: str | None) -> LabelledMesh:
    if str(source) in BUILT_IN:
        return BUILT_IN[str(source)]()
    path = Path(source)
    if path.is_dir():
        if folder := find_replica(path):
            return load_replica(folder)
        if files := find_matterport(path):
            return load_matterport(*files)
        raise SceneError(
            f"{path}: this folder is neither a Replica scene (habitat/mesh_semantic.ply and "
            "habitat/info_semantic.json) nor a Matterport3D one (<scene>.house and <scene>_semantic.ply); "
            "give the path of a mesh file instead"
        )
    if not path.exists():
        raise SceneError(
            f"unknown scene '{source}': neither a built-in scene ({', '.join(BUILT_IN)}) nor an "
            "existing path"
        )
    return load_mesh(path, up, unit)
