"""Walks: the paths of sound from wall to wall.

A walk leaves its point in a uniform direction and bounces until it escapes or is too long; absorption
weighs it, and `population` keeps the weights of a batch of walks alike. The same walk serves in two roles:
what it deposits at other points' detectors, and the vertices that it leaves to be joined.
"""

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.transport import bsdf as lobes
from soundspaces_sim.transport.bsdf.surface import backward, can_join, choose_hero, density, depart
from soundspaces_sim.transport.paths import mis
from soundspaces_sim.transport.paths.bounce import bounce, meet
from soundspaces_sim.transport.paths.detect import pass_detectors
from soundspaces_sim.transport.paths.detector import Detectors
from soundspaces_sim.transport.paths.emission import emit
from soundspaces_sim.transport.paths.population import STEP, resample
from soundspaces_sim.transport.state import (
    WALK,
    Receivers,
    Scratch,
    Tables,
    Vertices,
    Walk,
    Walks,
    World,
)
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, copy, harmonics


@part
def _store_vertex(vertices, index, point, normal, came, length, weights, material, events, beta):
    slot = vertices.count[index]
    row = vertices.state[index, slot]
    row.x, row.y, row.z = point
    row.nx, row.ny, row.nz = normal
    row.ix, row.iy, row.iz = came
    row.length = length
    row.d_vcm, row.a, row.b = weights
    row.material, row.events = material, events
    copy(beta, vertices.beta[index, slot])
    vertices.count[index] = slot + 1


@part
def _start_walks(walks, world, key, batch):
    """Fill the slots of a batch with its walks, all at their point."""
    walks.beta[:] = 1.0
    walks.mixture[:] = 1.0
    for i in range(len(walks.alive)):
        index = i * BATCHES + batch
        walks.index[i] = index
        walks.stream[i] = combine(key, 2 * index)
        # Independent from walk to walk, since joins multiply the weights of two.
        walks.hero[i] = choose_hero(world.surfaces, hashed_uniform(walks.stream[i], 1))
        direction = emit(key, index)
        harmonics(direction[0], direction[1], direction[2], walks.first[i])
        state = walks.state[i]
        state.ox, state.oy, state.oz = 0.0, 0.0, 0.0
        state.dx, state.dy, state.dz = direction
        state.nx, state.ny, state.nz = 0.0, 0.0, 0.0
        state.ix, state.iy, state.iz = 0.0, 0.0, 0.0
        state.d_vcm, state.a, state.b = mis.start(world.settings.kappa)
        state.length = 0.0
        state.material, state.events = -1, 0
        walks.scattered[i] = False
        walks.alive[i] = True
        walks.retired[i] = False


@part
def _advance(world, receivers, point, walks, i, limit, segment, vertices, scratch, out):
    """Let walk `i` bounce until it is `limit` metres long or ends; returns the segment counter."""
    geometry, surfaces, settings = world.geometry, world.surfaces, world.settings
    index = walks.index[i]
    state, beta, mixture, first = walks.state[i], walks.beta[i], walks.mixture[i], walks.first[i]
    stream, hero = walks.stream[i], walks.hero[i]
    joined = index < settings.joined
    origin = (point[0] + state.ox, point[1] + state.oy, point[2] + state.oz)
    direction = (state.dx, state.dy, state.dz)
    normal, came = (state.nx, state.ny, state.nz), (state.ix, state.iy, state.iz)
    d_vcm, a, b = state.d_vcm, state.a, state.b
    length, material, events = state.length, state.material, state.events
    share = 1.0 / settings.walks
    scattered = walks.scattered[i]  # until then `specular` makes its paths
    longest = settings.late_length if settings.merging else math.inf
    alive = True
    while length < limit:
        if length > longest:
            alive, walks.retired[i] = False, True
            break
        remaining = settings.max_length - length
        t, triangle, x, n = meet(geometry, origin, direction, remaining)
        if scattered:
            harmonics(-direction[0], -direction[1], -direction[2], scratch.arrival)
            walk = Walk(
                stream, segment, index % BATCHES, events, length, 0.0, longest, a, b, share, material,
                came, normal,
            )  # fmt: skip
            leg = (*origin, *direction, min(t, remaining))
            pass_detectors(world, receivers, walk, leg, beta, first, scratch, out)
            segment += 1
        if triangle < 0 or events >= settings.max_bounces:
            alive = False
            break

        length += t
        normal = n
        cos_in = -(n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2])
        if cos_in < 1e-6:
            alive = False  # grazing within rounding: carries no energy
            break
        # A join across the step just made is sampled once from the point itself, else `vv` times.
        count = 1.0 if events == 0 else settings.vv
        d_vcm, a, b = mis.arrive(d_vcm, a, b, t, cos_in, count)
        events += 1
        wall = geometry.material[triangle]
        if (
            joined and can_join(surfaces, wall)
            and length <= settings.join_length and events <= settings.join_depth
        ):  # fmt: skip
            eps = geometry.epsilon
            lifted = (x[0] + eps * n[0], x[1] + eps * n[1], x[2] + eps * n[2])
            _store_vertex(
                vertices, index, lifted, n, direction, length, (d_vcm, a, b), wall, events, beta
            )

        came = direction
        lobe, origin, direction, stream = bounce(
            geometry, surfaces, wall, hero, events, cos_in, x, n, direction, stream, beta, mixture
        )
        if lobe < 0:
            alive = False
            break
        if lobes.scatters(lobe):
            cos_out = max(n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2], 1e-9)
            forward_w = max(density(surfaces, wall, came, n, direction), 1e-12)
            reverse_w = backward(surfaces, wall, came, n, direction)
            d_vcm, a, b = mis.leave_scatter(d_vcm, a, b, forward_w, reverse_w, cos_out)
            material, scattered = wall, True
            depart(surfaces, wall, lobe, cos_out, beta)
        else:
            d_vcm, a, b = mis.leave_delta(a, b, cos_in)
            material = -1

    state.ox, state.oy, state.oz = origin[0] - point[0], origin[1] - point[1], origin[2] - point[2]
    state.dx, state.dy, state.dz = direction
    state.nx, state.ny, state.nz = normal
    state.ix, state.iy, state.iz = came
    state.d_vcm, state.a, state.b = d_vcm, a, b
    state.length, state.material, state.events = length, material, events
    walks.scattered[i], walks.stream[i], walks.alive[i] = scattered, stream, alive
    return segment


def make_walks(world: World, detectors: Detectors) -> tuple[Walks, Scratch]:
    """A batch's walks and a thread's scratch, for `trace_walks`."""
    return empty_walks(world, world.settings.walks // BATCHES), make_scratch(
        world.air.shape[1], detectors
    )


def empty_walks(world: World, slots: int) -> Walks:
    """Room for `slots` walks that advance together."""
    return Walks(
        np.empty(slots, np.int64), np.empty(slots, np.uint64), np.empty(slots, np.int64),
        np.empty(slots, WALK), np.empty((slots, world.air.shape[1])),
        np.empty((slots, world.surfaces.proposal.shape[1])), np.empty((slots, CHANNELS)),
        np.empty(slots, np.bool_), np.empty(slots, np.bool_), np.empty(slots, np.bool_), np.empty(slots),
        np.empty(slots, np.int64),
    )  # fmt: skip


def make_scratch(bands: int, detectors: Detectors) -> Scratch:
    """A thread's working arrays."""
    return Scratch(np.empty(bands), np.empty(CHANNELS), np.empty(detectors.group_sphere.shape[1]))


@kernel
def trace_walks(
    first, last, world, points, keys, own_section, detectors, vertices, tables, work
):  # fmt: skip
    """Walks of the points `first` to `last` (exclusive), deposited at every detector.

    `own_section` (P, LEVELS) of the points' own detectors; `vertices` and `tables` have a row per
    point. A batch of walks advances together and is resampled on the way.
    """
    settings = world.settings
    walks, scratch = work
    for p in range(first, last):
        receivers = Receivers(detectors, own_section[p])
        out = Tables(tables.arrive[p], tables.leave[p], tables.batches[p])
        own = Vertices(vertices.state[p], vertices.beta[p], vertices.count[p], vertices.first[p])
        point = (points[p, 0], points[p, 1], points[p, 2])
        key = keys[p]
        for index in range(settings.joined):
            direction = emit(key, index)
            harmonics(direction[0], direction[1], direction[2], own.first[index])
        segment = np.int64(0)
        for batch in range(BATCHES):
            _start_walks(walks, world, key, batch)
            limit, stage = 0.0, 0
            while limit < settings.max_length:
                limit = min(limit + STEP, settings.max_length)
                stage += 1
                any_alive = False
                for i in range(len(walks.alive)):
                    if walks.alive[i]:
                        segment = _advance(
                            world, receivers, point, walks, i, limit, segment, own, scratch, out
                        )
                        any_alive |= walks.alive[i]
                if not any_alive:
                    break
                draw = hashed_uniform(combine(key, 2 * batch + 1), 2 + stage)
                resample(walks, settings, limit, draw, len(walks.alive))
