"""misuka 0.1: a path tracer from the microphone that connects every reflection to a source of finite size.

It gives energies, one source and one microphone at a time. On the CPU it runs compiled by LLVM where the system has
it, otherwise ray by ray. It has no absorption by air.
"""

from __future__ import annotations

import importlib
import itertools
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.energies import BINS, EDGES, LENGTH_S
from benchmarks.tools.programs import Simulator

NAME, MODULE, UNIT = "misuka", "misuka", "samples"
SETTINGS = (1 << 13,)
WAVEFORMS, BOXES_ONLY = False, False
RADIUS_M = 0.1  # of its sources


def simulator(scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, setting: int) -> Simulator:
    """A scene with all microphones for each source."""
    mi = importlib.import_module("misuka")
    mi.set_variant(_variant())
    mi.set_log_level(mi.LogLevel.Error)
    importlib.import_module("drjit").set_thread_count(1)
    meshes = {f"mesh_{i}": _mesh(mi, scene, i) for i in np.unique(scene.face_material)}
    integrator = mi.load_dict(
        {"type": "acoustic_path", "max_time": LENGTH_S, "speed_of_sound": ss.SimulationConfig().c}
    )
    scenes = [mi.load_dict({**meshes, **_ends(source, listeners)}) for source in sources]

    def simulate(run: int) -> list[np.ndarray]:
        return [
            np.array(integrator.render(made, sensor=at, seed=run, spp=setting))
            for made, at in itertools.product(scenes, range(len(listeners)))
        ]

    return simulate


def energies(found: list[np.ndarray]) -> np.ndarray:
    """(pairs, bins, bands)."""
    return np.array([tape[:, :, 0] for tape in found])


def _variant() -> str:
    drjit = importlib.import_module("drjit")
    return "llvm_ad_acoustic" if drjit.has_backend(drjit.JitBackend.LLVM) else "scalar_acoustic"


def _centres() -> np.ndarray:
    return np.sqrt(np.maximum(EDGES[:-1], 20.0) * np.array(EDGES[1:]))


def _ends(source: np.ndarray, listeners: np.ndarray) -> dict[str, Any]:
    film = {
        "type": "tape",
        "time_bins": BINS,
        "frequencies": ", ".join(f"{f:.1f}" for f in _centres()),
        "rfilter": {"type": "box"},
        "component_format": "float32",
    }
    ends: dict[str, Any] = {
        f"microphone_{i:04d}": {
            "type": "microphone",
            "origin": listener.tolist(),
            "direction": [1.0, 0.0, 0.0],
            "film": film,
        }
        for i, listener in enumerate(listeners)
    }
    light = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}
    sphere = {"type": "sphere", "radius": RADIUS_M, "center": source.tolist(), "emitter": light}
    return {"type": "scene", "source": sphere, **ends}


def _mesh(mi: Any, scene: ss.Scene, material: int) -> Any:
    """The faces of one material."""
    faces = scene.faces[scene.face_material == material]
    used, inverse = np.unique(faces, return_inverse=True)
    table = scene.materials
    columns = {}
    for name, values in (("absorption", table.absorption), ("scattering", table.scattering)):
        at = np.interp(np.log(_centres()), np.log(table.frequency_hz), values[material])
        pairs = [(float(f), float(v)) for f, v in zip(_centres(), at, strict=True)]
        columns[name] = {"type": "spectrum", "value": pairs}
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "b": {"type": "acousticbsdf", **columns}})
    mesh = mi.Mesh(
        str(table.names[material]), vertex_count=len(used), face_count=len(faces), props=properties
    )
    filled = mi.traverse(mesh)
    filled["vertex_positions"] = scene.vertices[used].ravel().astype(np.float32)
    filled["faces"] = inverse.ravel().astype(np.uint32)
    filled.update()
    return mesh
