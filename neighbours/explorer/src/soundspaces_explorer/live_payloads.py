"""What the page of a live scene is told, and questions as the page writes them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from soundspaces_explorer.live import STEPS, Answer, LiveScene, Question
from soundspaces_explorer.payloads import arrivals_of, decay_of, rounded
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import levels_of, section

_MOST_TEXT = 1500


def scene_of(live: LiveScene, rate: int) -> dict[str, Any]:
    """Extent, storeys, plan lines by material at the points' height, materials, and places to begin with."""
    scene = live.scene
    source, listener, storey = live.first_places()
    absorption, _, _ = scene.materials.in_bands(live.bands)
    used = np.unique(scene.face_material)
    area = np.bincount(scene.face_material, scene.areas, len(scene.materials.names))
    labels = [
        sorted(
            {scene.labels[k] for k in np.unique(scene.face_label[scene.face_material == m]) if k >= 0}
        )
        for m in used
    ]
    order = np.argsort(-area[used], kind="stable")
    return {
        "name": scene.name,
        "notes": list(scene.notes),
        "rate": rate,
        "steps": [step.walks for step in STEPS],
        "speedOfSound": live.config.c,
        "bands": list(live.bands),
        "low": rounded(scene.bounds[0], 3),
        "high": rounded(scene.bounds[1], 3),
        "heights": [round(float(f) + live.grid.height, 3) for f in live.grid.floors],
        "plans": [_lines(live, float(f) + live.grid.height, (0, 1, 2)) for f in live.grid.floors],
        "points": [
            rounded(live.grid.points[live.grid.storey == k][:, :2], 2)
            for k in range(len(live.grid.floors))
        ],
        "materials": [
            {
                "row": int(used[k]),
                "name": scene.materials.names[used[k]],
                "area": round(float(area[used[k]]), 1),
                "labels": labels[k][:6],
                "fixed": bool(scene.materials.free_hanging[used[k]]),
                "absorption": rounded(absorption[used[k]], 4),
            }
            for k in order
        ],
        "table": {
            name: rounded(row, 4) for name, row in zip(scene.materials.names, absorption, strict=True)
        },
        "source": rounded(source, 3),
        "listener": rounded(listener, 3),
        "storey": storey,
    }


def floor_of(live: LiveScene, storey: int) -> np.ndarray:
    """(3 + 2 Y X,) what one sees from above: side of a cell, X and Y, then rows of materials and heights above the
    floor, m."""
    cell, material, height = live.from_above(storey)
    head = [cell, material.shape[1], material.shape[0]]
    return np.concatenate([head, material.ravel(), height.ravel()])


def cut_of(live: LiveScene, y: float) -> dict[str, Any]:
    """Lines (x, z) by material in the upright plane at y, m."""
    return {"y": round(y, 3), "lines": _lines(live, y, (0, 2, 1))}


def _lines(live: LiveScene, at: float, axes: tuple[int, int, int]) -> list[list[float]]:
    """[material, u0, v0, u1, v1] where the plane at the third of the `axes` cuts triangles."""
    corners, material = live.scene.corners[:, :, axes], live.scene.face_material
    out = []
    for m in np.unique(material):
        out += [[int(m), *map(float, line)] for line in section(corners[material == m], at).round(3)]
    return out


def question_of(live: LiveScene, query: dict[str, str]) -> Question:
    """From ``s`` and ``l``, each x,y,storey, and ``m``, row~a:a:a:a,row~… . Raises `ConfigError`, `PointError`."""
    chosen = []
    text = query.get("m", "")
    if len(text) > _MOST_TEXT:
        raise ConfigError("m: expected absorption of some materials, this is longer than any")
    names = live.scene.materials.names
    for entry in filter(None, text.split(",")):
        row, _, values = entry.partition("~")
        if not (row.isascii() and row.isdigit() and len(row) < 6 and int(row) < len(names)):
            raise ConfigError(f"m: expected the row of a material, got {row!r:.20}")
        chosen.append((names[int(row)], tuple(_numbers(values, ":", "m"))))
    return Question(_place(live, query, "s"), _place(live, query, "l"), tuple(sorted(chosen)))


def _place(live: LiveScene, query: dict[str, str], name: str) -> tuple[float, float, float]:
    values = _numbers(query.get(name, ""), ",", name)
    if len(values) != 3 or not (0.0 <= values[2] < len(live.grid.floors)):
        raise ConfigError(f"{name}: expected x, y in m and a storey")
    return live.place(values[0], values[1], int(values[2]))


def _numbers(text: str, between: str, name: str) -> list[float]:
    try:
        values = [float(x) for x in text.split(between)]
    except ValueError:
        values = [math.nan]
    if not all(abs(x) < 1e6 for x in values):
        raise ConfigError(f"{name}: expected numbers, got {text!r:.40}")
    return values


def answer_of(question: Question, answer: Answer, note: str | None = None) -> dict[str, Any]:
    """A note for people, kind, step, measures with errors, decay, arrivals of what is heard."""
    echogram = answer.echogram
    curve, bin_s = decay_of(echogram)
    level = float(levels_of([echogram])[0])
    return {
        "version": answer.version,
        "kind": answer.kind,
        "step": answer.step,
        "done": answer.done,
        "note": note,
        "visible": bool(echogram.visible),
        "distance": round(math.dist(question.source, question.listener), 3),
        "level": round(level, 2) if math.isfinite(level) else None,
        "binSeconds": bin_s,
        "decay": rounded(curve, 2),
        "error": rounded(echogram.relative_error, 4),
        "measures": {name: rounded(values, 4) for name, values in answer.measures.items()},
        "arrivals": arrivals_of(echogram),
    }
