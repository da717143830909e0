"""What habitat's files beside a mesh say of its frame: a stage's configuration, or that of its dataset.

``NAME.stage_config.json`` beside ``NAME.glb``, or another stage's that names the file as an asset; else the
`stages.default_attributes` of the one ``*.scene_dataset_config.json`` in the folder or the one above. They hold
`up`, the axis that points up, and `units_to_meters` and `scale`, whose product is the length of the file's unit,
and go before what the format says, as in habitat-sim (its "Attributes JSON files").
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.io.untrusted import read_json
from soundspaces_sim.scene.labelled import LabelledMesh

_STAGE, _DATASET = ".stage_config.json", ".scene_dataset_config.json"
_ASSETS = ("render_asset", "collision_asset", "semantic_asset")
_AXES: dict[tuple[float, ...], str] = {
    (1.0, 0.0, 0.0): "x",
    (0.0, 1.0, 0.0): "y",
    (0.0, 0.0, 1.0): "z",
}
_MOST = 1000  # files of a folder that are looked into


def with_frame_beside(mesh: LabelledMesh, path: Path) -> LabelledMesh:
    """The mesh of a file with the frame that files beside it say. Raises `SceneError` for those that cannot be."""
    found, where = _attributes(path)
    up, metre = _up(found, where), _metre(found, where)
    notes = list(mesh.notes)
    if up is not None and up != mesh.up:
        notes.append(f"{up.upper()} is taken as up: so says {where.name} (override with up=)")
    if metre is not None and metre != 1.0:
        notes.append(f"lengths are taken as {metre:.6g} m: so says {where.name} (override with unit=)")
    return replace(
        mesh,
        up=up or mesh.up,
        metre=metre or mesh.metre,
        notes=tuple(notes),
    )


def _attributes(path: Path) -> tuple[dict[str, Any], Path]:
    """What is said of the stage in a file, and where; nothing in most folders."""
    stem = path.name.split(".")[0]
    own = path.with_name(stem + _STAGE)
    others = sorted(path.parent.glob("*" + _STAGE))[:_MOST]
    for file in [own] * own.is_file() + [f for f in others if f != own]:
        found = _read(file)
        assets = {Path(str(found[key])).name for key in _ASSETS if key in found}
        same = {path.name} | ({stem + path.suffix} if file == own else set())
        if same & assets or (file == own and not assets):
            return found, file
    for folder in path.resolve().parents[:2]:
        files = sorted(folder.glob("*" + _DATASET))
        if len(files) == 1:
            stages = _read(files[0]).get("stages", {})
            default = stages.get("default_attributes", {}) if isinstance(stages, dict) else {}
            return (default if isinstance(default, dict) else {}), files[0]
    return {}, path


def _read(file: Path) -> dict[str, Any]:
    found = read_json(file, SceneError, "configuration of a stage")
    if not isinstance(found, dict):
        raise SceneError(
            f"{file}: expected a JSON object with a stage's attributes, got {type(found).__name__}"
        )
    return found


def _numbers(given: Any, count: int) -> tuple[float, ...] | None:
    """`count` finite numbers, or None."""
    if not isinstance(given, list) or len(given) != count:
        return None
    if any(isinstance(x, bool) or not isinstance(x, int | float) or not math.isfinite(x) for x in given):
        return None
    return tuple(float(x) for x in given)


def _up(found: dict[str, Any], where: Path) -> str | None:
    if "up" not in found:
        return None
    axis = _AXES.get(_numbers(found["up"], 3) or ())
    if axis is None:
        raise SceneError(
            f"{where}: up: expected [1, 0, 0], [0, 1, 0] or [0, 0, 1], got {found['up']!r}; turn the mesh, "
            "and mend or remove that file"
        )
    return axis


def _metre(found: dict[str, Any], where: Path) -> float | None:
    metre = _numbers([found.get("units_to_meters", 1.0)], 1)
    scale = _numbers(found.get("scale", [1.0, 1.0, 1.0]), 3)
    if metre is None or not 1e-6 <= metre[0] <= 1e6:
        raise SceneError(
            f"{where}: units_to_meters: expected a length in m above 0, got {found['units_to_meters']!r}"
        )
    if scale is None or not scale[0] == scale[1] == scale[2] or not 1e-6 <= scale[0] <= 1e6:
        raise SceneError(f"{where}: scale: expected three equal factors above 0, got {found['scale']!r}")
    return metre[0] * scale[0] if "units_to_meters" in found or "scale" in found else None
