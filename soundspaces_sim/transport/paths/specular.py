"""Specular subpaths: sound that is never scattered, and where it is first scattered.

Where surfaces scatter little, half of the late sound has only been reflected specularly, along the few directions
that miss everything soft. Copies of such a subpath follow it exactly, so resampling cannot help; many first
directions can (`guide`). These subpaths make no choice between scattering and specular reflection: they carry the
specular part of the energy and are cheap, because those that have become weak end by Russian roulette. They make
all paths without a diffuse event, except those that `arrivals` finds.

On every patch that they meet they leave the energy that is scattered there (`ReflectionBlock`), of which
`radiance_transfer` makes late paths. On the little surface that is of no patch they are scattered or not. So late
paths that no patch scatters are theirs, too.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, event_uniforms, hashed_uniform
from soundspaces_sim.core.numerics.vec3 import Vec3, put, row
from soundspaces_sim.scene.rays.directions import stratified_pair
from soundspaces_sim.scene.rays.geometry import Hit
from soundspaces_sim.transport.arrivals.images import ORDER, by_images
from soundspaces_sim.transport.bsdf.sampling import sample_split
from soundspaces_sim.transport.bsdf.surface import (
    diffuse_albedo,
    group_count,
    is_delta,
    is_transmission,
    lambertian_reflectance,
)
from soundspaces_sim.transport.paths import mis
from soundspaces_sim.transport.paths.advance import (
    UNDER_WAY,
    Limits,
    Policy,
    apply_departure,
    cos_incidence,
    count_reflection,
    make_advance,
    spawn_ray,
)
from soundspaces_sim.transport.paths.detect import Carried, Segment, pass_detectors
from soundspaces_sim.transport.paths.detector import Detectors
from soundspaces_sim.transport.paths.guide import (
    Guide,
    Pilots,
    empty_guide,
    learn_guide,
    make_pilots,
    sample_guided,
    specular_energy,
)
from soundspaces_sim.transport.paths.path_state import (
    Paths,
    direction_of,
    empty_paths,
    origin_of,
    start_path,
)
from soundspaces_sim.transport.paths.subpath import count_tallies, make_scratch
from soundspaces_sim.transport.radiance_transfer.first_reflections import packed, room_for
from soundspaces_sim.transport.radiance_transfer.patches import patch_at
from soundspaces_sim.transport.radiance_transfer.prepared import late_decay
from soundspaces_sim.transport.state import (
    Emitters,
    Receivers,
    ReflectionBlock,
    Scratch,
    Tables,
    Vertices,
    World,
    emitters_of,
)
from soundspaces_sim.transport.tables import BATCHES, copy, harmonics
from soundspaces_sim.transport.technique import TraceRows
from soundspaces_sim.transport.tile import Side

_STREAM = 0x5BEC  # keeps these subpaths' numbers apart from those of `subpath`
_STEP = 6.0  # m between two looks at the weights
_KEPT = 40.0  # subpaths for each that carries the mean energy of all sound at its length
_EVENTS = 24  # first reflections of a subpath that there is room for at first; rooms are taken as they are filled


class Roulette(NamedTuple):
    """Which subpaths of a batch are under way, and what decides who goes on."""

    active: np.ndarray  # (W,) their numbers, in the first entries
    mean: np.ndarray  # (b,) energy of the mean subpath, see `_mean_energy`


class _Work(NamedTuple):
    """A thread's working arrays."""

    paths: Paths
    roulette: Roulette
    scratch: Scratch
    guide: Guide
    pilots: Pilots


class _Scene(NamedTuple):
    world: World
    decay: np.ndarray  # (b,) 1/m, of all sound; 0: not known


class _Context(NamedTuple):
    """What the specular subpaths of a point know while they advance."""

    world: World
    receivers: Receivers
    scratch: Scratch
    tables: Tables  # of the point
    block: ReflectionBlock
    p: int  # the point's row of `block`
    batch: int


@part(forceinline=True)
def _at_segment(context: _Context, paths: Paths, i: int, hit: Hit) -> None:
    """Deposit the segment at the detectors that it passes, if its paths are of this estimator."""
    state, settings, scratch = paths.state[i], context.world.settings, context.scratch
    tally = scratch.tally[0]
    tally.rays += 1
    if state.scattered:
        wanted = state.length + hit.distance > settings.late_length
    else:
        wanted = state.reflections > 0 and not (
            state.by_images and by_images(state.reflections, state.back)
        )
    if wanted:
        direction = direction_of(state)
        harmonics(-direction[0], -direction[1], -direction[2], scratch.arrival)
        nowhere = (0.0, 0.0, 1.0)
        segment = Segment(
            origin=origin_of(state), direction=direction,
            end=min(hit.distance, settings.max_length - state.length), start_length=state.length,
            shortest=settings.late_length if state.scattered else 0.0, longest=math.inf,
            key=state.stream, batch=context.batch, share=1.0 / settings.specular,
            # Delta events leave a and b as they are; so do Lambertian ones, without connections, as here.
            events=state.events, sums=mis.start(settings.kappa), material=-1, incident=nowhere, normal=nowhere,
        )  # fmt: skip
        carried = Carried(paths.beta[i], paths.first[i], paths.counts[i])
        pass_detectors(context.world, context.receivers, segment, carried, scratch, context.tables)


@part(forceinline=True)
def _store_reflection(context: _Context, paths: Paths, i: int, hit: Hit, patch: int) -> None:
    """Note what a patch scatters of a subpath. Where there is no room, the caller sees the count and starts again
    with more."""
    world, block, p, tally = context.world, context.block, context.p, context.scratch.tally[0]
    slot = tally.reflections
    tally.reflections += 1
    if slot >= block.patch.shape[1]:
        return
    state, beta, energy = paths.state[i], paths.beta[i], block.energy[p, slot]
    block.patch[p, slot] = patch
    block.length[p, slot] = state.length
    block.subpath[p, slot] = i
    cos, material = cos_incidence(state, hit), hit.material
    copy(paths.counts[i], block.counts[p, slot])
    block.group[p, slot] = world.surfaces.group[material]
    for b in range(len(beta)):
        scattered = beta[b] * lambertian_reflectance(world.surfaces, material, cos, b)
        energy[b] = scattered / world.settings.specular


@part(forceinline=True)
def _at_surface(context: _Context, paths: Paths, i: int, hit: Hit) -> bool:
    """Leave what the surface scatters, and go on with what it reflects specularly or transmits."""
    world, state = context.world, paths.state[i]
    geometry, surfaces = world.geometry, world.surfaces
    material = hit.material
    patch = -1
    if world.settings.radiance_transfer and diffuse_albedo(surfaces, material) > 0.0:
        patch = patch_at(world.patches, geometry, hit.triangle, hit.point, hit.normal)
        if patch >= 0:
            _store_reflection(context, paths, i, hit, patch)
    u, v, w = event_uniforms(state.stream, state.events)
    scatter = world.settings.radiance_transfer and patch < 0
    cos = cos_incidence(state, hit)
    lobe = sample_split(surfaces, material, cos, scatter, paths.beta[i], state.events, u)
    if lobe < 0:
        return False
    if not is_delta(lobe):
        state.scattered = True
    if not is_transmission(lobe):
        state.reflections += 1
    count_reflection(surfaces, paths, i, material, lobe)
    mirrored = is_delta(lobe) and not is_transmission(lobe)
    plane = geometry.plane[hit.triangle]
    state.by_images = state.by_images and mirrored and plane >= 0
    if state.reflections == 1:
        state.first_plane = plane
    state.back = state.reflections == ORDER + 1 and plane == state.first_plane
    spawn_ray(geometry, surfaces, state, hit, lobe, (v, w), paths.beta[i])
    apply_departure(surfaces, material, paths, i, hit, lobe)
    return True


_advance = make_advance(Policy(_at_segment, _at_surface))


@part
def _mean_energy(decay: np.ndarray, pilots: Pilots, limit: float, mean: np.ndarray) -> None:
    """Fill `mean` (b,) with the energy of the mean subpath of `limit` m, without air: of all sound, as the
    scene's decay (b,), 1/m, has it, or of what is only mirrored, where that lives longer."""
    for b in range(len(mean)):
        mean[b] = specular_energy(pilots, limit, b)
        if decay[b] > 0.0:
            mean[b] = max(mean[b], math.exp(-decay[b] * limit))


@part
def _play_roulette(paths: Paths, roulette: Roulette, active: int, key: int, stage: int) -> int:
    """End subpaths that carry less than the mean one, in every band; returns how many go on."""
    kept, mean = 0, roulette.mean
    for k in range(active):
        i = roulette.active[k]
        chance = 0.0
        for b in range(len(mean)):
            if _KEPT * paths.beta[i, b] > chance * mean[b]:
                chance = _KEPT * paths.beta[i, b] / mean[b] if mean[b] > 0.0 else 1.0
        if chance < 1.0:
            if hashed_uniform(combine(key, 2 * i + 1), stage) >= chance:
                continue
            for b in range(len(mean)):
                paths.beta[i, b] /= chance
        roulette.active[kept] = i
        kept += 1
    return kept


@part
def _start(work: _Work, point: Vec3, key: int, batch: int, directions: np.ndarray) -> None:
    """Fill the slots of a batch with its subpaths, all at their point; their `directions` (W, 3) are noted."""
    paths = work.paths
    paths.counts[:] = 0
    u0, v0 = hashed_uniform(key, 4 * batch + 1), hashed_uniform(key, 4 * batch + 3)
    batch_key = combine(key, batch)
    for i in range(len(paths.state)):
        u, v = stratified_pair(i, u0, v0)
        direction, density, _ = sample_guided(work.guide, u, v)
        harmonics(direction[0], direction[1], direction[2], paths.first[i])
        start_path(paths.state[i], point, direction)
        paths.state[i].stream = combine(batch_key, 2 * i)
        put(directions, i, direction)
        work.roulette.active[i] = i
        for b in range(paths.beta.shape[1]):
            paths.beta[i, b] = 1.0 / density


@part
def _advance_all(context: _Context, work: _Work, active: int, limit: float) -> int:
    """Every subpath under way up to `limit` metres; returns how many still are."""
    settings, roulette = context.world.settings, work.roulette
    limits = Limits(limit, math.inf, settings.max_length, settings.max_bounces)
    under_way = 0
    for k in range(active):
        i = roulette.active[k]
        if _advance(context.world.geometry, work.paths, i, limits, context) == UNDER_WAY:
            roulette.active[under_way] = i
            under_way += 1
    return under_way


@kernel
def _trace(
    first: int,
    last: int,
    scene: _Scene,
    emitters: Emitters,
    detectors: Detectors,
    block: ReflectionBlock,
    tables: Tables,
    work: _Work,
) -> None:
    """Specular subpaths of the points `first` to `last`, batch by batch; arguments as
    `subpath.trace_subpaths`."""
    world, scratch = scene.world, work.scratch
    settings = world.settings
    for p in range(first, last):
        receivers = Receivers(detectors, emitters.section[p])
        out = Tables(tables.arrive[p], tables.leave[p], tables.batches[p])
        point = row(emitters.points, p)
        key = combine(emitters.keys[p], _STREAM)
        learn_guide(world, point, key, work.guide, work.pilots)
        scratch.tally[0].reflections = 0
        for batch in range(BATCHES):
            context = _Context(world, receivers, scratch, out, block, p, batch)
            _start(work, point, key, batch, block.direction[p, batch])
            active, limit, stage = len(work.paths.state), 0.0, 0
            batch_key = combine(key, batch)
            while limit < settings.max_length and active > 0:
                limit = min(limit + _STEP, settings.max_length)
                stage += 1
                under_way = _advance_all(context, work, active, limit)
                _mean_energy(scene.decay, work.pilots, limit, work.roulette.mean)
                active = _play_roulette(work.paths, work.roulette, under_way, batch_key, stage)
            block.upto[p, batch] = scratch.tally[0].reflections


def _make_work(world: World, detectors: Detectors, tallies: list[np.ndarray]) -> _Work:
    settings, bands = world.settings, world.air.shape[1]
    slots = settings.specular // BATCHES
    return _Work(
        empty_paths(slots, bands, 0, group_count(world.surfaces)),
        Roulette(np.empty(slots, np.int64), np.empty(bands)),
        make_scratch(bands, detectors, tallies),
        empty_guide(),
        make_pilots(settings.specular, settings.max_length, bands),
    )


def trace(own: Side, other: Side) -> TraceRows:
    """Specular subpaths of `own`, deposited at the points of `other`; they leave first diffuse reflections for
    radiance transfer."""
    world, detectors = own.model.world, other.ends.detectors
    transfer = world.settings.radiance_transfer
    unknown = np.zeros(world.air.shape[1])
    scene = _Scene(world, own.model.once(late_decay).rate if transfer else unknown)
    # For all rows in turn.
    room = room_for(0, world.settings.specular * _EVENTS if transfer else 0, world)

    def trace_into(emitters: Emitters, block: ReflectionBlock, into: Tables) -> None:
        tallies: list[np.ndarray] = []
        over_rows(
            _trace, len(emitters.points), scene, emitters, detectors, block, into, chunk=1,
            scratch=lambda: _make_work(world, detectors, tallies),
        )  # fmt: skip
        count_tallies(tallies)

    def trace_rows(rows: slice, tables: Tables, _: Vertices) -> ReflectionBlock | None:
        nonlocal room
        emitters = emitters_of(own.ends, rows)
        points = len(emitters.points)
        if len(room.patch) < points:
            room = room_for(points, room.patch.shape[1], world)
        trace_into(emitters, room, tables)
        most = int(room.upto[:points, -1].max())
        if most > room.patch.shape[1]:  # once more, with room enough, and without a second deposit
            room = room_for(points, most + most // 8, world)
            none = Tables(tables.arrive[:, :, :0], tables.leave[:, :, :0], np.zeros_like(tables.batches))
            trace_into(emitters, room, none)
        return packed(ReflectionBlock(*(column[:points] for column in room))) if transfer else None

    return trace_rows
