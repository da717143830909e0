"""`load_scene`: a name, a path or a mesh in memory to a `Scene`."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.extras import install_hint
from soundspaces_sim.scene.arrays import mesh_arrays
from soundspaces_sim.scene.beside import with_frame_beside
from soundspaces_sim.scene.formats import accepted, find_format
from soundspaces_sim.scene.frame import DOUBT, to_scene_frame
from soundspaces_sim.scene.holes import close_holes
from soundspaces_sim.scene.kept import kept_ceiling, kept_mesh
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.labels import LabelMap, assign_materials, load_labels
from soundspaces_sim.scene.materials import MaterialTable, stack_materials
from soundspaces_sim.scene.porous_layers import with_free_sheets
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import areas, corners_of, pieces_of, welded_faces

_LEAST_FACES = 64  # of a piece that is worth it
_AREA_CHANGE = 0.03  # share of a piece's area,
_HOLE = 0.2  # m2, and no more than this: a hole in a wall is heard
_BOUNDS_CHANGE = 0.02  # m


def decimate_mesh(mesh: LabelledMesh, share: float) -> LabelledMesh:
    """Keep about `share` (0 to 1) of the faces of every piece that stands it.

    A new face takes the label of the nearest old face of its piece. benchmarks/RESULTS.md shows what it does
    to the sound. Raises `SceneError`.
    """
    if not 0.0 < share < 1.0:
        raise SceneError(f"decimate: expected a share of the faces above 0 and below 1, got {share}")
    try:
        import fast_simplification
        from scipy.spatial import cKDTree  # here, because it takes long, and few scenes need it
    except ImportError:
        raise SceneError(
            f"decimation needs the fast-simplification package: {install_hint('decimate')}"
        ) from None
    used, faces = welded_faces(mesh.vertices, mesh.faces, 6)
    vertices, new_faces, new_labels = [], [], []
    count = 0
    for rows in _rows_of_pieces(pieces_of(faces, len(used))):
        old_points, old = np.unique(faces[rows], return_inverse=True)
        points, piece = used[old_points], old.reshape(-1, 3)
        label = mesh.face_label[rows]
        if len(piece) >= _LEAST_FACES:
            small, fewer = fast_simplification.simplify(
                points.astype(np.float32), piece.astype(np.int32), target_reduction=1.0 - share
            )
            small = np.asarray(small, float)
            if len(fewer) and _same_extent(points, piece, small, fewer):
                _, nearest = cKDTree(points[piece].mean(axis=1)).query(small[fewer].mean(axis=1))
                points, piece, label = small, np.asarray(fewer, np.int64), label[nearest]
        vertices.append(points)
        new_faces.append(piece + count)
        new_labels.append(label)
        count += len(points)
    result = np.concatenate(new_faces)
    note = f"decimated from {len(mesh.faces):,} to {len(result):,} faces (decimate={share:g})"
    return replace(
        mesh,
        vertices=np.concatenate(vertices),
        faces=result,
        face_label=np.concatenate(new_labels),
        notes=(*mesh.notes, note),
    )


def _rows_of_pieces(piece: np.ndarray) -> list[np.ndarray]:
    order = np.argsort(piece, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(piece[order])) + 1)


def _same_extent(points: np.ndarray, faces: np.ndarray, small: np.ndarray, fewer: np.ndarray) -> bool:
    before, after = (float(areas(p[f]).sum()) for p, f in ((points, faces), (small, fewer)))
    a, b = points[faces].reshape(-1, 3), small[fewer].reshape(-1, 3)
    moved = np.abs([a.min(axis=0) - b.min(axis=0), a.max(axis=0) - b.max(axis=0)]).max()
    return bool(abs(after - before) <= min(_AREA_CHANGE * before, _HOLE) and moved <= _BOUNDS_CHANGE)


_log = logging.getLogger(__name__)


def load_scene(
    source: str | Path | LabelledMesh | Scene | Any,
    *,
    materials: MaterialTable | str | Path | None = None,
    labels: Mapping[str, str] | str | Path | None = None,
    up: str | None = None,
    unit: str | None = None,
    strict_materials: bool = False,
    ceiling: bool | None = None,
    decimate: float | None = None,
) -> Scene:
    """Load a scene by built-in name or path.

    What was assumed is in `scene.notes` and is logged. Raises `SceneError` or `MaterialError`.

    Parameters
    ----------
    source
        'demo' or a generated building such as ``home-7`` (docs/scenes.md); a scene folder of Replica, Matterport3D,
        HM3D or Gibson; a mesh file (OBJ, PLY, …); a `trimesh.Trimesh` or `trimesh.Scene` (metres, Z up); a
        `parts.LabelledMesh`; a `Scene`, which is returned as it is
    materials
        a table, or a TOML file in the format of materials/materials.toml, put on top of the
        built-in database
    labels
        material name per label, as a mapping or a TOML file; put on top of the built-in map
    strict_materials
        a label without a material is an error
    ceiling
        add a synthetic ceiling over rooms without one; None: where rays from the floor escape upward
        (`scene.ceiling`)
    decimate
        share of the faces to keep, in (0, 1); see `decimate`
    up, unit
        'y' or 'z', and 'm', 'cm', 'mm', 'in' or 'ft': override what the file says or seems to say
    """
    if isinstance(source, Scene):
        options = (materials, labels, up, unit, ceiling, decimate)
        if strict_materials or any(option is not None for option in options):
            raise SceneError(
                f"'{source.name}' is a Scene already: its materials and axes are settled; give these options "
                "where it is made"
            )
        return source
    mesh = _mesh_of(source, up, unit, decimate)
    own = mesh.materials
    table = stack_materials(materials, own.values())
    label_map = load_labels(labels, {label: given.names[0] for label, given in own.items()})
    scene, warned = _with_materials(mesh, table, label_map, strict_materials, ceiling)
    scene = with_free_sheets(scene)
    if notes := scene.overlap_notes:
        scene = replace(scene, notes=(*scene.notes, *notes))
    for note in scene.notes:
        if note != warned:
            level = logging.WARNING if note.startswith(DOUBT) else logging.INFO
            _log.log(level, "%s: %s", scene.name, note)
    return scene


def _mesh_of(source: Any, up: str | None, unit: str | None, decimate: float | None) -> LabelledMesh:
    """The mesh of a source, mended. As its file has it, it is let go: of a scan, a hundred megabytes."""
    given = _read(source, up is not None and unit is not None)
    return kept_mesh(given, (up, unit, decimate), lambda: _mended(given, up, unit, decimate))


def _mended(
    mesh: LabelledMesh, up: str | None, unit: str | None, decimate: float | None
) -> LabelledMesh:
    """The mesh in the scene's frame, without its small holes."""
    mesh = to_scene_frame(mesh, up, unit)
    return close_holes(mesh if decimate is None else decimate_mesh(mesh, decimate))


def _with_materials(
    mesh: LabelledMesh,
    table: MaterialTable,
    label_map: LabelMap,
    strict: bool,
    ceiling: bool | None,
) -> tuple[Scene, str]:
    """The scene of a mesh, with a synthetic ceiling as `load_scene` has it, and the note already logged."""
    # Areas are told of labels, where there are any.
    area = areas(corners_of(mesh.vertices, mesh.faces)) if mesh.labels else np.ones(len(mesh.faces))
    found = assign_materials(mesh.labels, mesh.face_label, area, table, label_map, strict)
    mesh = replace(mesh, notes=(*mesh.notes, *found.notes))
    scene = _scene(mesh, found.rows, table)
    if ceiling is False:
        return scene, found.lost
    covered = kept_ceiling(mesh, scene, always=ceiling is True)
    if covered.notes == mesh.notes:
        return scene, found.lost
    added = covered.face_label[len(found.rows) :]
    rows = assign_materials(covered.labels, added, np.ones(len(added)), table, label_map).rows
    return _scene(covered, np.concatenate([found.rows, rows]), table), found.lost


def _scene(mesh: LabelledMesh, rows: np.ndarray, table: MaterialTable) -> Scene:
    return Scene(
        mesh.vertices, mesh.faces, rows, table, mesh.labels, mesh.face_label, mesh.name, mesh.notes
    )


def _read(source: Any, settled: bool) -> LabelledMesh:
    """The mesh in its file's frame; `settled`: the user says axis and unit."""
    if isinstance(source, LabelledMesh):
        return source
    if not isinstance(source, str | Path):
        if not type(source).__module__.startswith("trimesh"):
            raise SceneError(
                f"expected a scene's name, a path, a Scene, a trimesh.Trimesh or a trimesh.Scene, got "
                f"{type(source).__name__}"
            )
        return LabelledMesh(*mesh_arrays(source, "mesh"), "mesh")
    path = Path(source)
    found = find_format(str(source))
    if found is not None:
        mesh = found.read(str(source))
        framed = found.beside and not settled
        return with_frame_beside(mesh, path) if framed else mesh
    if path.is_dir():
        raise SceneError(
            f"{path}: this folder is neither a Replica scene (habitat/mesh_semantic.ply and "
            "habitat/info_semantic.json) nor a Matterport3D (<scene>.house and <scene>_semantic.ply), HM3D or "
            "Gibson one; give the path of a mesh file instead"
        )
    raise SceneError(
        f"unknown scene '{source}': neither a built-in scene nor an existing path; what can be read: {accepted()}"
    )


_MESHES = {".obj", ".ply", ".glb", ".gltf", ".stl", ".off", ".dae", ".3mf", ".ifc"}
_SEMANTIC = "_semantic.ply"


def _is_scene(path: Path) -> bool:
    """Whether what lies in a folder is a scene; of files those that are meshes by their names."""
    if (
        path.name.endswith(_SEMANTIC)
        and path.with_name(f"{path.name.removesuffix(_SEMANTIC)}.glb").is_file()
    ):
        return False  # Gibson's folder: the .glb stands for the scene
    return (path.is_dir() or path.suffix.lower() in _MESHES) and find_format(str(path)) is not None


def find_scenes(sources: Iterable[str]) -> list[str]:
    """The scenes that names and paths stand for: each itself, or, of a folder that is none, those in it by name.

    Raises `SceneError` for a folder in which there is none. What is no folder is left to `load_scene` to refuse.
    """
    found: list[str] = []
    for source in sources:
        path = Path(source)
        if find_format(source) is not None or not path.is_dir():
            found.append(source)
            continue
        inside = [str(p) for p in sorted(path.iterdir()) if _is_scene(p)]
        if not inside:
            raise SceneError(
                f"{path}: neither a scene nor a folder of scenes; what can be read: {accepted()}"
            )
        found += inside
    return found
