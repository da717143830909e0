"""Scene and points in, responses below the first band's edge out. No files."""

from __future__ import annotations

import logging

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.errors import PointError
from soundspaces_sim.core.limits import LONGEST, require
from soundspaces_sim.core.memory import free_memory
from soundspaces_sim.scene.enclosure import check_inside
from soundspaces_sim.scene.porous_layers import mounted
from soundspaces_sim.scene.scene import Scene, check_scene
from soundspaces_sim.transport.waves.dispersion import velocity_spread
from soundspaces_sim.transport.waves.placing import ROWS
from soundspaces_sim.transport.waves.responses import Discretisation, LowResponses
from soundspaces_sim.transport.waves.scheme import WaveScene, make_wave_scene, table_misfit
from soundspaces_sim.transport.waves.solve import solve
from soundspaces_sim.transport.waves.spectrum import response_rate, response_samples

_log = logging.getLogger(__name__)
_EDGES, _CELLS, _REACTANCE = (30.0, 2000.0), (6.0, 40.0), 10.0


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
    _require_between("edge", edge, *_EDGES, "Hz")
    _require_between("cells_per_wavelength", cells_per_wavelength, *_CELLS, "")
    _require_between("reactance", reactance, -_REACTANCE, _REACTANCE, "")
    require(0.0 < duration <= LONGEST, "duration", f"more than 0, at most {LONGEST:g} s", duration)
    check_scene(scene)
    for points, what in ((sources, "sources"), (listeners, "listeners")):
        check_inside(scene, points, what)
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


def _require_between(name: str, value: float, least: float, most: float, unit: str) -> None:
    require(least <= value <= most, name, f"{least:g} to {most:g} {unit}".rstrip(), value)


def _check_room(sources: int, listeners: int, edge: float, duration: float) -> None:
    """Raise `PointError` if there is no room for the result, and what is made of it."""
    wanted = 2.0 * 4.0 * sources * listeners * ROWS * response_samples(edge, duration)
    if not wanted <= free_memory():
        raise PointError(
            f"{sources} sources × {listeners} listeners: their responses take {wanted / 1e9:.1f} GB of memory, and "
            f"{free_memory() / 1e9:.1f} GB are free; simulate some at a time"
        )
