"""How the surfaces of a scene answer: its materials, what faces scatter by their size, and closed solids.

Sound passes a closed solid once (`scene.closed_solids`). Its outside transmits, in every band, what the least
transmitting of its materials does, and absorbs what others transmit more; its inside only lets sound pass. A law of
angles counts where sound comes in.
"""

from __future__ import annotations

import logging
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.io.disk_cache import cached_on_disk
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.core.profile import stage
from soundspaces_sim.echogram.reflection_counts import MaterialGroups
from soundspaces_sim.scene.closed_solids import ClosedSolids, closed_solids
from soundspaces_sim.scene.rays.diffuse_walk import diffuse_walks
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.bsdf.finite_size import size_scattering
from soundspaces_sim.transport.bsdf.scores import with_scores
from soundspaces_sim.transport.bsdf.surface import Surfaces, law_rows, make_surfaces
from soundspaces_sim.transport.check_cached import like, scene_key, within
from soundspaces_sim.transport.model import PreparedScene
from soundspaces_sim.transport.reflection_counts.groups import group_of_material

_log = logging.getLogger(__name__)
_RAYS = 16  # from a point; in air none meets the inside of a solid but through a leak
_STREAM = 0x501D  # keeps their directions apart from others'


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
    table, kinds = scene.materials, _kinds(scene, config, by_size)
    law, free = law_rows(table.reflection, config.reflection), table.free_hanging
    group = None if groups is None else group_of_material(scene, groups)
    in_air = kinds.material >= 0
    return make_surfaces(
        kinds.absorption,
        kinds.scattering,
        kinds.transmission,
        np.where(in_air, law[kinds.material], 0),
        in_air & free[kinds.material],
        None if group is None else np.where(in_air, group[kinds.material], -1),
        None if groups is None else groups.anchor,
    ), kinds.of_face


def with_scattering_scores(prepared: PreparedScene) -> tuple[Surfaces, np.ndarray]:
    """The surfaces of a scene with scores, and where they are unknown: see `scores.with_scores`."""
    by_size = scattered_by_size(prepared.scene, prepared.config)
    kinds = _kinds(prepared.scene, prepared.config, by_size)
    columns = kinds.absorption, kinds.scattering, kinds.transmission
    return with_scores(prepared.surfaces, *columns, 1.0 - kinds.by_size)


def warn_of_points_in_solids(prepared: PreparedScene, points: np.ndarray) -> None:
    """Log the first of (N, 3) points, m, from which most rays meet the inside of closed solids."""
    material = prepared.geometry.material
    if (material[:, 0] == material[:, 1]).all():
        return
    walks = diffuse_walks(
        prepared.geometry,
        np.ascontiguousarray(points - prepared.scene.center),
        point_keys(points, _STREAM),
        _RAYS,
        1,
        len(prepared.surfaces.energy),
    )
    inside = walks.hits[:, -1] > _RAYS // 2
    if inside.any():
        x, y, z = points[inside.argmax()]
        _log.warning(
            "%s: %d of %d points lie in closed solids, the first at (%.3f, %.3f, %.3f) m; there is no air in them: "
            "sound passes them, and is not reflected inside. Move the points, or open the mesh there.",
            prepared.scene.name,
            inside.sum(),
            len(points),
            x,
            y,
            z,
        )


class _Kinds(NamedTuple):
    """The m kinds of surface of a scene."""

    material: np.ndarray  # (m,) row of the table, -1 inside solids
    absorption: np.ndarray  # (m, b)
    scattering: np.ndarray  # (m, b), with what its size scatters
    transmission: np.ndarray  # (m, b)
    by_size: np.ndarray  # (m, b) share of what the table mirrors that its size scatters
    of_face: np.ndarray  # (F, 2) in front of and behind the stored normal


def _kinds(scene: Scene, config: SimulationConfig, by_size: np.ndarray) -> _Kinds:
    absorption, scattering, transmission = scene.materials.in_bands(config.bands)
    passing = _passing_solids(scene, transmission)
    # Materials, and where they differ from those: by size, or in a solid that transmits less.
    columns = np.column_stack([scene.face_material, by_size, passing.less])
    first, of_face = unique_rows(columns)
    rows, share = scene.face_material[first], by_size[first]
    if not by_size.shape[1]:
        share = np.zeros((len(rows), scattering.shape[1]))
    through = np.where(passing.less[first, None] < 0, transmission[rows], passing.through[first])
    both = 1.0 - (1.0 - scattering[rows]) * (1.0 - share)
    absorbed = absorption[rows] + (transmission[rows] - through)
    kinds = _Kinds(rows, absorbed, both, through, share, np.column_stack([of_face, of_face]))
    return _with_inside(kinds, passing) if passing.solid.any() else kinds


def _with_inside(kinds: _Kinds, passing: _Passing) -> _Kinds:
    """With one kind more, the inside of solids: nothing is reflected there."""
    nothing = np.zeros((1, kinds.scattering.shape[1]))
    of_face, inside = kinds.of_face.copy(), len(kinds.material)
    of_face[passing.solid & ~passing.outward, 0] = inside
    of_face[passing.solid & passing.outward, 1] = inside
    return _Kinds(
        np.append(kinds.material, -1),
        np.concatenate([kinds.absorption, nothing]),
        np.concatenate([kinds.scattering, nothing]),
        np.concatenate([kinds.transmission, nothing + 1.0]),
        np.concatenate([kinds.by_size, nothing]),
        of_face,
    )


class _Passing(NamedTuple):
    """The closed solids that sound passes, by face."""

    solid: np.ndarray  # (F,) whether it is of one
    outward: np.ndarray  # (F,) whether its stored normal points out of it
    through: np.ndarray  # (F, b) what its solid transmits; 0 of other faces
    less: np.ndarray  # (F,) number of a solid that transmits less than the face's material, else -1


@stage("closed solids")
def _passing_solids(scene: Scene, transmission: np.ndarray) -> _Passing:
    """`transmission` (m, b) of the scene's materials. Layers that hang free are made to be passed twice, and are no
    solids."""
    bands, of_material = transmission.shape[1], transmission[scene.face_material]
    count = len(of_material)
    none = np.zeros(count, bool)
    if not (of_material > 0.0).any():
        return _Passing(none, none, np.zeros((count, bands)), np.full(count, -1))
    solids = cached_on_disk(
        ClosedSolids,
        (scene_key(scene),),
        lambda: closed_solids(scene),
        lambda found: (
            like(found, {"of_face": "i8 F", "outward": "b1 F"}, {"F": count})
            and within(found.of_face, -1, count - 1)
        ),
    )
    number = int(solids.of_face.max()) + 1
    through = np.ones((number + 1, bands))  # the last one is that of no solid
    np.minimum.at(through, solids.of_face, of_material)
    through[-1] = 0.0
    through[solids.of_face[scene.materials.free_hanging[scene.face_material]]] = 0.0
    passes = np.asarray((through > 0.0).any(axis=1))
    solid = passes[solids.of_face]
    through = np.where(solid[:, None], through[solids.of_face], 0.0)
    less = np.where(solid & (through < of_material).any(axis=1), solids.of_face, -1)
    _log.info("%d closed solids let sound pass as a whole", int(passes.sum()))
    return _Passing(solid, solids.outward, through, less)
