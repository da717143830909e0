"""Subpaths of points, for receiver volumes and vertex connections.

Receiver volumes alone make every path with a scattering event, since they need nothing of the other end; the other
techniques take over what they make with less noise.

A subpath leaves its point in a uniform direction and goes on until it escapes or is too long; absorption weighs
it, and `population` keeps the weights of a batch of subpaths alike. The same subpath serves in two roles: what
it deposits at other points' detectors (`detect`), and the vertices that it leaves to be connected
(`connections`). Source of both and of their weights: Georgiev 2012, Implementing vertex connection and merging;
see `mis`.
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.core.numerics.vec3 import Vec3, add, dot, row, subtract
from soundspaces_sim.core.profile import count
from soundspaces_sim.scene.rays.geometry import Hit, before
from soundspaces_sim.transport.bsdf.sampling import choose_proposal
from soundspaces_sim.transport.bsdf.surface import (
    apply_departure_factor,
    can_connect,
    group_count,
    is_delta,
    pdf,
    reverse_pdf,
)
from soundspaces_sim.transport.paths import mis
from soundspaces_sim.transport.paths.advance import (
    RETIRED,
    UNDER_WAY,
    Limits,
    Policy,
    cos_incidence,
    make_advance,
    sample_bsdf,
)
from soundspaces_sim.transport.paths.detect import Carried, Segment, pass_detectors
from soundspaces_sim.transport.paths.detector import Detectors
from soundspaces_sim.transport.paths.emission import emit
from soundspaces_sim.transport.paths.path_state import (
    Paths,
    direction_of,
    empty_paths,
    incident_of,
    normal_of,
    origin_of,
    put_incident,
    put_normal,
    put_origin,
    put_sums,
    start_path,
    sums_of,
)
from soundspaces_sim.transport.paths.population import STEP, resample
from soundspaces_sim.transport.state import (
    TALLY,
    Emitters,
    Receivers,
    Scratch,
    Tables,
    Vertices,
    World,
    emitters_of,
    vertices_of,
)
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, copy, harmonics
from soundspaces_sim.transport.technique import TraceRows
from soundspaces_sim.transport.tile import Side

_GRAZING = 1e-6  # cosine below which, within rounding, a surface receives nothing


class _Context(NamedTuple):
    """What the subpaths of a point know while they advance."""

    world: World
    receivers: Receivers
    vertices: Vertices  # of the point
    scratch: Scratch
    tables: Tables  # of the point
    longest: float  # m, longer paths are radiance transfer's


@part(forceinline=True)
def _at_segment(context: _Context, paths: Paths, i: int, hit: Hit) -> None:
    """Deposit the segment at the detectors that it passes. Until it is scattered, `specular` makes its paths."""
    state, settings, scratch = paths.state[i], context.world.settings, context.scratch
    tally = scratch.tally[0]
    tally.rays += 1
    if not state.scattered:
        return
    direction = direction_of(state)
    harmonics(-direction[0], -direction[1], -direction[2], scratch.arrival)
    segment = Segment(
        origin=origin_of(state),
        direction=direction,
        end=min(hit.distance, settings.max_length - state.length),
        start_length=state.length,
        shortest=0.0,
        longest=context.longest,
        key=state.stream,
        batch=state.index % BATCHES,
        share=1.0 / settings.subpaths,
        events=state.events,
        sums=sums_of(state),
        material=state.material,
        incident=incident_of(state),
        normal=normal_of(state),
    )
    carried = Carried(paths.beta[i], paths.first[i], paths.counts[i])
    pass_detectors(context.world, context.receivers, segment, carried, scratch, context.tables)


@part(forceinline=True)
def _store_vertex(
    context: _Context, paths: Paths, i: int, hit: Hit, sums: mis.PartialSums, material: int
) -> None:
    """Keep a vertex on a surface that scatters, if paths by it can be connected."""
    state, settings, vertices = paths.state[i], context.world.settings, context.vertices
    if not (
        state.index < settings.connected
        and can_connect(context.world.surfaces, material)
        and state.length <= settings.connection_length
        and state.events <= settings.connection_depth
    ):
        return
    slot = vertices.count[state.index]
    vertex = vertices.state[state.index, slot]
    vertex.x, vertex.y, vertex.z = before(context.world.geometry, hit, direction_of(state))
    put_normal(vertex, hit.normal)
    put_incident(vertex, direction_of(state))
    put_sums(vertex, sums)
    vertex.length, vertex.material, vertex.events = state.length, material, state.events
    copy(paths.beta[i], vertices.beta[state.index, slot])
    copy(paths.counts[i], vertices.counts[state.index, slot])
    vertices.count[state.index] = slot + 1


@part(forceinline=True)
def _at_surface(context: _Context, paths: Paths, i: int, hit: Hit) -> bool:
    """Store a vertex, and go on as the surface's BSDF sends sound."""
    geometry, surfaces = context.world.geometry, context.world.surfaces
    state = paths.state[i]
    put_normal(state, hit.normal)
    cos_in = cos_incidence(state, hit)
    if cos_in < _GRAZING:
        return False
    # A connection across the step just made is sampled once from the point itself, else `vv` times.
    count = 1.0 if state.events == 1 else context.world.settings.vv
    sums = mis.arrive(sums_of(state), hit.distance, cos_in, count)
    material = hit.material
    _store_vertex(context, paths, i, hit, sums, material)
    incident = direction_of(state)
    put_incident(state, incident)
    lobe = sample_bsdf(geometry, surfaces, paths, i, hit, cos_in)
    if lobe < 0:
        return False
    if is_delta(lobe):
        put_sums(state, mis.leave_delta(sums, cos_in))
        state.material = -1
        return True
    direction = direction_of(state)
    cos_out = max(dot(hit.normal, direction), 1e-9)
    forward_w = max(pdf(surfaces, material, incident, hit.normal, direction), 1e-12)
    reverse_w = reverse_pdf(surfaces, material, incident, hit.normal, direction)
    put_sums(state, mis.leave_scatter(sums, forward_w, reverse_w, cos_out))
    state.material, state.scattered = material, True
    apply_departure_factor(surfaces, material, lobe, cos_out, paths.beta[i])
    return True


_advance = make_advance(Policy(_at_segment, _at_surface))


@part
def _start(paths: Paths, world: World, key: int, batch: int) -> None:
    """Fill the slots of a batch with its subpaths, all at their point: between calls of `_advance` origins are
    relative to it."""
    paths.beta[:] = 1.0
    paths.mixture[:] = 1.0
    paths.counts[:] = 0
    for i in range(len(paths.alive)):
        index = i * BATCHES + batch
        state = paths.state[i]
        direction = emit(key, index)
        start_path(state, (0.0, 0.0, 0.0), direction)
        harmonics(direction[0], direction[1], direction[2], paths.first[i])
        put_sums(state, mis.start(world.settings.kappa))
        state.index = index
        state.stream = combine(key, 2 * index)
        # Independent from subpath to subpath, since connections multiply the throughputs of two.
        state.proposal = choose_proposal(world.surfaces, hashed_uniform(state.stream, 1))
        paths.alive[i] = True
        paths.retired[i] = False


@part
def _advance_all(context: _Context, paths: Paths, point: Vec3, limit: float) -> bool:
    """Every subpath of a batch up to `limit` metres; whether any is under way."""
    settings = context.world.settings
    limits = Limits(limit, context.longest, settings.max_length, settings.max_bounces)
    any_alive = False
    for i in range(len(paths.alive)):
        if paths.alive[i]:
            state = paths.state[i]
            put_origin(state, add(point, origin_of(state)))
            status = _advance(context.world.geometry, paths, i, limits, context)
            put_origin(state, subtract(origin_of(state), point))
            paths.alive[i] = status == UNDER_WAY
            if status == RETIRED:
                paths.retired[i] = True
            any_alive |= paths.alive[i]
    return any_alive


@kernel
def trace_subpaths(
    first: int,
    last: int,
    world: World,
    emitters: Emitters,
    detectors: Detectors,
    vertices: Vertices,
    tables: Tables,
    work: tuple[Paths, Scratch],
) -> None:
    """Subpaths of the points `first` to `last` (exclusive), deposited at every detector.

    `vertices` and `tables` have a row per point. A batch of subpaths advances together and is resampled on the
    way.
    """
    settings = world.settings
    paths, scratch = work
    for p in range(first, last):
        context = _Context(
            world,
            Receivers(detectors, emitters.section[p]),
            vertices_of(vertices, p),
            scratch,
            Tables(tables.arrive[p], tables.leave[p], tables.batches[p]),
            settings.late_length if settings.radiance_transfer else math.inf,
        )
        key = emitters.keys[p]
        for index in range(settings.connected):
            direction = emit(key, index)
            harmonics(direction[0], direction[1], direction[2], context.vertices.first[index])
        for batch in range(BATCHES):
            _start(paths, world, key, batch)
            limit, stage = 0.0, 0
            while limit < settings.max_length:
                limit = min(limit + STEP, settings.max_length)
                stage += 1
                if not _advance_all(context, paths, row(emitters.points, p), limit):
                    break
                draw = hashed_uniform(combine(key, 2 * batch + 1), 2 + stage)
                resample(paths, settings, limit, stage, draw, len(paths.alive))


def trace(own: Side, other: Side) -> TraceRows:
    """Subpaths of `own`, deposited at the points of `other`; they leave vertices."""
    return partial(_trace_rows, own, other)


def _trace_rows(own: Side, other: Side, rows: slice, tables: Tables, vertices: Vertices) -> None:
    world, detectors = own.model.world, other.ends.detectors
    emitters = emitters_of(own.ends, rows)
    vertices.count[:] = 0
    tallies: list[np.ndarray] = []
    over_rows(
        trace_subpaths, len(emitters.points), world, emitters, detectors, vertices, tables, chunk=1,
        scratch=lambda: _make_work(world, detectors, tallies),
    )  # fmt: skip
    count_tallies(tallies)


def _make_work(world: World, detectors: Detectors, tallies: list[np.ndarray]) -> tuple[Paths, Scratch]:
    """A batch's subpaths and a thread's working arrays, for `trace_subpaths`; `tallies`: as in `make_scratch`."""
    slots, bands = world.settings.subpaths // BATCHES, world.air.shape[1]
    surfaces = world.surfaces
    paths = empty_paths(slots, bands, surfaces.proposal.shape[1], group_count(surfaces))
    return paths, make_scratch(bands, detectors, tallies)


def count_tallies(tallies: list[np.ndarray]) -> None:
    """Put what subpaths have counted, (1,) TALLY of each call of a kernel, into the profile."""
    count(**{what: sum(int(tally[what][0]) for tally in tallies) for what in ("rays", "deposits")})


def make_scratch(bands: int, detectors: Detectors, tallies: list[np.ndarray]) -> Scratch:
    """A thread's working arrays. What it counts is put into `tallies`, for `count_tallies`."""
    tallies.append(np.zeros(1, TALLY))
    return Scratch(
        energy=np.empty(bands),
        arrival=np.empty(CHANNELS),
        near=np.empty(detectors.group_sphere.shape[1]),
        tally=tallies[-1],
    )
