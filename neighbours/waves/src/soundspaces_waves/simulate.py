"""Scene and points in, responses below the first band's edge out. No files."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim import LowConfig, PointError, Scene, SimulationConfig, load_scene
from soundspaces_sim.parts import (
    LONGEST_RESPONSE as LONGEST,
    as_points,
    check_ends,
    free_memory,
    mounted_layers as mounted,
    require_within,
    response_rate,
    response_samples,
)
from soundspaces_waves.dispersion import velocity_spread
from soundspaces_waves.placing import ROWS
from soundspaces_waves.responses import Discretisation, LowResponses
from soundspaces_waves.scheme import WaveScene, make_wave_scene, table_misfit
from soundspaces_waves.solve import solve

_log = logging.getLogger(__name__)


def simulate_low(
    scene: Scene | str | Path | Any,
    sources: ArrayLike,
    listeners: ArrayLike,
    duration: float,
    config: SimulationConfig | None = None,
    *,
    edge: float | None = None,
    cells_per_wavelength: float = 12.0,
    reactance: float = 0.0,
) -> LowResponses:
    """Sound below the first band's edge as waves: responses of `duration` s between all `sources` (S, 3) and
    `listeners` (L, 3), in m, with the modes and the diffraction that rays lack there.

    A finite-difference solver runs once per source, and all listeners listen. `scene`: as in
    `soundspaces_sim.simulate`. Of `config` the bands, the air, the speed of sound and `porous_layers` count.
    `edge`: Hz, up to which responses hold; by default that of the first band. `cells_per_wavelength`, 6 to 40: at
    the edge. `reactance`, -10 to 10: a table of absorption does not tell the phase of an impedance; this is Im/Re
    that every wall has beside what its table asks for (negative: stiffness), to see what it changes.
    Omnidirectional ends only.
    Raises `SceneError`, `PointError` for points that are not finite, lie outside an enclosed scene or see no
    cell, `ConfigError` for settings out of range, `SimulationError` for a lattice that is too large.
    """
    scene = load_scene(scene)
    a, b = as_points(sources, "sources"), as_points(listeners, "listeners")
    config = config or SimulationConfig()
    edge = config.bands[1] if edge is None else edge
    LowConfig(edge=edge, cells_per_wavelength=cells_per_wavelength)  # raises
    require_within("reactance", reactance, -10.0, 10.0, "")
    require_within("duration", duration, 0.0, LONGEST, "s", above=True)
    check_ends(scene, a, b)
    _check_room(len(a), len(b), edge, duration)
    if not config.porous_layers:
        scene = mounted(scene)
    waves = make_wave_scene(scene, edge, cells_per_wavelength, config.c, reactance)
    resolved = discretisation(waves, edge)
    _log.info("waves below %g Hz: %s", edge, resolved)
    out = solve(waves, a, b, edge, duration, config.air)
    velocity = np.ascontiguousarray(np.moveaxis(out[:, :, 1:], 2, 3))
    pressure = np.ascontiguousarray(out[:, :, 0])
    return LowResponses(pressure, velocity, response_rate(edge), edge, a, b, resolved)


def discretisation(waves: WaveScene, edge: float) -> Discretisation:
    """What the lattice could resolve at `edge`, Hz."""
    h, scene = waves.lattice.spacing, waves.scene
    name, misfit = table_misfit(scene.materials, waves.branches, scene.face_material)
    spread = velocity_spread(edge, h, waves.step, waves.c)
    return Discretisation(h, waves.step, waves.lattice.cells, spread, name, misfit)


def _check_room(sources: int, listeners: int, edge: float, duration: float) -> None:
    """Raise `PointError` if there is no room for the result, and what is made of it."""
    wanted = 2.0 * 4.0 * sources * listeners * ROWS * response_samples(edge, duration)
    if not wanted <= free_memory():
        raise PointError(
            f"{sources} sources × {listeners} listeners: their responses take {wanted / 1e9:.1f} GB of memory, and "
            f"{free_memory() / 1e9:.1f} GB are free; simulate some at a time"
        )
