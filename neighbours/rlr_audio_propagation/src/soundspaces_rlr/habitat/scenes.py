"""Which scene a simulator's configuration means: what habitat-sim takes from beside a stage's file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_rlr.errors import RlrError
from soundspaces_sim import Scene, load_scene
from soundspaces_sim.parts import (
    LENGTH_UNITS as UNITS,
    PlyElements as Elements,
    find_matterport,
    read_json,
    read_labelled_ply,
)

_NO_DATASET = ("", "default", "none")
_COLORS = ("red", "green", "blue")
_AXES = {"y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0]}


def find_scene(scene_id: str | Path | Scene, dataset_config: str) -> Scene:
    """The scene of a `scene_id` and a `scene_dataset_config_file`, open where it is open.

    A mesh with `<its name>.house` and `<its name>_semantic.ply` beside it is a scene of Matterport3D, whose
    semantic mesh is taken: Z up, with labels; one with `.scn` and `_semantic.ply` is one of Gibson, likewise. Else
    `stages.default_attributes` of the dataset's configuration says which axis is up (`up`) and how long the unit
    is (`units_to_meters`), and what it leaves out the file says. Raises `RlrError` for a
    configuration that cannot be read, `SceneError` for a scene that cannot.
    """
    if isinstance(scene_id, Scene):
        return scene_id
    path = Path(scene_id)
    if path.is_file() and find_matterport(path) is not None:
        return load_scene(path, ceiling=False)
    attributes = _stage_attributes(dataset_config)
    up, unit = _up(attributes, dataset_config), _unit(attributes, dataset_config)
    if _beside(path, ".scn") is not None:
        up = None  # `up` is the .glb's; of a semantic PLY habitat-sim knows that it is Z up
    return load_scene(scene_id, up=up, unit=unit, ceiling=False)


def vertex_colors(scene_id: str | Path | Scene, scene: Scene) -> np.ndarray | None:
    """(V, 3) 0 to 255 colours of a scene's vertices if it was read from a PLY file that has them, else None."""
    if isinstance(scene_id, Scene):
        return None
    path = Path(scene_id)
    folder = path / "habitat" / "mesh_semantic.ply"
    files = (
        [f for f in (folder, *sorted(path.glob("*_semantic.ply"))) if f.is_file()]
        if path.is_dir()
        else []
    )
    if path.suffix.lower() == ".ply" and path.is_file():
        files = [path]
    else:
        files += [f for f in (_beside(path, ".house") or _beside(path, ".scn"),) if f is not None]
    if not files:
        return None
    found: list[np.ndarray] = []

    def look(data: Elements) -> None:
        vertex = data["vertex"]
        if all(name in vertex for name in _COLORS):
            found.append(np.stack([np.asarray(vertex[name], float) for name in _COLORS], axis=1))

    read_labelled_ply(files[0], (), look)
    good = found and len(found[0]) == len(scene.vertices) and np.isfinite(found[0]).all()
    return found[0] if good else None


def _beside(path: Path, end: str) -> Path | None:
    """The semantic PLY beside a stage that has a description of objects with this ending, if both are there."""
    ply = path.with_name(f"{path.stem}_semantic.ply")
    there = path.suffix and path.with_suffix(end).is_file() and ply.is_file()
    return ply if there else None


def _stage_attributes(dataset_config: str) -> Mapping[str, Any]:
    if dataset_config in _NO_DATASET:
        return {}
    raw = read_json(dataset_config, RlrError, "scene dataset configuration")
    found = raw
    for key in ("stages", "default_attributes"):
        found = found.get(key, {}) if isinstance(found, dict) else None
    if not isinstance(found, dict):
        raise RlrError(f'{dataset_config}: expected {{"stages": {{"default_attributes": {{...}}}}}}')
    return found


def _up(attributes: Mapping[str, Any], where: str) -> str | None:
    if "up" not in attributes:
        return None
    given = attributes["up"]
    axis = next((name for name, unit in _AXES.items() if given == unit), None)
    if axis is None:
        raise RlrError(
            f"{where}: stages.default_attributes.up: expected [0, 1, 0] or [0, 0, 1], got {given!r}; load the "
            "scene with load_scene and give it as scene_id"
        )
    return axis


def _unit(attributes: Mapping[str, Any], where: str) -> str | None:
    if "units_to_meters" not in attributes:
        return None
    given = attributes["units_to_meters"]
    for name, metres in UNITS.items():
        if isinstance(given, int | float) and abs(given - metres) <= 1e-6 * metres:
            return name
    raise RlrError(
        f"{where}: stages.default_attributes.units_to_meters: expected the length of {', '.join(UNITS)} in m, "
        f"got {given!r}"
    )
