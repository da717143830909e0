"""A scene, brought into the form that kernels use, under one config and seed."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.io.disk_cache import fingerprint, kept
from soundspaces_sim.core.numerics.kernel import at_once, over_rows
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.scene.porous_layers import mounted
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.bsdf.finite_size import size_scattering
from soundspaces_sim.transport.bsdf.surface import Surfaces, make_surfaces, scattered_energy, uneven_lobe
from soundspaces_sim.transport.check_cached import patches_fit, scene_fits, scene_key, shared_fit
from soundspaces_sim.transport.diffraction.wedges import Edges, Links, find_edges, find_links, no_edges
from soundspaces_sim.transport.image_source.specular_planes import Planes, group_planes
from soundspaces_sim.transport.paths.decay import measure_decay
from soundspaces_sim.transport.paths.detector import make_radii
from soundspaces_sim.transport.radiance_transfer.batch_variance import group_patches
from soundspaces_sim.transport.radiance_transfer.patches import (
    PATCH_SIZE,
    Patches,
    make_patches,
    no_patches,
)
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import (
    SharedWalks,
    trace_shared,
    walks_per_patch,
)
from soundspaces_sim.transport.state import Settings, World
from soundspaces_sim.transport.tables import BATCHES

_log = logging.getLogger(__name__)
EARLY_S = 0.08  # end of the early window after the direct sound's time (ISO 3382-1: C80)
_EARLY_WINDOWS_S = 0.1  # up to which windows of error bars are …
_WINDOW_S = 1.0 / 60.0  # … so wide, …
_LATE_WINDOWS = 12  # … and then so many
_JOIN_DEPTH = 64  # paths with more events are not joined
_AIR_STEP = 0.1  # m
_SHORT_WALKS = 4  # for each that the config asks for, where they end with the join window
_VERTEX_SHARE = 8.0  # typical number of vertices of a joined walk, for the MIS count of pairs drawn


class Mirrors(NamedTuple):
    """The planes that mirror early sound, relative to the scene's centre."""

    normal: np.ndarray  # (P, 3)
    offset: np.ndarray  # (P,) m
    margin: np.ndarray  # (P,) m


@dataclass(frozen=True)
class Model:
    """A scene prepared for the kernels under one config and seed; `duration` in s is decided."""

    scene: Scene
    config: SimulationConfig
    seed: int
    duration: float
    time_edges: np.ndarray  # (bins + 1,) s
    world: World
    mirrors: Mirrors
    edges: Edges  # that bend sound
    links: Links  # between edges that see each other

    @property
    def windows(self) -> int:
        """Number of windows of time in which error bars are kept."""
        return int(self.world.window_of_bin[-1]) + 1

    @cached_property
    def shared(self) -> SharedWalks:
        """Walks that the points share, traced once they are asked for."""
        key = scene_key(self.scene), self.config, self.duration, self.seed
        make = partial(trace_shared, self.world, self.seed)
        return kept(SharedWalks, key, make, partial(shared_fit, world=self.world))

    @cached_property
    def patch_groups(self) -> np.ndarray:
        """(C,) groups of patches, for error bars."""
        return group_patches(self.world.geometry, self.world.patches)


class _OfScene(NamedTuple):
    """What hangs on a scene and the bands alone."""

    planes: Planes
    by_size: np.ndarray  # see `scattered_by_size`
    edges: Edges
    links: Links


def _look_at(scene: Scene, config: SimulationConfig) -> _OfScene:
    _ = scene.geometry  # made once
    by_size, bending, planes = at_once(
        lambda: scattered_by_size(scene, config),
        lambda: bending_edges(scene, config),
        lambda: group_planes(scene.vertices - scene.center, scene.faces),
    )
    return _OfScene(planes, by_size, *bending)


def make_model(
    scene: Scene, points: np.ndarray, config: SimulationConfig | None = None, seed: int = 0
) -> Model:
    """Bring a scene into the kernels' form; `points` serve to measure the decay if none is set."""
    config = config or SimulationConfig()
    if not config.sheets:
        scene = mounted(scene)
    key = scene_key(scene), config.bands, config.c, config.scattering, config.diffraction
    shape = len(scene.faces), 0 if config.scattering == "table" else len(config.bands) - 1
    make, fits = partial(_look_at, scene, config), partial(scene_fits, shape=shape)
    planes, by_size, edges, links = kept(_OfScene, key, make, lambda found: fits(*found))
    surfaces, of_face = scene_surfaces(scene, config, by_size)
    geometry = scene.geometry._replace(plane=planes.of_face, material=of_face)
    duration = config.duration or _measure_duration(geometry, surfaces, scene, points, config, seed)
    mirrors = Mirrors(planes.normal, planes.offset, planes.margin)
    model = assemble_model(scene, config, seed, duration, geometry, surfaces, mirrors, edges, links)
    _log.info("Late sound that was scattered: %s", late_technique(model))
    return model


def late_technique(model: Model) -> str:
    """Which technique makes it, and why. The middle wherever it can: docs/lab_notes.md compares both."""
    world, patches = model.world, len(model.world.patches.weight)
    why = _why_hits(model.config, model.duration, world.surfaces, world.geometry)
    if not (why or patches):
        why = "no surface is large enough for a patch, or none scatters"
    if why:
        return f"hits, as {why}"
    walks = walks_per_patch(world.settings.round, patches)
    return f"the middle, with {patches} patches and {walks} shared walks from each"


def scattered_by_size(scene: Scene, config: SimulationConfig) -> np.ndarray:
    """(F, b) share that every face scatters by its size; (F, 0) if the config wants none."""
    if config.scattering == "table":
        return np.empty((len(scene.faces), 0))
    return size_scattering(scene, config.bands, config.c)


def scene_surfaces(
    scene: Scene, config: SimulationConfig, by_size: np.ndarray
) -> tuple[Surfaces, np.ndarray]:
    """How the surfaces of a scene answer under this config, and the (F,) row of each face's: one for every
    material, or for every material and share that is scattered by size (`scattered_by_size`)."""
    table = scene.materials
    columns = table.in_bands(config.bands)
    by_angle = np.array([(own or config.reflection) == "angle" for own in table.reflection])
    sheet, of_face = table.free_hanging, np.array(scene.face_material)
    if by_size.shape[1]:
        kinds = np.column_stack([of_face, by_size])
        first, of_face = unique_rows(kinds)
        kinds = kinds[first]
        rows = kinds[:, 0].astype(np.int64)
        absorption, scattering, transmission = (column[rows] for column in columns)
        columns = absorption, 1.0 - (1.0 - scattering) * (1.0 - kinds[:, 1:]), transmission
        by_angle, sheet = by_angle[rows], sheet[rows]
    return make_surfaces(*columns, by_angle, sheet), of_face


def bending_edges(scene: Scene, config: SimulationConfig) -> tuple[Edges, Links]:
    """The edges of a scene that bend sound under this config, and those of them that see each other."""
    edges = find_edges(scene) if config.diffraction else no_edges()
    return edges, find_links(scene, edges)


def at_points(model: Model, points: np.ndarray) -> Model:
    """What `make_model` gives for other points of the same scene, without what depends on the scene alone."""
    config, world = model.config, model.world
    duration = config.duration or _measure_duration(
        world.geometry, world.surfaces, model.scene, points, config, model.seed
    )
    return assemble_model(
        model.scene, config, model.seed, duration, world.geometry, world.surfaces, model.mirrors,
        model.edges, model.links,
        None if _why_hits(config, model.duration, world.surfaces, world.geometry) else world.patches,
    )  # fmt: skip


def _why_hits(config: SimulationConfig, duration: float, surfaces: Surfaces, geometry: Geometry) -> str:
    """Why the middle may not make late sound that was scattered; "" if it may."""
    if not config.merging:
        return "merging is off"
    if not duration > config.join_window:
        return f"there is none after the join window ({config.join_window:g} s)"
    lobe = uneven_lobe(surfaces, geometry.material)
    return f"lobe '{lobe}' scatters unevenly, which patches do not carry" if lobe else ""


def assemble_model(
    scene: Scene, config: SimulationConfig, seed: int, duration: float, geometry: Geometry,
    surfaces: Surfaces, mirrors: Mirrors, edges: Edges, links: Links, patches: Patches | None = None,
) -> Model:  # fmt: skip
    """A model for echograms of `duration` s; `patches` as they were made before, if they were."""
    time_edges, bin_of_step = _time_bins(config, duration)
    if _why_hits(config, duration, surfaces, geometry):
        patches = no_patches(len(config.bands) - 1)
    elif patches is None:
        scattered = scattered_energy(surfaces)[geometry.material]
        patches = kept(
            Patches, (scene_key(scene), fingerprint(scattered)),
            lambda: make_patches(geometry, scene.corners - scene.center, scattered, PATCH_SIZE),
            lambda found: patches_fit(found, *scattered.shape),
        )  # fmt: skip
    settings = _settings(config, time_edges, len(patches.weight))
    longest = float(time_edges[-1]) * config.c + 2.0 * scene.diagonal + 4.0
    world = World(
        geometry, surfaces, patches,
        make_radii(config.radius_min, config.radius_growth, config.radius_max), settings, bin_of_step,
        _windows_of(time_edges), _air_table(config, longest, settings.air_step),
    )  # fmt: skip
    return Model(scene, config, seed, duration, time_edges, world, mirrors, edges, links)


def _late_from(config: SimulationConfig, edges: np.ndarray) -> float:
    """The first edge of a bin, s, from which on nothing is joined any more."""
    later = edges[edges > config.join_window - 1e-9]
    return float(later.min(initial=edges[-1]))


def _settings(config: SimulationConfig, edges: np.ndarray, patches: int) -> Settings:
    """Settings for echograms of these time bins and a scene of so many patches."""
    end = float(edges[-1]) * config.c
    rounded = -(-config.walks // BATCHES) * BATCHES  # batches of equal size
    walks = rounded * (_SHORT_WALKS if patches else 1)
    joined = min(config.joined_walks, walks) if config.join_window > 0.0 else 0
    return Settings(
        walks=walks,
        round=rounded,
        specular=rounded * config.specular_ratio,
        joined=max(joined, 1),
        kappa=walks / max(joined, 1),
        vv=config.joins_per_vertex / _VERTEX_SHARE,
        joins_per_vertex=config.joins_per_vertex,
        max_bounces=config.max_bounces,
        max_length=end + 2.0 * config.radius_max,  # so that detectors catch the last bin whole
        join_length=min(config.join_window * config.c, end) if joined else -1.0,
        join_depth=_JOIN_DEPTH,
        merging=patches > 0,
        late_length=_late_from(config, edges) * config.c,
        step=config.time_grid[0][1] * config.c,
        air_step=_AIR_STEP,
    )


def air_transmission(config: SimulationConfig, lengths: np.ndarray) -> np.ndarray:
    """(…, b) share of every band's energy that air leaves after paths of `lengths` (…) m: between the same lengths
    that kernels interpolate between."""
    table = _air_table(config, float(lengths.max(initial=0.0)), _AIR_STEP)
    at = np.arange(len(table)) * _AIR_STEP
    return np.stack([np.interp(lengths, at, column) for column in table.T], axis=-1)


def _air_table(config: SimulationConfig, longest: float, step: float) -> np.ndarray:
    """(steps, b) what air leaves after every `step` m, a little past `longest` m."""
    lengths = np.arange(int(longest / step) + 3) * step
    if config.air is None:
        return np.ones((len(lengths), len(config.bands) - 1))
    return config.air.transmission(config.bands, lengths)


def _time_bins(config: SimulationConfig, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Edges (bins + 1,) that cover `duration`, and the bin of each step of the first width."""
    first = config.time_grid[0][1]
    edges = [0.0]
    for k, (_, width) in enumerate(config.time_grid):
        last = config.time_grid[k + 1][0] if k + 1 < len(config.time_grid) else np.inf
        while edges[-1] < min(last, duration) - 1e-9:
            edges.append(round((edges[-1] + width) / first) * first)
    array = np.array(edges)
    steps = np.rint(np.diff(array) / first).astype(np.int64)
    return array, np.repeat(np.arange(len(steps)), steps)


def _windows_of(edges: np.ndarray) -> np.ndarray:
    """(bins,) window of error bars that a bin between `edges` belongs to."""
    early = np.arange(0.0, min(_EARLY_WINDOWS_S, edges[-1]) + 1e-9, _WINDOW_S)
    late = np.linspace(_EARLY_WINDOWS_S, max(edges[-1], _EARLY_WINDOWS_S), _LATE_WINDOWS + 1)
    starts = np.unique(np.concatenate([early, late]))
    window = np.searchsorted(starts, edges[:-1] + 1e-9, "right") - 1
    return np.unique(window, return_inverse=True)[1]  # none is empty


def _measure_duration(
    geometry: Geometry,
    surfaces: Surfaces,
    scene: Scene,
    points: np.ndarray,
    config: SimulationConfig,
    seed: int,
) -> float:
    """When the energy still under way has fallen by `decay_range_db`, s, in steps of 0.1 s."""
    few = points[np.linspace(0, len(points) - 1, min(len(points), 16)).astype(int)]
    step = 0.005 * config.c
    steps = int(config.max_duration / 0.005)
    bands = len(config.bands) - 1
    decay = np.empty((len(few), steps, bands))
    over_rows(
        measure_decay, len(few), geometry, surfaces, few - scene.center, point_keys(few, seed), 256,
        config.max_bounces, step, _air_table(config, steps * step, step), decay, chunk=1,
        scratch=lambda: (np.empty(bands), np.empty(surfaces.proposal.shape[1])),
    )  # fmt: skip
    tail = decay[:, ::-1].cumsum(axis=1)[:, ::-1]
    alive = tail > tail[:, :1] * 10.0 ** (-config.decay_range_db / 10.0)
    last = int(np.flatnonzero(alive.any(axis=(0, 2))).max(initial=0))
    span = np.linalg.norm(points.max(axis=0) - points.min(axis=0)) / config.c + EARLY_S
    duration = max((last + 1) * 0.005, float(span))
    return min(float(np.ceil(duration * 10.0 - 1e-6)) / 10.0, max(config.max_duration, float(span)))
