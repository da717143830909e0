"""Who casts rays: Embree, or the hierarchy of arrays (`hierarchy`) where there is no Embree.

`SOUNDSPACES_SIM_RAYS` chooses: ``embree``, ``arrays``, or ``auto`` (the default). Both meet the same triangles but
where a ray hits an edge or rounding decides, so a simulation's bits are those of one of them; keys of what is kept
and of shards hold which.
"""

from importlib import import_module
from typing import Any

from soundspaces_sim.core.embree_library import ray_engine

_MODULES = {"embree": "embree", "arrays": "hierarchy"}
_engine: Any = import_module(f"soundspaces_sim.scene.rays.{_MODULES[ray_engine()]}")

RayScene: Any = _engine.RayScene
intersect: Any = _engine.intersect
occluded: Any = _engine.occluded
