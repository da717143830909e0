"""The genuine rlr_audio_propagation: what is called of it."""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import UnavailableError

RATE, LENGTH_S = 44100, 1.0


def genuine() -> ModuleType:
    """The genuine package. Raises `UnavailableError` where it is not installed, or ours stands in its place."""
    try:
        version = importlib.metadata.version("rlr_audio_propagation")
    except importlib.metadata.PackageNotFoundError:
        raise UnavailableError("rlr_audio_propagation is not installed") from None
    if "+" in version:
        raise UnavailableError(
            f"rlr_audio_propagation {version} is this package's own; it needs the genuine 0.0.1"
        )
    module = importlib.import_module("rlr_audio_propagation")
    if "soundspaces_rlr" in sys.modules:  # which ours imports: it may be found by PYTHONPATH first
        raise UnavailableError(
            f"{module.__file__} is this package's own rlr_audio_propagation; it needs the genuine 0.0.1"
        )
    return module


def materials(scene: ss.Scene) -> dict[str, object]:
    """The scene's materials in the form that rlr_audio_propagation reads."""
    table = scene.materials
    rows = []
    for i, name in enumerate(table.names):
        columns = {
            key: np.column_stack([table.frequency_hz, values[i]]).ravel().tolist()
            for key, values in (
                ("absorption", table.absorption),
                ("scattering", table.scattering),
                ("transmission", table.transmission),
            )
        }
        damping = np.column_stack([table.frequency_hz, np.zeros(len(table.frequency_hz))])
        rows.append(
            {"name": name, "labels": [name], "speed": 2000.0, "density": 1500.0,
             "damping": damping.ravel().tolist(), **columns}
        )  # fmt: skip
    return {"materials": rows}


def context(module: ModuleType, scene: ss.Scene, rays: int = 5000, **settings: Any) -> Any:
    """A context with the scene in it."""
    config = module.Config()
    config.max_ir_length, config.sample_rate = LENGTH_S, float(RATE)
    config.indirect_ray_count = rays
    for name, value in settings.items():
        setattr(config, name, value)
    made = module.Context(config)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "materials.json")
        path.write_text(json.dumps(materials(scene)))
        made.set_material_database_json(str(path))
    made.add_object()
    made.add_mesh_vertices(scene.vertices.ravel().tolist())
    for i, name in enumerate(scene.materials.names):
        faces = scene.faces[scene.face_material == i]
        if len(faces):
            made.add_mesh_indices(faces.ravel().tolist(), 3, name)
    made.finalize_object_mesh(0)
    return made


def populate(module: ModuleType, made: Any, sources: np.ndarray, listeners: np.ndarray) -> None:
    """Sources and mono listeners at (S, 3) and (L, 3)."""
    made.clear_sources()
    made.clear_listeners()
    for i, point in enumerate(sources):
        made.add_source()
        made.set_source_position(i, point.tolist())
    for i, point in enumerate(listeners):
        made.add_listener(module.ChannelLayout(module.ChannelLayoutType.Mono, 1))
        made.set_listener_position(i, point.tolist())
