"""Wedges of a scene, prepared once: `PreparedScene.part(prepare_wedges)`."""

from __future__ import annotations

from typing import NamedTuple

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.io.disk_cache import kept
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.check_cached import are_starts, like, scene_key, within
from soundspaces_sim.transport.diffraction.wedges import Edges, Links, find_edges, find_links, no_edges

_EDGES = {
    "start": "f8 E 3", "along": "f8 E 3", "length": "f8 E", "face": "f8 E 3", "turn": "f8 E 3", "wedge": "f8 E",
    "lift": "f8 E 3",
}  # fmt: skip
_LINKS = {"start": "i8 E1", "edge": "i8 n", "there": "f8 n 2", "twin": "i8 n"}


class Wedges(NamedTuple):
    """The wedges that diffract sound, and those of them that see each other."""

    edges: Edges
    links: Links


def prepare_wedges(scene: Scene, config: SimulationConfig) -> Wedges:
    """The wedges of a scene; none if the config wants no diffraction."""
    return kept(
        Wedges, (scene_key(scene), config.diffraction), lambda: _find(scene, config.diffraction), _fit
    )


def _find(scene: Scene, wanted: bool) -> Wedges:
    edges = find_edges(scene) if wanted else no_edges()
    return Wedges(edges, find_links(scene, edges))


def _fit(wedges: Wedges) -> bool:
    edges, links = wedges
    sizes: dict[str, int] = {}
    if not like(edges, _EDGES, sizes):
        return False
    sizes["E1"] = sizes["E"] + 1
    return (
        like(links, _LINKS, sizes)
        and are_starts(links.start, sizes["n"])
        and within(links.edge, 0, sizes["E"] - 1)
        and within(links.twin, 0, sizes["n"] - 1)
    )
