"""Transfer subpaths: from patch to patch, traced once for all points of a scene, or for each point.

Subpaths leave patches with unit energy in every band, at places in proportion to ρs dA and in directions of
Lambert's law. On every patch that they meet they leave the energy that is scattered there. Together they estimate
the sum over n >= 1 of T^n, T the operator of the package's equation (1): `patch_histograms` carries first
reflections of points on along them.

A population is a row of subpaths that advance together: its weights are kept alike (`transport.paths.population`),
and it thins out with length, for late sound is more even. *Shared* subpaths are M populations with one subpath from
each patch. *Own* ones are a population for each batch of a point, which leave the patches where the reflections lie
that they carry on: where points are few that is less to trace.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.memory import check_memory
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform, uniform
from soundspaces_sim.core.numerics.vec3 import Vec3, dot, negate, row as row_of
from soundspaces_sim.core.profile import count
from soundspaces_sim.scene.rays.directions import sample_cosine_hemisphere
from soundspaces_sim.scene.rays.geometry import Hit, cast_ray, lifted, material_met
from soundspaces_sim.transport.bsdf.sampling import choose_proposal
from soundspaces_sim.transport.bsdf.surface import (
    apply_emission_factor,
    diffuse_albedo,
    group_count,
    lambertian_reflectance,
)
from soundspaces_sim.transport.paths.advance import (
    UNDER_WAY,
    Limits,
    Policy,
    apply_departure,
    cos_incidence,
    make_advance,
    sample_bsdf,
)
from soundspaces_sim.transport.paths.path_state import (
    Paths,
    direction_of,
    empty_paths,
    origin_of,
    start_path,
)
from soundspaces_sim.transport.paths.population import STEP, resample
from soundspaces_sim.transport.radiance_transfer.patches import Places, patch_at
from soundspaces_sim.transport.state import World
from soundspaces_sim.transport.tables import copy

CHUNK = 256  # patches whose histograms are filled together
_ALL_UPTO = 30.0  # m, beyond which the number of subpaths falls as 1 / length …
_LEAST_LEFT = 0.125  # … down to this share
_EVENTS = 64  # of a pilot, for which there is room at first
_MARGIN = 1.5  # room for others, relative to what pilots leave


class TransferSubpaths(NamedTuple):
    """What M populations of S subpaths leave on patches, in K chunks of `CHUNK` patches.

    Events of subpath s of population m on chunk n are rows `start[m, s K + n]` to `start[m, s K + n + 1]` of the
    columns. Of shared subpaths, s is the patch that they leave.
    """

    start: np.ndarray  # (M, S K + 1)
    patch: np.ndarray  # (E,)
    length: np.ndarray  # (E,) m
    energy: np.ndarray  # (E, b) that the patch scatters, decay-compensated, without air
    counts: np.ndarray  # (E, groups) reflections since the subpath set out, this one included
    decay: np.ndarray  # (b,) 1/m, of the compensation
    reach: np.ndarray  # (b,) m, longer paths carry nothing in this band


class Populations(NamedTuple):
    """M populations of S subpaths."""

    key: np.ndarray  # (M,) uint64 of random numbers
    patch: np.ndarray  # (M, S) from which each sets out, -1 for none


class _Events(NamedTuple):
    """What populations leave, in the order of tracing."""

    origin: np.ndarray  # (rows, capacity) number of the subpath in its population
    patch: np.ndarray  # (rows, capacity)
    length: np.ndarray  # (rows, capacity) m
    energy: np.ndarray  # (rows, capacity, b)
    counts: np.ndarray  # (rows, capacity, groups)
    count: np.ndarray  # (rows,) events; those beyond the capacity are not stored
    rays: np.ndarray  # (rows,) for the profile


@part(forceinline=True)
def _sample_triangle(corners: np.ndarray, k: int, u: float, v: float) -> Vec3:
    """A place uniformly on triangle k of (n, 3, 3) corners."""
    root = math.sqrt(u)
    s, t = root * (1.0 - v), root * v
    rest = 1.0 - s - t
    return (
        rest * corners[k, 0, 0] + s * corners[k, 1, 0] + t * corners[k, 2, 0],
        rest * corners[k, 0, 1] + s * corners[k, 1, 1] + t * corners[k, 2, 1],
        rest * corners[k, 0, 2] + s * corners[k, 1, 2] + t * corners[k, 2, 2],
    )


@part(forceinline=True)
def set_out(places: Places, stream: int, c: int) -> tuple[int, int, float, float, Vec3]:
    """The piece of patch c from which a subpath sets out and where on it, with its random numbers."""
    stream, u0 = uniform(stream)
    stream, u1 = uniform(stream)
    stream, u2 = uniform(stream)
    stream, u3 = uniform(stream)
    stream, u4 = uniform(stream)
    k = places.start[c]
    while k + 1 < places.start[c + 1] and places.upto[k] <= u0:
        k += 1
    return k, stream, u3, u4, _sample_triangle(places.corners, k, u1, u2)


@part(forceinline=True)
def face_below(world: World, origin: Vec3, n: Vec3) -> int:
    """The triangle of normal n above which a subpath sets out; -1 for none."""
    _, below = cast_ray(world.geometry, origin, negate(n), 4.0 * world.geometry.epsilon)
    return below


@part
def _start(paths: Paths, world: World, key: int, patches: np.ndarray) -> None:
    """One subpath on each of the `patches` (S,)."""
    places = world.patches.places
    for s in range(len(paths.alive)):
        c = patches[s]
        paths.alive[s], paths.retired[s] = False, c < 0
        if c < 0:
            continue
        k, stream, u3, u4, point = set_out(places, combine(key, s), c)
        n, state = row_of(places.normal, k), paths.state[s]
        start_path(state, lifted(world.geometry, point, n), sample_cosine_hemisphere(n, u3, u4))
        state.index = s
        state.stream = stream
        state.proposal = choose_proposal(world.surfaces, hashed_uniform(stream, 1))
        paths.mixture[s] = 1.0
        paths.counts[s] = 0
        for b in range(paths.beta.shape[1]):
            paths.beta[s, b] = places.ratio[k, b]
            paths.alive[s] |= places.ratio[k, b] > 0.0
        below = face_below(world, origin_of(state), n)
        if below >= 0:
            cos = dot(n, direction_of(state))
            material = material_met(world.geometry, below, negate(n))
            apply_emission_factor(world.surfaces, material, cos, paths.beta[s])


class _Context(NamedTuple):
    """What subpaths know while they advance."""

    world: World
    events: _Events
    row: int  # of `events`


@part(forceinline=True)
def _store(context: _Context, paths: Paths, i: int, hit: Hit, patch: int) -> None:
    """Note what a patch scatters of a subpath, if there is room."""
    world, events, row = context.world, context.events, context.row
    slot = events.count[row]
    events.count[row] = slot + 1
    if slot >= events.patch.shape[1]:
        return
    state, beta, energy = paths.state[i], paths.beta[i], events.energy[row, slot]
    events.origin[row, slot] = state.index
    events.patch[row, slot] = patch
    events.length[row, slot] = state.length
    cos, material = cos_incidence(state, hit), hit.material
    copy(paths.counts[i], events.counts[row, slot])
    group = world.surfaces.group[material]
    if group >= 0 and group < events.counts.shape[2]:
        events.counts[row, slot, group] += np.uint16(1)
    for b in range(len(beta)):
        energy[b] = beta[b] * lambertian_reflectance(world.surfaces, material, cos, b)


@part(forceinline=True)
def _at_segment(context: _Context, _paths: Paths, _i: int, _hit: Hit) -> None:
    context.events.rays[context.row] += 1


@part(forceinline=True)
def _at_surface(context: _Context, paths: Paths, i: int, hit: Hit) -> bool:
    """Leave on a patch what it scatters, and go on as the surface's BSDF sends sound."""
    world = context.world
    geometry, surfaces = world.geometry, world.surfaces
    material = hit.material
    if diffuse_albedo(surfaces, material) > 0.0:
        patch = patch_at(world.patches, geometry, hit.triangle, hit.point, hit.normal)
        if patch >= 0:
            _store(context, paths, i, hit, patch)
    lobe = sample_bsdf(geometry, surfaces, paths, i, hit, cos_incidence(paths.state[i], hit))
    if lobe < 0:
        return False
    apply_departure(surfaces, material, paths, i, hit, lobe)
    return True


_advance = make_advance(Policy(_at_segment, _at_surface))


@kernel
def _trace(
    first: int, last: int, world: World, populations: Populations, events: _Events, paths: Paths
) -> None:
    """Fill the rows `first` to `last` of `events`; `world.settings.connected` is 0: all subpaths are one pool."""
    settings = world.settings
    for row in range(first, last):
        row_key = populations.key[row]
        _start(paths, world, combine(row_key, 0), populations.patch[row])
        events.count[row], events.rays[row] = 0, 0
        context = _Context(world, events, row)
        limit, stage = 0.0, 0
        while limit < settings.max_length:
            limit = min(limit + STEP, settings.max_length)
            stage += 1
            limits = Limits(limit, math.inf, settings.max_length, settings.max_bounces)
            any_alive = False
            for i in range(len(paths.alive)):
                if paths.alive[i]:
                    paths.alive[i] = _advance(world.geometry, paths, i, limits, context) == UNDER_WAY
                    any_alive |= paths.alive[i]
            if not any_alive:
                break
            most = int(math.ceil(len(paths.alive) * max(min(_ALL_UPTO / limit, 1.0), _LEAST_LEFT)))
            draw = hashed_uniform(combine(row_key, 1), stage)
            resample(paths, settings, limit, stage, draw, most)


def trace_populations(world: World, populations: Populations, each: float | None) -> _Events:
    """What populations leave. There is room at first for some more events than `each` leaves as pilots have it."""
    rows, slots = populations.patch.shape
    bands, groups = world.air.shape[1], group_count(world.surfaces)
    pool = world._replace(settings=world.settings._replace(connected=0))

    def make_paths() -> Paths:
        return empty_paths(slots, bands, world.surfaces.proposal.shape[1], groups)

    capacity = slots * _EVENTS
    if each is not None:
        capacity = int(_MARGIN * each * slots)
    while True:
        shape = rows, capacity
        # as they come, and once more in order
        size = 12 + 4 * bands + 2 * groups
        check_memory(2.0 * rows * capacity * size, "transfer subpaths")
        events = _Events(
            np.empty(shape, np.int32),
            np.empty(shape, np.int32),
            np.empty(shape, np.float32),
            np.empty((*shape, bands), np.float32),
            np.empty((*shape, groups), np.uint16),
            np.empty(rows, np.int64),
            np.empty(rows, np.int64),
        )
        over_rows(_trace, rows, pool, populations, events, chunk=1, scratch=make_paths)
        count(rays=int(events.rays.sum()), deposits=int(events.count.sum()))
        most = int(events.count.max(initial=0))
        if most <= capacity:
            return events
        capacity = most


def by_origin(events: _Events, slots: int, patches: int) -> TransferSubpaths:
    """Events sorted by subpath and chunk, within these in the order of tracing, without a decay."""
    rows, count, bands = len(events.count), int(events.count.sum()), events.energy.shape[2]
    chunks = -(-patches // CHUNK)
    subpaths = TransferSubpaths(
        start=np.empty((rows, slots * chunks + 1), np.int64),
        patch=np.empty(count, events.patch.dtype),
        length=np.empty(count, events.length.dtype),
        energy=np.empty((count, bands), events.energy.dtype),
        counts=np.empty((count, events.counts.shape[2]), events.counts.dtype),
        decay=np.empty(0),
        reach=np.empty(0),
    )
    over_rows(_sort_rows, rows, events, chunks, np.cumsum(events.count), subpaths, chunk=1)
    return subpaths


def _sort_rows(
    first: int, last: int, events: _Events, chunks: int, upto: np.ndarray, subpaths: TransferSubpaths
) -> None:
    """Fill `subpaths` from the rows `first` to `last` of `events`, of which each ends before `upto[row]`."""
    pairs = (
        (subpaths.patch, events.patch),
        (subpaths.length, events.length),
        (subpaths.energy, events.energy),
        (subpaths.counts, events.counts),
    )
    for row in range(first, last):
        count = events.count[row]
        before = upto[row] - count
        place = events.origin[row, :count] * chunks + events.patch[row, :count] // CHUNK
        order = np.argsort(place, kind="stable")
        subpaths.start[row] = before + np.searchsorted(place[order], np.arange(subpaths.start.shape[1]))
        for column, of_row in pairs:
            np.take(of_row[row], order, axis=0, out=column[before : upto[row]], mode="clip")  # no copy
