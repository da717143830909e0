"""Groups of materials whose reflections are counted: those that diffuse sound meets most often."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.echogram.reflection_counts import MaterialGroups, anchors
from soundspaces_sim.echogram.time_windows import ERROR_BARS
from soundspaces_sim.scene.rays.diffuse_walk import diffuse_walks
from soundspaces_sim.scene.scene import Scene

_PLACES, _RAYS, _BOUNCES = 256, 4, 60  # of the paths that measure shares of hits
_LIFT = 0.05  # m, of places off their surface
_STREAM = 0x6A0B  # keeps these places apart from others'


def material_groups(scene: Scene, config: SimulationConfig) -> MaterialGroups:
    """The materials of a scene that sound meets most often; none if the config does not want counts.

    Shares are those of the hits of diffusely reflected paths from random places on all surfaces. What a layer that
    hangs free lets pass changes with its absorption, and what reflects nothing has no counts: both are left out.
    """
    table = scene.materials
    absorption, _, transmission = table.in_bands(config.bands)
    if not config.materials.enabled:
        none = absorption[:0]
        return MaterialGroups((), np.empty(0), none, none, none, ERROR_BARS)
    places = _places(scene.corners - scene.center)
    keys = point_keys(places, _STREAM)
    walks = diffuse_walks(scene.geometry, places, keys, _RAYS, _BOUNCES, len(table.names))
    hits = walks.hits.sum(axis=0)
    share = hits / max(int(hits.sum()), 1)
    fixed = table.free_hanging | (hits == 0) | ~(absorption + transmission < 1.0).all(axis=1)
    order = np.lexsort((np.arange(len(share)), -np.where(fixed, -1.0, share)))
    rows = order[: min(config.materials.groups, int((~fixed).sum()))]
    names = tuple(table.names[row] for row in rows)
    anchor = anchors(absorption[rows], transmission[rows])
    return MaterialGroups(names, share[rows], absorption[rows], transmission[rows], anchor)


def group_of_material(scene: Scene, groups: MaterialGroups) -> np.ndarray:
    """(m,) group of every material of a scene, -1 for none."""
    number = {name: k for k, name in enumerate(groups.names)}
    return np.array([number.get(name, -1) for name in scene.materials.names])


def _places(corners: np.ndarray) -> np.ndarray:
    """(n, 3) random places on triangles (F, 3, 3), on either side of them."""
    rng = np.random.default_rng(_STREAM)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    face = rng.choice(len(area), _PLACES, p=area / area.sum())
    u, v = np.sqrt(rng.random(_PLACES)), rng.random(_PLACES)
    weight = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=1)
    side = rng.choice([-_LIFT, _LIFT], _PLACES) / area[face]
    return np.einsum("nk,nkx->nx", weight, corners[face]) + side[:, None] * normal[face]
