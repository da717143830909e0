"""The genuine rlr_audio_propagation beside `soundspaces_rlr`: what is called of both, and what is
measured."""

from __future__ import annotations

import importlib
import importlib.metadata
import itertools
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
import trimesh
from soundspaces_rlr import propagation

import soundspaces_sim as ss
from benchmarks.tools.record import UnavailableError
from benchmarks.tools.scenes import BOX
from soundspaces_sim.echogram.filters import band_windows
from soundspaces_sim.echogram.measures import waveform_measures

RATE, LENGTH_S = 44100, 1.0
OCTAVES = (125, 250, 500, 1000, 2000, 4000, 8000)
EDGES = (0.0, *(f / np.sqrt(2.0) for f in (*OCTAVES, 16000)))
SPEED = ss.SimulationConfig().c


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
    return importlib.import_module("rlr_audio_propagation")


def simulations(made: Any, runs: int) -> Iterator[None]:
    """Simulate so many times, ours with other random numbers each time."""
    for number in range(runs):
        with patch.object(propagation, "SEED", number):
            made.simulate()
        yield


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
    """A context of either engine with the scene in it."""
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


def responses(made: Any, sources: int, listeners: int) -> np.ndarray:
    """(S * L, n) of the last simulation."""
    n = round(LENGTH_S * RATE)
    out = np.zeros((sources * listeners, n))
    for k, (s, l) in enumerate(itertools.product(range(sources), range(listeners))):
        row = np.asarray(made.get_ir_channel(l, s, 0))[:n]
        out[k, : len(row)] = row
    return out


def octave_measures(irs: np.ndarray) -> dict[str, np.ndarray]:
    """Level in dB, EDT and T30 in s, each (k, octaves)."""
    n = 2 * irs.shape[1]
    gains = band_windows(EDGES, np.fft.rfftfreq(n, 1.0 / RATE), RATE)[1:]
    energy = np.array([[(np.abs(np.fft.rfft(ir, n)) ** 2 * g).sum() for g in gains] for ir in irs])
    found = [waveform_measures(ir, RATE, EDGES) for ir in irs]
    return {
        "level": 10.0 * np.log10(energy),
        "EDT": np.array([m.edt[1:] for m in found]),
        "T30": np.array([m.t30[1:] for m in found]),
    }


def box_of(
    absorption: float, scattering: float, ceiling: float | None = None, through: float = 0.0
) -> ss.Scene:
    """The box with walls alike, and another absorption above; `through`: transmission."""
    mesh = trimesh.creation.box(bounds=np.array([np.zeros(3), BOX]))
    upper = (mesh.triangles_center[:, 2] > BOX[2] - 1e-6).astype(int)
    above = absorption if ceiling is None else ceiling
    columns = ([1000.0], [[absorption], [above]], [[scattering]] * 2, [[through]] * 2)
    table = ss.MaterialTable(("wall", "ceiling"), *(np.array(column) for column in columns))
    return ss.Scene(mesh.vertices, mesh.faces, upper, table, name="box")
