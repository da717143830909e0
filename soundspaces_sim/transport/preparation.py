"""Scenes brought into the form that kernels use: surfaces, what techniques prepare, settings of subpaths."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import msgspec
import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.limits import LONGEST
from soundspaces_sim.core.numerics.kernel import at_once
from soundspaces_sim.core.numerics.rng import combine, point_keys
from soundspaces_sim.core.profile import stage
from soundspaces_sim.echogram.time_windows import time_windows
from soundspaces_sim.scene.porous_layers import mounted
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.low_method import low_method
from soundspaces_sim.transport.model import (
    AIR_STEP,
    EARLY_S,
    Model,
    Prepare,
    PreparedScene,
    air_table,
    late_from,
    time_bins,
)
from soundspaces_sim.transport.paths import detector
from soundspaces_sim.transport.paths.decay import measure_decay
from soundspaces_sim.transport.radiance_transfer.patches import no_patches
from soundspaces_sim.transport.reflection_counts.groups import material_groups
from soundspaces_sim.transport.rounds import round_sizes
from soundspaces_sim.transport.scene_surfaces import element_sides, scattered_by_size, scene_surfaces
from soundspaces_sim.transport.state import Settings, World
from soundspaces_sim.transport.technique import Facets
from soundspaces_sim.transport.techniques import TECHNIQUES

_log = logging.getLogger(__name__)
_CONNECTION_DEPTH = 64  # paths with more events are not connected
CUT = "cut: "  # begins the note on responses that are
_SHORT_SUBPATHS = 4  # for each that the config asks for, where they end with the connection window
# Typical number of vertices of a connected subpath, for the MIS count of pairs drawn.
_VERTEX_SHARE = 8.0


@stage("preparation")
def make_model(
    scene: Scene, points: np.ndarray, config: SimulationConfig | None = None, seed: int = 0
) -> Model:
    """Bring a scene into the kernels' form; `points` serve to measure the decay if none is set."""
    return at_points(prepare_scene(scene, config or SimulationConfig()), points, seed)


def prepare_scene(
    scene: Scene, config: SimulationConfig, parts: Mapping[Prepare, Any] | None = None
) -> PreparedScene:
    """What depends on a scene and a config alone. `parts`: what is prepared already, by `Technique.prepare`."""
    if not config.porous_layers:
        scene = mounted(scene)
    low = low_method(config)
    if low is not None:
        low.check_lattice(scene, config)
    with stage("ray structure"):
        geometry = scene.geometry  # made before threads ask for it
    for note in scene.overlap_notes:
        if note not in scene.notes:  # else it was told when the scene was loaded
            _log.info("%s: %s", scene.name, note)
    made = dict(parts or {})
    wanted = {make: None for t in TECHNIQUES for make in t.prepare if make not in made}
    by_size, *found = at_once(
        partial(_staged, scattered_by_size, scene, config),
        *(partial(_staged, prepare, scene, config) for prepare in wanted),
    )
    made.update(zip(wanted, found, strict=True))
    groups = material_groups(scene, config)
    surfaces, material = scene_surfaces(scene, config, by_size, groups)
    sides = element_sides(scene)
    geometry = geometry._replace(material=material, outward=sides.outward)
    return PreparedScene(scene, config, geometry, surfaces, made, groups, sides.thin)


def _staged(make: Prepare, scene: Scene, config: SimulationConfig) -> Any:
    """`make(scene, config)`, as a stage of the profile."""
    with stage(make.__name__.replace("_", " ")):
        return make(scene, config)


def at_points(prepared: PreparedScene, points: np.ndarray, seed: int = 0) -> Model:
    """A model of a job of `points`, whose echograms last as the config says or, if it does not, as long as sound
    does there. Its config has decided what the given one leaves to the job."""
    duration, note = prepared.config.duration, ""
    if duration is None:
        duration, note = _measure_duration(prepared, points, seed)
    model = at_duration(prepared, duration, seed)
    if note:
        _log.warning("%s: %s", prepared.scene.name, note)
        model = replace(model, notes=(note,))
    model = _settled(replace(model, points=len(points), asked=prepared.config))
    low = low_method(model.config)
    if low is not None:
        low.check_points(model, points)
    for technique in TECHNIQUES:
        if technique.describe is not None:
            _log.info(technique.describe(model))
    return model


def _settled(model: Model) -> Model:
    """The model with what its config leaves to a job of its points decided."""
    for technique in TECHNIQUES:
        if technique.settle is not None:
            settled = technique.settle(model, model.points)
            if settled != model.config:
                model = replace(model, prepared=replace(model.prepared, config=settled))
    return model


def of_round(model: Model, number: int, subpaths: int) -> Model:
    """The model for a later round, of so many subpaths per point with random numbers of their own; whatever suits
    their number is decided anew."""
    asked = model.asked or model.config
    fresh = replace(model, seed=int(combine(model.seed, number)) >> 1, earlier=model.first)
    if asked.walks is not None:
        return fresh
    config = msgspec.structs.replace(asked, walks=subpaths)
    settings = _settings(config, model.time_edges, len(model.world.patches.weight))
    prepared = replace(model.prepared, config=config)
    return _settled(replace(fresh, prepared=prepared, world=model.world._replace(settings=settings)))


def at_duration(prepared: PreparedScene, duration: float, seed: int = 0) -> Model:
    """A model for echograms of `duration` s."""
    scene, config = prepared.scene, prepared.config
    time_edges, bin_of_step = time_bins(config, duration)
    facets = Facets(prepared.geometry, no_patches(len(config.bands) - 1))
    for technique in TECHNIQUES:
        if technique.mark is not None:
            with stage(technique.mark.__name__.replace("_", " ")):
                facets = technique.mark(facets, prepared, duration)
    settings = _settings(config, time_edges, len(facets.patches.weight))
    longest = float(time_edges[-1]) * config.c + 2.0 * scene.diagonal + 4.0
    world = World(
        facets.geometry,
        prepared.surfaces,
        facets.patches,
        detector.make_radii(detector.GROWTH),
        settings,
        bin_of_step,
        time_windows(time_edges, prepared.groups.windows),
        air_table(config, longest, settings.air_step),
    )
    return Model(prepared, seed, duration, time_edges, world)


def _settings(config: SimulationConfig, edges: np.ndarray, patches: int) -> Settings:
    """Settings for echograms of these time bins and a scene of so many patches."""
    end = float(edges[-1]) * config.c
    rounded = round_sizes(config)[0]
    subpaths = rounded * (_SHORT_SUBPATHS if patches else 1)
    connections = config.connections
    connected = min(connections.subpaths, subpaths) if connections.window > 0.0 else 0
    return Settings(
        subpaths=subpaths,
        round=rounded,
        specular=rounded * config.specular.ratio,
        connected=max(connected, 1),
        kappa=subpaths / max(connected, 1),
        vv=1.0 / _VERTEX_SHARE,
        max_bounces=config.max_bounces,
        max_length=end + 2.0 * detector.GROWTH.largest,  # so that detectors catch the last bin whole
        connection_length=min(connections.window * config.c, end) if connected else -1.0,
        connection_depth=_CONNECTION_DEPTH,
        radiance_transfer=patches > 0,
        late_length=late_from(config, edges) * config.c,
        step=config.time_grid[0][1] * config.c,
        air_step=AIR_STEP,
    )


@stage("duration")
def _measure_duration(prepared: PreparedScene, points: np.ndarray, seed: int) -> tuple[float, str]:
    """When the energy still under way has fallen by `decay_range_db`, s, in steps of 0.1 s; and a note if that is
    cut at `max_duration`."""
    scene, config, surfaces = prepared.scene, prepared.config, prepared.surfaces
    few = points[np.linspace(0, len(points) - 1, min(len(points), 16)).astype(int)]
    step = 0.005 * config.c
    steps = int(config.max_duration / 0.005)
    decay = measure_decay(
        prepared.geometry,
        surfaces,
        few - scene.center,
        point_keys(few, seed),
        steps,
        step,
        air_table(config, steps * step, step),
        config.max_bounces,
    )
    tail = decay[:, ::-1].cumsum(axis=1)[:, ::-1]
    alive = tail > tail[:, :1] * 10.0 ** (-config.decay_range_db / 10.0)
    last = int(np.flatnonzero(alive.any(axis=(0, 2))).max(initial=0))
    span = np.linalg.norm(points.max(axis=0) - points.min(axis=0)) / config.c + EARLY_S
    duration = max((last + 1) * 0.005, float(span))
    end = max(config.max_duration, float(span))
    return min(float(np.ceil(duration * 10.0 - 1e-6)) / 10.0, end), _cut_note(decay, config)


def _cut_note(decay: np.ndarray, config: SimulationConfig) -> str:
    """What is cut off of decays (points, steps, bands) at `max_duration`; nothing if they fall far enough
    before."""
    tenth = max(decay.shape[1] // 10, 1)
    begun, ended = decay[:, :tenth].sum(axis=1), decay[:, -tenth:].sum(axis=1)
    known = (begun > 0.0) & (ended > 0.0)
    if not known.any():
        return ""
    fallen = 10.0 * float((np.log10(begun[known]) - np.log10(ended[known])).min()) / 0.9
    if fallen >= config.decay_range_db:
        return ""
    needed = config.max_duration * config.decay_range_db / max(fallen, 1e-3)
    lost = [f"T{n}" for n in (20, 30) if fallen < n + 15.0]
    undefined = f", so {' and '.join(lost)} are not defined in every band" if lost else ""
    return (
        f"{CUT}responses end after {config.max_duration:g} s, where the slowest band has fallen by {fallen:.0f} of "
        f"{config.decay_range_db:g} dB{undefined}: set simulation.max_duration to "
        f"{math.ceil(min(needed, LONGEST))} (s) or more, or simulation.decay_range_db lower"
    )
