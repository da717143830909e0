"""Specular planes of a scene, prepared once: `PreparedScene.part(prepare_planes)`."""

from __future__ import annotations

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.io.disk_cache import kept
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.check_cached import like, scene_key, within
from soundspaces_sim.transport.image_source.specular_planes import SpecularPlanes, group_planes
from soundspaces_sim.transport.model import PreparedScene
from soundspaces_sim.transport.technique import Facets

_PLANES = {"normal": "f8 P 3", "offset": "f8 P", "margin": "f8 P", "of_face": "i8 F"}


def prepare_planes(scene: Scene, config: SimulationConfig) -> SpecularPlanes:  # noqa: ARG001 - one signature for all
    """The planes that reflect early sound specularly, relative to the scene's centre."""
    return kept(
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
