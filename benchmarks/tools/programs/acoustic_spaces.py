"""acoustic-spaces 4: specular paths to order 3, stochastic ray tracing beyond; all pairs in one call.

Diffraction is off: in the house its own takes more memory than there is.
"""

from __future__ import annotations

import importlib
import itertools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.energies import BIN_S, BINS, LENGTH_S, RATE, of_octaves
from benchmarks.tools.programs import Simulator

NAME, MODULE, UNIT = "acoustic-spaces", "acoustic_spaces", "rays"
SETTINGS = (5000, 50000)
WAVEFORMS, BOXES_ONLY = False, False


def simulator(scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, setting: int) -> Simulator:
    """A room that was read once."""
    program = importlib.import_module(MODULE)
    settings = {"late": {"rays": setting}, "ir_length_s": LENGTH_S, "sample_rate": RATE}
    room = prepared(scene, sources, listeners, settings)

    def simulate(run: int) -> list[Any]:
        settings = room.scene.simulation.model_copy(update={"seed": run})
        return by_pair(program.simulate(room, settings=settings), len(sources), len(listeners))

    return simulate


def prepared(
    scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, settings: dict[str, Any]
) -> Any:
    """Its room of a scene, with settings of its simulation beside one thread and no diffraction."""
    program = importlib.import_module(MODULE)
    centres = importlib.import_module("acoustic_spaces.materials").OCTAVE_BANDS_HZ
    table = scene.materials

    def octaves(values: np.ndarray) -> list[float]:
        return np.interp(np.log(centres), np.log(table.frequency_hz), values).tolist()

    materials = {
        name: {"absorption": octaves(table.absorption[i]), "scattering": octaves(table.scattering[i])}
        for i, name in enumerate(table.names)
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "room.obj")
        path.write_text(_obj(scene))
        described = program.Scene.model_validate(
            {
                "geometry": {"file": str(path), "units": "m", "up_axis": "z"},
                "materials": materials,
                "assignments": {name: name for name in table.names},
                "sources": [{"name": f"s{i}", "position": p.tolist()} for i, p in enumerate(sources)],
                "listeners": [
                    {"name": f"l{i}", "position": p.tolist()} for i, p in enumerate(listeners)
                ],
                "simulation": {
                    "early": {"diffraction": "none"},
                    "performance": {"threads": 1},
                    "seed": 0,
                    **settings,
                },
            }
        )
        return program.Room.from_scene(described)


def by_pair(found: Any, sources: int, listeners: int) -> list[Any]:
    """What it says of each pair, sources outermost."""
    pairs = itertools.product(range(sources), range(listeners))
    return [found[f"s{s}", f"l{l}"] for s, l in pairs]


def energies(found: list[Any]) -> np.ndarray:
    """(pairs, bins, bands)."""
    centres = np.array(found[0].band_hz, dtype=float)
    return of_octaves(np.array([r.energy(BIN_S)[:, :BINS] for r in found]), centres)


def _obj(scene: ss.Scene) -> str:
    """Faces grouped by material."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in scene.vertices]
    for i, name in enumerate(scene.materials.names):
        lines += [f"g {name}", f"usemtl {name}"]
        lines += [f"f {a} {b} {c}" for a, b, c in scene.faces[scene.face_material == i] + 1]
    return "\n".join(lines) + "\n"
