"""Walks: sound is emitted here, and here it bounces.

A walk leaves its point in a uniform direction and bounces until it escapes or is too long; absorption
weighs it, and `resample` keeps the weights of a batch of walks alike. Sources and listeners are both
omnidirectional points, so the same walk serves in both roles: what it deposits at other points'
detectors, and the vertices it leaves for joins.
"""

import math

import numpy as np
from numba import prange

from soundspaces_sim.base.kernel import kernel
from soundspaces_sim.base.rng import combine, hashed_uniform, uniform
from soundspaces_sim.rays.directions import (
    reflect,
    sample_cosine,
    sample_sphere,
    stratified_pair,
)
from soundspaces_sim.rays.geometry import cast, hit_point
from soundspaces_sim.transport import mis
from soundspaces_sim.transport import state as rec
from soundspaces_sim.transport.patches import patch_at
from soundspaces_sim.transport.population import RESAMPLE_STEP, resample
from soundspaces_sim.transport.state import Job, Scratch, Tables, Walk
from soundspaces_sim.transport.surface import DIFFUSE, MIRROR, choose_hero, choose_lobe, weigh
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, absorb_air, harmonics
from soundspaces_sim.transport.techniques.hits import pass_detectors


@kernel
def emit(key, index):
    """First direction of walk `index`: stratified within its batch.

    Every batch is a randomly shifted low-discrepancy set of its own, so batches are independent.
    """
    batch = index % BATCHES
    batch_key = combine(key, 2 * batch + 1)
    u, v = stratified_pair(index // BATCHES, hashed_uniform(batch_key, 1), hashed_uniform(batch_key, 2))
    return sample_sphere(u, v)


@kernel
def scatter(lobe, dx, dy, dz, nx, ny, nz, u, v):
    """New direction after the chosen lobe."""
    if lobe == DIFFUSE:
        return sample_cosine(nx, ny, nz, u, v)
    if lobe == MIRROR:
        return reflect(dx, dy, dz, nx, ny, nz)
    return dx, dy, dz


@kernel
def _store_vertex(vertices, owner, index, x, normal, cos_in, length, state, material, events, beta):
    slot = vertices.count[owner, index]
    row = vertices.state[owner, index, slot]
    row[rec.X], row[rec.Y], row[rec.Z] = x
    row[rec.NX], row[rec.NY], row[rec.NZ] = normal
    row[rec.COS_IN], row[rec.LENGTH] = cos_in, length
    row[rec.D_VCM], row[rec.A], row[rec.B] = state
    row[rec.MATERIAL], row[rec.EVENTS] = material, events
    vertices.beta[owner, index, slot, :] = beta
    vertices.count[owner, index] = slot + 1


@kernel
def _store_half(halves, job, owner, index, patch, length, previous, beta):
    slot = halves.count[owner]
    halves.count[owner] = slot + 1
    if slot >= halves.patch.shape[1]:
        return  # the caller sees the count and starts again with more room
    halves.patch[owner, slot] = patch
    halves.length[owner, slot] = length
    halves.previous[owner, slot] = previous
    halves.walk[owner, slot] = index
    row = halves.beta[owner, slot]
    row[:] = beta
    absorb_air(row, job.air, job.settings.air_step, length)


@kernel
def _start_walks(walks, surfaces, job, key, batch):
    """Fill the slots of a batch with its walks, all at their point."""
    walks.beta[:] = 1.0
    walks.mixture[:] = 1.0
    for i in range(len(walks.alive)):
        index = i * BATCHES + batch
        walks.index[i] = index
        walks.stream[i] = combine(key, 2 * index)
        # Independent from walk to walk, since joins multiply the weights of two.
        walks.hero[i] = choose_hero(surfaces, hashed_uniform(walks.stream[i], 1))
        dx, dy, dz = emit(key, index)
        harmonics(dx, dy, dz, walks.first[i])
        state = walks.state[i]
        state[:] = 0.0
        state[rec.DX], state[rec.DY], state[rec.DZ] = dx, dy, dz
        state[rec.W_VCM], state[rec.W_A], state[rec.W_B] = mis.start(job.settings.kappa)
        state[rec.PREVIOUS] = -1.0
        walks.scattered[i] = False
        walks.alive[i] = True
        walks.retired[i] = False


@kernel
def advance(
    geometry, surfaces, patches, job, point, owner, walks, i, limit, segment, vertices, halves, scratch,
    out,
):  # fmt: skip
    """Let walk `i` bounce until it is `limit` metres long or ends; returns the segment counter."""
    settings = job.settings
    index = walks.index[i]
    state, beta, mixture = walks.state[i], walks.beta[i], walks.mixture[i]
    stream, hero = walks.stream[i], walks.hero[i]
    first = walks.first[i]
    joined = index < settings.joined
    ox, oy, oz = point[0] + state[rec.OX], point[1] + state[rec.OY], point[2] + state[rec.OZ]
    dx, dy, dz = state[rec.DX], state[rec.DY], state[rec.DZ]
    nx, ny, nz = state[rec.WNX], state[rec.WNY], state[rec.WNZ]
    d_vcm, a, b = state[rec.W_VCM], state[rec.W_A], state[rec.W_B]
    length = state[rec.W_LENGTH]
    p_diffuse = state[rec.P_DIFFUSE]  # of the last bounce, 0 after a delta lobe
    events = int(state[rec.W_EVENTS])
    share = 1.0 / settings.walks
    scattered = walks.scattered[i]  # until then `specular` makes its paths
    previous = state[rec.PREVIOUS]  # length at the last event on a patch, -1 before the first
    alive = True
    while length < limit:
        if previous > settings.merge_length and length > settings.late_length:
            alive, walks.retired[i] = False, True
            break
        longest = settings.late_length if previous >= 0.0 else math.inf
        remaining = settings.max_length - length
        t, triangle = cast(geometry, ox, oy, oz, dx, dy, dz, remaining)
        if scattered and length <= longest:
            harmonics(-dx, -dy, -dz, scratch.arrival)
            walk = Walk(
                stream, segment, index % BATCHES, events, length, p_diffuse, longest, a, b, share
            )
            leg = (ox, oy, oz, dx, dy, dz, min(t, remaining))
            pass_detectors(job, walk, leg, (nx, ny, nz), beta, first, scratch, out)
            segment += 1
        if triangle < 0 or events >= settings.max_bounces:
            alive = False
            break

        length += t
        x, y, z, nx, ny, nz = hit_point(geometry, triangle, ox, oy, oz, dx, dy, dz, t)
        cos_in = -(nx * dx + ny * dy + nz * dz)
        if cos_in < 1e-6:
            alive = False  # grazing within rounding: carries no energy
            break
        # A join across the step just made is sampled once from the point itself, else `vv` times.
        count = 1.0 if events == 0 else settings.vv
        d_vcm, a, b = mis.arrive(d_vcm, a, b, t, cos_in, count)
        events += 1
        material = geometry.material[triangle]
        nominal = surfaces.nominal_diffuse[material]
        eps = geometry.epsilon
        if joined and nominal > 0.0 and length <= settings.join_length and events <= settings.join_depth:
            _store_vertex(
                vertices, owner, index, (x + eps * nx, y + eps * ny, z + eps * nz), (nx, ny, nz),
                cos_in, length, (d_vcm, a, b), material, events, beta,
            )  # fmt: skip

        stream, u0 = uniform(stream)
        stream, u1 = uniform(stream)
        stream, u2 = uniform(stream)
        lobe = choose_lobe(surfaces, material, hero, events, u0)
        if lobe < 0 or not weigh(surfaces, material, lobe, events, beta, mixture):
            alive = False
            break
        dx, dy, dz = scatter(lobe, dx, dy, dz, nx, ny, nz, u1, u2)
        if lobe == DIFFUSE:
            cos_out = max(nx * dx + ny * dy + nz * dz, 1e-9)
            d_vcm, a, b = mis.leave_diffuse(d_vcm, a, b, nominal, cos_in, cos_out)
            p_diffuse, scattered = nominal, True
            if settings.merging:
                patch = patch_at(patches, geometry, triangle, x, y, z, nx, ny, nz)
                if patch >= 0:
                    if previous <= settings.merge_length:
                        _store_half(halves, job, owner, index, patch, length, previous, beta)
                    previous = length
        else:
            d_vcm, a, b = mis.leave_delta(a, b, cos_in)
            p_diffuse = 0.0
        side = eps if lobe <= MIRROR else -eps
        ox, oy, oz = x + side * nx, y + side * ny, z + side * nz

    state[rec.OX], state[rec.OY], state[rec.OZ] = ox - point[0], oy - point[1], oz - point[2]
    state[rec.DX], state[rec.DY], state[rec.DZ] = dx, dy, dz
    state[rec.WNX], state[rec.WNY], state[rec.WNZ] = nx, ny, nz
    state[rec.W_VCM], state[rec.W_A], state[rec.W_B] = d_vcm, a, b
    state[rec.W_LENGTH], state[rec.P_DIFFUSE] = length, p_diffuse
    state[rec.W_EVENTS], state[rec.PREVIOUS] = events, previous
    walks.scattered[i], walks.stream[i] = scattered, stream
    walks.alive[i] = alive
    return segment


@kernel
def trace_point(
    geometry, surfaces, patches, job, point, key, owner, walks, vertices, halves, scratch, out
):  # fmt: skip
    """All walks of one point, batch by batch; a batch advances together and is resampled on the way."""
    settings = job.settings
    segment = 0
    for index in range(settings.joined):
        dx, dy, dz = emit(key, index)
        harmonics(dx, dy, dz, vertices.first[owner, index])
    for batch in range(BATCHES):
        _start_walks(walks, surfaces, job, key, batch)
        limit = 0.0
        stage = 0
        while limit < settings.max_length:
            limit = min(limit + RESAMPLE_STEP, settings.max_length)
            stage += 1
            any_alive = False
            for i in range(len(walks.alive)):
                if walks.alive[i]:
                    segment = advance(
                        geometry, surfaces, patches, job, point, owner, walks, i, limit, segment,
                        vertices, halves, scratch, out,
                    )  # fmt: skip
                    any_alive |= walks.alive[i]
            if not any_alive:
                break
            resample(walks, settings, limit, hashed_uniform(combine(key, 2 * batch + 1), 2 + stage))


@kernel
def _allocate(bands, proposals, slots, groups):
    """A batch's walks and a thread's scratch."""
    walks = rec.Walks(
        np.empty(slots, np.int64), np.empty(slots, np.uint64), np.empty(slots, np.int64),
        np.empty((slots, rec.WALK_COLUMNS)), np.empty((slots, bands)), np.empty((slots, proposals)),
        np.empty((slots, CHANNELS)), np.empty(slots, np.bool_), np.empty(slots, np.bool_),
        np.empty(slots, np.bool_), np.empty(slots), np.empty(slots, np.int64),
    )  # fmt: skip
    return walks, Scratch(np.empty(bands), np.empty(CHANNELS), np.empty(groups))


@kernel(parallel=True)
def trace_points(
    geometry, surfaces, patches, settings, points, keys, own_section, detectors, early_length,
    bin_of_step, air, vertices, halves, arrive, leave, batches,
):  # fmt: skip
    """Walks of every point, deposited at every detector. One thread owns a point's rows.

    `arrive`, `leave`: (P, N, bins, 9, b), or (P, N, 0, …) where not wanted; `batches`: (P, N, …).
    """
    bands, proposals = surfaces.energy.shape[2], surfaces.proposal.shape[1]
    for i in prange(len(points)):
        walks, scratch = _allocate(
            bands, proposals, settings.walks // BATCHES, detectors.group_sphere.shape[1]
        )
        job = Job(detectors, settings, own_section[i], early_length[i], bin_of_step, air)
        out = Tables(arrive[i], leave[i], batches[i])
        point = (points[i, 0], points[i, 1], points[i, 2])
        trace_point(
            geometry, surfaces, patches, job, point, keys[i], i, walks, vertices, halves, scratch, out
        )


@kernel(parallel=True)
def first_harmonics(keys, walks):
    """(P, walks, 9) harmonics of the first direction of every walk."""
    first = np.empty((len(keys), walks, CHANNELS), np.float32)
    for i in prange(len(keys)):
        for index in range(walks):
            dx, dy, dz = emit(keys[i], index)
            harmonics(dx, dy, dz, first[i, index])
    return first


@kernel(parallel=True)
def measure_decay(geometry, surfaces, points, keys, walks, max_bounces, step, steps, air):
    """(P, steps, b) energy still under way against length: where echograms may end.

    A slow mean over walks of their weight times air transmission at every `step` metres.
    """
    bands, proposals = surfaces.energy.shape[2], surfaces.proposal.shape[1]
    decay = np.zeros((len(points), steps, bands))
    for i in prange(len(points)):
        beta, mixture = np.empty(bands), np.empty(proposals)
        for index in range(walks):
            stream = combine(keys[i], 2 * index)
            hero = choose_hero(surfaces, hashed_uniform(stream, 1))
            dx, dy, dz = emit(keys[i], index)
            ox, oy, oz = points[i]
            beta[:] = 1.0
            mixture[:] = 1.0
            length, at = 0.0, 0
            for event in range(1, max_bounces + 2):
                t, triangle = cast(geometry, ox, oy, oz, dx, dy, dz, math.inf)
                if triangle < 0:
                    break
                length += t
                while at < steps and at * step < length:
                    for b in range(bands):
                        decay[i, at, b] += beta[b] * air[at, b] / walks
                    at += 1
                x, y, z, nx, ny, nz = hit_point(geometry, triangle, ox, oy, oz, dx, dy, dz, t)
                stream, u0 = uniform(stream)
                stream, u1 = uniform(stream)
                stream, u2 = uniform(stream)
                material = geometry.material[triangle]
                lobe = choose_lobe(surfaces, material, hero, event, u0)
                if at >= steps or lobe < 0:
                    break
                if not weigh(surfaces, material, lobe, event, beta, mixture):
                    break
                dx, dy, dz = scatter(lobe, dx, dy, dz, nx, ny, nz, u1, u2)
                side = geometry.epsilon if lobe <= MIRROR else -geometry.epsilon
                ox, oy, oz = x + side * nx, y + side * ny, z + side * nz
    return decay
