"""`simulate`, `simulate_low` and others as the package shows them: of anything that `load_scene` takes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.bands import check_edges
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.endpoints import Points
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport import gradient as derivatives
from soundspaces_sim.transport import simulate as transport
from soundspaces_sim.transport.gradient import Gradient, Weights
from soundspaces_sim.transport.waves import measures
from soundspaces_sim.transport.waves import simulate as waves
from soundspaces_sim.transport.waves.measures import LowMeasures
from soundspaces_sim.transport.waves.responses import LowResponses


def simulate(
    scene: Scene | str | Path | Any,
    sources: Points,
    listeners: Points,
    config: SimulationConfig | None = None,
    seed: int = 0,
) -> Echograms:
    """Echograms between all `sources` (S, 3) and `listeners` (L, 3), in m, anywhere in the scene.

    `scene`: a `Scene`, or what `load_scene` takes: a name, a path, a `trimesh.Trimesh`. `sources` and
    `listeners` may be records, `Source` or `Listener`, alone or in a list: their directivities are applied. The
    result and working memory grow with S L: `build_dataset` cuts large grids into tiles. Raises `SceneError`,
    and `PointError` for points that are not finite or lie outside an enclosed scene.
    """
    return transport.simulate(load_scene(scene), sources, listeners, config, seed)


def gradient(
    scene: Scene | str | Path | Any,
    sources: ArrayLike,
    listeners: ArrayLike,
    weights: Weights,
    config: SimulationConfig | None = None,
    seed: int = 0,
    scattering: bool = False,
) -> Gradient:
    """Derivatives of a loss by the absorption and, if asked for, the `scattering` of the materials that sound meets
    most often, up to twelve, in every band, for the very walks that `simulate` would take.

    `weights` (S, L, bins, bands), m²/J: derivatives of the loss by the energies of bins, arrivals in them included,
    or a function of the `Echograms` that gives them. What is drawn (directions, copies of subpaths) does not move,
    so that the mean over seeds is the derivative of the mean. Late bins are not smoothed. Derivatives by scattering
    are those by the table's coefficient, to which surfaces add what their size scatters. They spread wider than
    those by absorption, since 1 / s is large where little is scattered. Raises `ConfigError` for configs with a
    target error, materials whose law depends on the angle, and weights of another shape, and what `simulate` does.
    """
    return derivatives.gradient(load_scene(scene), sources, listeners, weights, config, seed, scattering)


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

    A finite-difference solver runs once per source, and all listeners listen (docs/waves.md). `scene`: as in
    `simulate`. Of `config` the bands, the air, the speed of sound and `porous_layers` count. `edge`: Hz, up to
    which responses hold; by default that of the first band. `cells_per_wavelength`, 6 to 40: at the edge.
    `reactance`: a table of absorption does not tell the phase of an impedance; this is Im/Re that every wall
    has beside what its table asks for (negative: stiffness), to see what it changes. Omnidirectional ends only.
    Raises `SceneError`, `PointError` for points that are not finite, lie outside an enclosed scene or see no
    cell, `ConfigError` for settings out of range, `SimulationError` for a lattice that is too large.
    """
    a, b = transport.as_points(sources, "sources"), transport.as_points(listeners, "listeners")
    return waves.simulate_low(
        load_scene(scene), a, b, duration, config, edge, cells_per_wavelength, reactance
    )


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
    takes, and `low`: edge, cells per wavelength, reactance. `edges` (K + 1,) Hz up to that edge; by default those
    of the octaves from 63 Hz on that lie below it. Raises `ConfigError`, and what `simulate_low` does.
    """
    a, b = transport.as_points(sources, "sources"), transport.as_points(listeners, "listeners")
    asked = None if edges is None else tuple(check_edges(edges))
    config = config or SimulationConfig()
    return measures.measures_of_waves(load_scene(scene), a, b, duration, config, asked)
