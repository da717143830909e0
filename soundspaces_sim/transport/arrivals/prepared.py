"""Planes and wedges of a scene, prepared once: `PreparedScene.part(prepare_planes)`, `…(prepare_wedges)`."""

from __future__ import annotations

from typing import NamedTuple

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.io.check_cached import are_starts, like, within
from soundspaces_sim.core.io.disk_cache import cached_on_disk
from soundspaces_sim.scene.scene import Scene, scene_key
from soundspaces_sim.transport.arrivals.find_wedges import find_wedges
from soundspaces_sim.transport.arrivals.scene_edges import MutualVisibility, find_mutual_visibility
from soundspaces_sim.transport.arrivals.specular_planes import SpecularPlanes, group_planes
from soundspaces_sim.transport.arrivals.wedges import Wedges, no_wedges
from soundspaces_sim.transport.model import PreparedScene
from soundspaces_sim.transport.technique import Facets

_PLANES = {"normal": "f8 P 3", "offset": "f8 P", "margin": "f8 P", "of_face": "i8 F"}
_WEDGES = {
    "start": "f8 E 3",
    "along": "f8 E 3",
    "length": "f8 E",
    "face": "f8 E 3",
    "normal": "f8 E 3",
    "n": "f8 E",
    "offset": "f8 E 3",
    "clear": "f8 E 3",
    "stands": "b1 E 2",
}
_MUTUAL = {"start": "i8 E1", "wedge": "i8 n", "phi": "f8 n 2", "reverse": "i8 n"}


class WedgesOfScene(NamedTuple):
    """The wedges that diffract sound, and those of them that see each other."""

    wedges: Wedges
    mutual: MutualVisibility


def prepare_wedges(scene: Scene, config: SimulationConfig) -> WedgesOfScene:
    """The wedges of a scene; none if the config wants no diffraction."""
    wanted = config.diffraction.enabled
    return cached_on_disk(WedgesOfScene, (scene_key(scene), wanted), lambda: _find(scene, wanted), _fit)


def _find(scene: Scene, wanted: bool) -> WedgesOfScene:
    wedges = find_wedges(scene) if wanted else no_wedges()
    return WedgesOfScene(wedges, find_mutual_visibility(scene, wedges))


def _fit(found: WedgesOfScene) -> bool:
    wedges, mutual = found
    sizes: dict[str, int] = {}
    if not like(wedges, _WEDGES, sizes):
        return False
    sizes["E1"] = sizes["E"] + 1
    return (
        like(mutual, _MUTUAL, sizes)
        and are_starts(mutual.start, sizes["n"])
        and within(mutual.wedge, 0, sizes["E"] - 1)
        and within(mutual.reverse, 0, sizes["n"] - 1)
    )


def prepare_planes(scene: Scene, config: SimulationConfig) -> SpecularPlanes:  # noqa: ARG001 - one signature for all
    """The planes that reflect early sound specularly, relative to the scene's centre."""
    return cached_on_disk(
        SpecularPlanes,
        (scene_key(scene),),
        lambda: group_planes(scene.vertices - scene.center, scene.faces),
        lambda planes: _fits(planes, len(scene.faces)),
    )


def _fits(planes: SpecularPlanes, faces: int) -> bool:
    sizes = {"F": faces}
    return like(planes, _PLANES, sizes) and within(planes.of_face, -1, sizes["P"] - 1)


def mark_planes(facets: Facets, prepared: PreparedScene, duration: float) -> Facets:  # noqa: ARG001
    """Subpaths leave early paths whose reflections are all at these planes to image sources."""
    plane = prepared.part(prepare_planes).of_face
    return facets._replace(geometry=facets.geometry._replace(plane=plane))
