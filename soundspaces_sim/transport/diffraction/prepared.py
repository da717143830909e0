"""Wedges of a scene, prepared once: `PreparedScene.part(prepare_wedges)`."""

from __future__ import annotations

from typing import NamedTuple

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.io.disk_cache import cached_on_disk
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.check_cached import are_starts, like, scene_key, within
from soundspaces_sim.transport.diffraction.find_wedges import find_wedges
from soundspaces_sim.transport.diffraction.mutual_visibility import (
    MutualVisibility,
    find_mutual_visibility,
)
from soundspaces_sim.transport.diffraction.wedges import Wedges, no_wedges

_WEDGES = {
    "start": "f8 E 3",
    "along": "f8 E 3",
    "length": "f8 E",
    "face": "f8 E 3",
    "normal": "f8 E 3",
    "n": "f8 E",
    "offset": "f8 E 3",
    "stands": "b1 E 2",
    "corner": "i8 E 2 2",
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
        and within(wedges.corner, -1, sizes["E"] - 1)
        and within(mutual.wedge, 0, sizes["E"] - 1)
        and within(mutual.reverse, 0, sizes["n"] - 1)
    )
