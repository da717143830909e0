"""The reverberation time of `inspect`: simulated between a few points, with what it owes to absorption."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.core.simulation_config import (
    ConnectionsConfig,
    DiffractionConfig,
    MaterialsConfig,
    RadianceTransferConfig,
)
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.material_spread import measure_spread
from soundspaces_sim.echogram.measures import echograms_measures, why_undefined
from soundspaces_sim.layout.records import Grid
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.simulate import simulate

_SOURCES, _LISTENERS, WALKS = 3, 4, 4000
PAIRS = _SOURCES * _LISTENERS
_OF_T30 = SimulationConfig(
    walks=WALKS,
    radiance_transfer=RadianceTransferConfig(enabled=False),
    connections=ConnectionsConfig(subpaths=2),
    diffraction=DiffractionConfig(enabled=False),
    materials=MaterialsConfig(enabled=True),
)


def simulated_t30(
    scene: Scene, grid: Grid | None
) -> tuple[np.ndarray, np.ndarray, int, tuple[str, ...]]:
    """(B,) s, median over pairs of points spread over a grid, of a few thousand subpaths; its spread by absorption;
    their number; and why bands have none."""
    none = np.full(len(DEFAULT_BANDS) - 1, np.nan)
    if grid is None or len(grid) < 2:
        return none, none, 0, ()
    rows = np.unique(np.linspace(0, len(grid) - 1, _SOURCES + _LISTENERS).astype(int))
    sources, listeners = grid.points[rows[1::2]], grid.points[rows[::2]]
    echoes = simulate(scene, sources, listeners, _OF_T30)
    times = echograms_measures(echoes)["t30"].reshape(-1, len(none))
    why = tuple(
        f"T30 of {low:g} to {high:g} Hz is not defined: {why_undefined(echoes[0, 0], 't30', band)}"
        for band, (low, high) in enumerate(pairwise(DEFAULT_BANDS))
        if np.isnan(times[:, band]).all()
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # bands without a single time are NaN
        return np.nanmedian(times, axis=0), np.nanmedian(_spreads(echoes), axis=0), len(times), why


def _spreads(echoes: Echograms) -> np.ndarray:
    """(pairs, B) s, of T30 by absorption, of one pair of each source; NaN if no material's reflections count."""
    none = np.full((1, len(DEFAULT_BANDS) - 1), np.nan)
    if echoes.counts is None or not echoes.counts.groups.names:
        return none
    pairs = [(s, s % echoes.shape[1]) for s in range(echoes.shape[0])]
    return np.array([measure_spread(echoes[pair], names=("t30",))[0] for pair in pairs])
