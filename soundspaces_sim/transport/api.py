"""`simulate` as the package shows it: of anything that `load_scene` takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.endpoints import Points
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport import simulate as transport


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
