"""Walks from patch to patch, which all points share.

How sound travels between surfaces is a property of the scene, not of a point: it is traced once. As many walks
leave every patch, each with unit energy in every band, where and as the patch scatters; on every patch that they
meet they leave what is scattered there. `transfer` combines them with what a point's own walks
bring to the patches.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.memory import check_memory
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform, uniform
from soundspaces_sim.scene.rays.directions import sample_cosine
from soundspaces_sim.scene.rays.geometry import cast
from soundspaces_sim.transport import bsdf as lobes
from soundspaces_sim.transport.bsdf.surface import choose_hero, depart, even_energy, total
from soundspaces_sim.transport.paths.bounce import bounce, meet
from soundspaces_sim.transport.paths.population import STEP, resample
from soundspaces_sim.transport.paths.subpath import empty_walks
from soundspaces_sim.transport.radiance_transfer.decay_compensation import compensate_decay, fit_decay
from soundspaces_sim.transport.radiance_transfer.patches import patch_at
from soundspaces_sim.transport.state import World
from soundspaces_sim.transport.tables import BATCHES

CHUNK = 256  # patches that are worked on together
_STREAM = 0x3D1E  # keeps these walks' numbers apart from those of points
_SHARED_PER_WALK = 8  # walks in all, at least, for each of a point's
_ALL_UPTO = (
    30.0  # m, from where on walks become fewer: late sound is more even. In proportion, down to …
)
_LEAST_LEFT = 0.125
_EVENTS = 24  # of a walk, that there is room for at first


class TransferSubpaths(NamedTuple):
    """What walk m from patch c leaves on chunk n of the K that the patches make: rows `start[m, c K + n]` to
    `start[m, c K + n + 1]`, of M walks per patch."""

    start: np.ndarray  # (M, C K + 1)
    patch: np.ndarray  # (E,)
    length: np.ndarray  # (E,) m
    energy: np.ndarray  # (E, b) scattered there, without air, times exp(decay length)
    decay: np.ndarray  # (b,) 1/m, about that of the energies
    reach: np.ndarray  # (b,) m, longer paths carry nothing in this band


class _Events(NamedTuple):
    """The same as they come: a row per set of walks, one from each patch."""

    origin: np.ndarray  # (rows, capacity) patch from which the walk set out
    patch: np.ndarray
    length: np.ndarray
    energy: np.ndarray  # (rows, capacity, b)
    count: np.ndarray  # (rows,) events met; those beyond the capacity are not stored


@part
def _start(walks, world, key):
    """One walk on every patch."""
    places = world.patches.places
    for c in range(len(walks.alive)):
        stream = combine(key, c)
        stream, u0 = uniform(stream)
        stream, u1 = uniform(stream)
        stream, u2 = uniform(stream)
        stream, u3 = uniform(stream)
        stream, u4 = uniform(stream)
        k = places.start[c]
        while k + 1 < places.start[c + 1] and places.upto[k] <= u0:
            k += 1
        root = math.sqrt(u1)
        v, w = root * (1.0 - u2), root * u2
        n = (places.normal[k, 0], places.normal[k, 1], places.normal[k, 2])
        lift = world.geometry.epsilon
        state, corners = walks.state[c], places.corners
        state.ox = (
            (1.0 - v - w) * corners[k, 0, 0] + v * corners[k, 1, 0] + w * corners[k, 2, 0] + lift * n[0]
        )
        state.oy = (
            (1.0 - v - w) * corners[k, 0, 1] + v * corners[k, 1, 1] + w * corners[k, 2, 1] + lift * n[1]
        )
        state.oz = (
            (1.0 - v - w) * corners[k, 0, 2] + v * corners[k, 1, 2] + w * corners[k, 2, 2] + lift * n[2]
        )
        state.dx, state.dy, state.dz = sample_cosine(n[0], n[1], n[2], u3, u4)
        state.length, state.events = 0.0, 0
        walks.index[c] = c
        walks.stream[c] = stream
        walks.hero[c] = choose_hero(world.surfaces, hashed_uniform(stream, 1))
        walks.mixture[c] = 1.0
        walks.alive[c] = False
        for b in range(walks.beta.shape[1]):
            walks.beta[c, b] = places.ratio[k, b]
            walks.alive[c] |= places.ratio[k, b] > 0.0
        _, below = cast(world.geometry, state.ox, state.oy, state.oz, -n[0], -n[1], -n[2], 4.0 * lift)
        if below >= 0:
            cos = n[0] * state.dx + n[1] * state.dy + n[2] * state.dz
            depart(world.surfaces, world.geometry.material[below], lobes.DIFFUSE, cos, walks.beta[c])
        walks.retired[c] = False


@part
def _store(events, world, row, origin, patch, length, beta, material, cos):
    slot = events.count[row]
    events.count[row] = slot + 1
    if slot >= events.patch.shape[1]:
        return
    events.origin[row, slot] = origin
    events.patch[row, slot] = patch
    events.length[row, slot] = length
    energy = events.energy[row, slot]
    for b in range(len(beta)):
        energy[b] = beta[b] * even_energy(world.surfaces, material, cos, b)


@part
def _advance(world, walks, i, limit, events, row):
    """Let walk `i` bounce until it is `limit` metres long or ends."""
    geometry, surfaces, settings = world.geometry, world.surfaces, world.settings
    state, beta, mixture = walks.state[i], walks.beta[i], walks.mixture[i]
    stream, hero = walks.stream[i], walks.hero[i]
    origin, direction = (state.ox, state.oy, state.oz), (state.dx, state.dy, state.dz)
    length, bounces = state.length, state.events
    alive = True
    while length < limit:
        t, triangle, x, n = meet(geometry, origin, direction, settings.max_length - length)
        if triangle < 0 or bounces >= settings.max_bounces:
            alive = False
            break
        length += t
        bounces += 1
        material = geometry.material[triangle]
        cos = -(n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2])
        if total(surfaces, material, lobes.DIFFUSE) > 0.0:
            patch = patch_at(world.patches, geometry, triangle, x, n)
            if patch >= 0:
                _store(events, world, row, walks.index[i], patch, length, beta, material, cos)
        lobe, origin, direction, stream = bounce(
            geometry, surfaces, material, hero, bounces, cos, x, n, direction, stream, beta, mixture
        )
        if lobe < 0:
            alive = False
            break
        cos = n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2]
        depart(surfaces, material, lobe, cos, beta)
    state.ox, state.oy, state.oz = origin
    state.dx, state.dy, state.dz = direction
    state.length, state.events = length, bounces
    walks.stream[i], walks.alive[i] = stream, alive


@kernel
def _trace(first, last, world, key, events, work):
    """Fill the rows `first` to `last` of `events`; `world.settings.joined` is 0: all walks are one pool."""
    settings = world.settings
    walks = work
    for row in range(first, last):
        row_key = combine(key, row)
        _start(walks, world, combine(row_key, 0))
        events.count[row] = 0
        limit, stage = 0.0, 0
        while limit < settings.max_length:
            limit = min(limit + STEP, settings.max_length)
            stage += 1
            any_alive = False
            for i in range(len(walks.alive)):
                if walks.alive[i]:
                    _advance(world, walks, i, limit, events, row)
                    any_alive |= walks.alive[i]
            if not any_alive:
                break
            most = int(math.ceil(len(walks.alive) * max(min(_ALL_UPTO / limit, 1.0), _LEAST_LEFT)))
            resample(walks, settings, limit, hashed_uniform(combine(row_key, 1), stage), most)


def subpaths_per_patch(walks: int, patches: int) -> int:
    """Of a scene of so many patches whose points send out `walks`: a multiple of BATCHES.

    Batch k of a point's walks goes on along shared walks m = k (mod BATCHES), so that error bars know what the
    shared walks add.
    """
    wanted = -(-_SHARED_PER_WALK * walks // max(patches, 1))
    return max(-(-wanted // BATCHES), 1) * BATCHES


def subpath_count(world: World) -> int:
    """Walks from every patch."""
    patches = len(world.patches.weight)
    return subpaths_per_patch(world.settings.round, patches) if patches else 0


def trace_transfer_subpaths(world: World, seed: int) -> TransferSubpaths:
    """Trace the walks that the points of a scene share. Raises `ConfigError` if there is no memory for them."""
    patches, bands, rows = len(world.patches.weight), world.air.shape[1], subpath_count(world)
    key = np.uint64(combine(seed, _STREAM))
    pool = world._replace(settings=world.settings._replace(joined=0))
    capacity = patches * _EVENTS
    while True:
        shape = rows, capacity
        # as they come, and once more in order
        check_memory(2.0 * rows * capacity * (12 + 4 * bands), "walks that points share")
        events = _Events(
            np.empty(shape, np.int32), np.empty(shape, np.int32), np.empty(shape, np.float32),
            np.empty((*shape, bands), np.float32), np.empty(rows, np.int64),
        )  # fmt: skip
        over_rows(_trace, rows, pool, key, events, chunk=1, scratch=lambda: empty_walks(world, patches))
        most = int(events.count.max(initial=0))
        if most <= capacity:
            return _by_origin(events, patches)
        capacity = most


def _by_origin(events: _Events, patches: int) -> TransferSubpaths:
    """Events of every walk side by side, by the chunk of their patch, in the order in which they came."""
    rows, count, bands = len(events.count), int(events.count.sum()), events.energy.shape[2]
    chunks = -(-patches // CHUNK)
    walks = TransferSubpaths(
        np.empty((rows, patches * chunks + 1), np.int64), np.empty(count, events.patch.dtype),
        np.empty(count, events.length.dtype), np.empty((count, bands), events.energy.dtype), np.empty(0),
        np.empty(0),
    )  # fmt: skip
    over_rows(_order, rows, events, chunks, np.cumsum(events.count), walks, chunk=1)
    decay, reach = fit_decay(walks.length, walks.energy)
    compensate_decay(walks.length, decay, reach, walks.energy)
    return walks._replace(decay=decay, reach=reach)


def _order(
    first: int, last: int, events: _Events, chunks: int, upto: np.ndarray, walks: TransferSubpaths
) -> None:
    """Fill rows of `walks` from the sets `first` to `last`, of which each ends before row `upto[set]`."""
    for row in range(first, last):
        count = events.count[row]
        before = upto[row] - count
        place = events.origin[row, :count] * chunks + events.patch[row, :count] // CHUNK
        order = np.argsort(place, kind="stable")
        walks.start[row] = before + np.searchsorted(place[order], np.arange(walks.start.shape[1]))
        for column, of_set in (
            (walks.patch, events.patch), (walks.length, events.length), (walks.energy, events.energy),
        ):  # fmt: skip
            np.take(of_set[row], order, axis=0, out=column[before : upto[row]], mode="clip")  # no copy
