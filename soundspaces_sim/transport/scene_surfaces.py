"""How the surfaces of a scene answer: its materials, what faces scatter by their size, and which of their sides is
out (`scene.windings`), for sound that passes elements (`transport.elements`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.io.check_cached import like, within
from soundspaces_sim.core.io.disk_cache import cached_on_disk
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.core.profile import stage
from soundspaces_sim.echogram.reflection_counts import MaterialGroups
from soundspaces_sim.scene.scene import Scene, scene_key
from soundspaces_sim.scene.windings import Sides, find_sides
from soundspaces_sim.transport.bsdf.finite_size import size_scattering
from soundspaces_sim.transport.bsdf.surface import Surfaces, law_rows, make_surfaces
from soundspaces_sim.transport.reflection_counts.groups import group_of_material


class _BySize(NamedTuple):
    share: np.ndarray  # (F, b)


def scattered_by_size(scene: Scene, config: SimulationConfig) -> np.ndarray:
    """(F, b) share that every face scatters by its size; (F, 0) if the config wants none."""
    if config.scattering == "table":
        return np.empty((len(scene.faces), 0))
    sizes = {"F": len(scene.faces), "b": len(config.bands) - 1}
    found = cached_on_disk(
        _BySize,
        (scene_key(scene), config.bands, config.c),
        lambda: _BySize(size_scattering(scene, config.bands, config.c)),
        lambda found: like(found, {"share": "f8 F b"}, dict(sizes)) and within(found.share, 0.0, 1.0),
    )
    return found.share


def scene_surfaces(
    scene: Scene, config: SimulationConfig, by_size: np.ndarray, groups: MaterialGroups | None = None
) -> tuple[Surfaces, np.ndarray]:
    """How the surfaces of a scene answer under this config, and the (F, 2) rows of each face, in front of
    and behind its stored normal. `by_size`: of `scattered_by_size`; `groups`: whose reflections are counted."""
    table = scene.materials
    absorption, scattering, transmission = table.in_bands(config.bands)
    # The kinds of surface: materials, and where they differ from those by size.
    first, of_face = unique_rows(np.column_stack([scene.face_material, by_size]))
    material, share = scene.face_material[first], by_size[first]
    if not by_size.shape[1]:
        share = np.zeros((len(material), scattering.shape[1]))
    law, free = law_rows(table.reflection, config.law), table.free_hanging
    group = None if groups is None else group_of_material(scene, groups)
    return make_surfaces(
        absorption[material],
        1.0 - (1.0 - scattering[material]) * (1.0 - share),
        transmission[material],
        law[material],
        free[material],
        None if group is None else group[material],
        None if groups is None else groups.anchor,
    ), np.column_stack([of_face, of_face])


@stage("windings")
def element_sides(scene: Scene) -> Sides:
    """Which side of a scene's faces is out. Layers that hang free are made to be passed face by face, and where
    nothing transmits there is nothing to pass: their `outward` is 0."""
    count = len(scene.faces)
    if not (scene.materials.transmission > 0.0).any():
        return Sides(np.zeros(count, np.int8), np.zeros(count, bool))
    sides = cached_on_disk(
        Sides,
        (scene_key(scene),),
        lambda: find_sides(scene),
        lambda found: (
            like(found, {"outward": "i8 F", "thin": "b1 F"}, {"F": count})
            and within(found.outward, -1, 1)
        ),
    )
    free = scene.materials.free_hanging[scene.face_material]
    return sides._replace(outward=np.where(free, 0, sides.outward).astype(np.int8))
