"""Scene and points in, responses below the first band's edge out. No files."""

from __future__ import annotations

import logging

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.errors import PointError
from soundspaces_sim.core.limits import LONGEST, require_within
from soundspaces_sim.core.memory import free_memory
from soundspaces_sim.core.simulation_config import LowConfig
from soundspaces_sim.echogram.low_response import response_rate, response_samples
from soundspaces_sim.scene.enclosure import check_ends
from soundspaces_sim.scene.porous_layers import mounted
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.waves.dispersion import velocity_spread
from soundspaces_sim.transport.waves.placing import ROWS
from soundspaces_sim.transport.waves.responses import Discretisation, LowResponses
from soundspaces_sim.transport.waves.scheme import WaveScene, make_wave_scene, table_misfit
from soundspaces_sim.transport.waves.solve import solve

_log = logging.getLogger(__name__)


def simulate_low(
    scene: Scene,
    sources: np.ndarray,
    listeners: np.ndarray,
    duration: float,
    config: SimulationConfig | None = None,
    edge: float | None = None,
    cells_per_wavelength: float = 12.0,
    reactance: float = 0.0,
) -> LowResponses:
    """Responses between (S, 3) `sources` and (L, 3) `listeners`, m; see `soundspaces_sim.simulate_low`."""
    config = config or SimulationConfig()
    edge = config.bands[1] if edge is None else edge
    LowConfig(edge=edge, cells_per_wavelength=cells_per_wavelength, reactance=reactance)  # raises
    require_within("duration", duration, 0.0, LONGEST, "s", above=True)
    check_ends(scene, sources, listeners)
    _check_room(len(sources), len(listeners), edge, duration)
    if not config.porous_layers:
        scene = mounted(scene)
    waves = make_wave_scene(scene, edge, cells_per_wavelength, config.c, reactance)
    resolved = discretisation(waves, edge)
    _log.info("waves below %g Hz: %s", edge, resolved)
    out = solve(waves, sources, listeners, edge, duration, config.air)
    velocity = np.ascontiguousarray(np.moveaxis(out[:, :, 1:], 2, 3))
    pressure = np.ascontiguousarray(out[:, :, 0])
    return LowResponses(pressure, velocity, response_rate(edge), edge, sources, listeners, resolved)


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
