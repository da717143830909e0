"""`simulate` and others as the package shows them: of anything that `load_scene` takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.endpoints import Points
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport import gradient as derivatives
from soundspaces_sim.transport import simulate as transport
from soundspaces_sim.transport.gradient import Gradient, Weights


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
