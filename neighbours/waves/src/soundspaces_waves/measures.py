"""Room measures of waves with what they are known to: by the lattice, and by the phases of walls.

Discretisation: the same on a lattice whose cells are r times as large. Errors of oblique walls and edges are of
first order in the size of cells, all others of second: what is left is at most the difference over r - 1.

Impedance: a table of absorption does not tell the phases of walls. The same with walls that are as much a mass, or
as much a spring, as a resistance at the table's frequency below the edge, and absorb there what the table says: the
larger of both differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from soundspaces_parameters.of_waves import LOW_MEASURES, low_measures as measures_of, octaves_below

from soundspaces_sim import ConfigError, Scene, SimulationConfig, load_scene
from soundspaces_sim.parts import as_points, check_edges, over_rows
from soundspaces_waves.placing import sight
from soundspaces_waves.responses import LowResponses
from soundspaces_waves.simulate import simulate_low

_COARSER = 1.5  # cells of the second lattice, over those of the first
_LEAST_CELLS = 6.0  # per wavelength
_LEAST_RATIO = 1.2
_PHASES = (-1.0, 1.0)  # reactance over resistance


@dataclass(frozen=True)
class LowMeasures:
    """Of S sources × L listeners in K bands between `edges` (K + 1,), Hz: by measure (``t20``, ``t30``, ``edt``,
    ``c50``, ``c80``, ``d50``, ``ts``) each (S, L, K), in s, dB or 1. `value`; `discretisation`: what the lattice
    may be off by; `impedance`: what other phases of walls would change. NaN: not defined, or not known."""

    edges: tuple[float, ...]
    value: dict[str, np.ndarray]
    discretisation: dict[str, np.ndarray]
    impedance: dict[str, np.ndarray]

    def __repr__(self) -> str:
        s, l, _ = self.value["t30"].shape
        bands = ", ".join(f"{f:.0f}" for f in self.edges)
        return f"LowMeasures: {', '.join(self.value)} of {s} × {l} pairs, bands at {bands} Hz"


def low_measures(
    scene: Scene | str | Path | Any,
    sources: ArrayLike,
    listeners: ArrayLike,
    duration: float,
    config: SimulationConfig | None = None,
    *,
    edges: Sequence[float] | None = None,
) -> LowMeasures:
    """Room measures of waves (ISO 3382-1) between (S, 3) `sources` and (L, 3) `listeners`, m, each with what the
    lattice may be off by, and what other phases of the walls' impedances would change.

    Four runs of `simulate_low` of `duration` s, at least a third more than the longest T30; of `config` what that
    takes, and `low`: edge, cells per wavelength. `edges` (K + 1,) Hz up to that edge; by default those
    of the octaves from 63 Hz on that lie below it. Raises `ConfigError`, and what `simulate_low` does.
    """
    scene, config = load_scene(scene), config or SimulationConfig()
    a, b = as_points(sources, "sources"), as_points(listeners, "listeners")
    low, edge = config.low, config.bands[1] if config.low.edge is None else config.low.edge
    bands = octaves_below(edge) if edges is None else tuple(check_edges(edges))
    cells = max(low.cells_per_wavelength / _COARSER, _LEAST_CELLS)
    ratio = low.cells_per_wavelength / cells
    if not ratio >= _LEAST_RATIO:
        raise ConfigError(
            f"simulation.low.cells_per_wavelength: expected at least {_LEAST_RATIO * _LEAST_CELLS:g} for a second "
            f"lattice that is coarser, got {low.cells_per_wavelength:g}"
        )
    onset = _onsets(scene, a, b, config.c)

    def found(cells: float, reactance: float) -> np.ndarray:
        run = simulate_low(
            scene, a, b, duration, config, edge=edge, cells_per_wavelength=cells, reactance=reactance
        )
        return _measures(run, bands, onset)

    value = found(low.cells_per_wavelength, 0.0)
    lattice = np.abs(found(cells, 0.0) - value) / (ratio - 1.0)
    phases = [np.abs(found(low.cells_per_wavelength, x) - value) for x in _PHASES]
    each = (value, lattice, np.fmax(*phases))
    return LowMeasures(bands, *(dict(zip(LOW_MEASURES, x, strict=True)) for x in each))


def _onsets(scene: Scene, sources: np.ndarray, listeners: np.ndarray, c: float) -> np.ndarray:
    """(S, L) s of direct sound, NaN out of sight."""
    way = np.linalg.norm(sources[:, None] - listeners[None], axis=2)
    a, b = (np.ascontiguousarray(x - scene.center) for x in (sources, listeners))
    seen = np.zeros(way.shape, np.bool_)
    every = np.broadcast_to(np.arange(len(b)), way.shape).copy()
    over_rows(sight, len(a), scene.geometry, a, b, every, seen)
    return np.where(seen, way / c, np.nan)


def _measures(run: LowResponses, edges: tuple[float, ...], onset: np.ndarray) -> np.ndarray:
    """(M, S, L, K)."""
    out = np.empty((len(LOW_MEASURES), *onset.shape, len(edges) - 1))
    for s, l in np.ndindex(onset.shape):
        begin = float(onset[s, l]) if np.isfinite(onset[s, l]) else None
        measured = measures_of(run[s, l], edges, begin)
        out[:, s, l] = [getattr(measured, name) for name in LOW_MEASURES]
    return out
