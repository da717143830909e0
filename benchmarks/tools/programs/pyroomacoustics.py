"""pyroomacoustics: image sources to order 3, ray tracing beyond; all listeners in one call, its fastest way.

Rooms are its shoebox of one material, of the size of the scene's bounds: a mesh like the house is beyond it.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.energies import RATE, of_waveforms
from benchmarks.tools.programs import Simulator

NAME, MODULE, UNIT = "pyroomacoustics", "pyroomacoustics", "rays"
SETTINGS = (1000, 5000)
WAVEFORMS, BOXES_ONLY = True, True


def simulator(scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, setting: int) -> Simulator:
    """A room per source. Its random numbers go on from run to run."""

    def simulate(_: int) -> list[np.ndarray]:
        responses = []
        for source in sources:
            room = _room(scene, max_order=3, ray_tracing=True)
            room.set_ray_tracing(n_rays=setting, hist_bin_size=0.004)
            responses += _responses(room, source, listeners)
        return responses

    return simulate


def image_sources(scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, order: int) -> Simulator:
    """Image sources alone, as most training data are made; the same in every run."""

    def simulate(_: int) -> list[np.ndarray]:
        return [
            response
            for source in sources
            for response in _responses(_room(scene, max_order=order), source, listeners)
        ]

    return simulate


def _room(scene: ss.Scene, **settings: Any) -> Any:
    pra = importlib.import_module("pyroomacoustics")
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    if np.abs(low).max() > 1e-6 or len(scene.materials.names) != 1:
        raise ValueError(f"{scene.name}: expected a box with a corner at 0 and one material")
    table = scene.materials
    material = pra.Material(
        energy_absorption=float(table.absorption[0, 0]), scattering=float(table.scattering[0, 0])
    )
    return pra.ShoeBox(high, fs=RATE, materials=material, air_absorption=True, **settings)


def _responses(room: Any, source: np.ndarray, listeners: np.ndarray) -> list[np.ndarray]:
    room.add_source(source)
    room.add_microphone_array(listeners.T)
    room.compute_rir()
    return [np.asarray(row[0]) for row in room.rir]


energies = of_waveforms
