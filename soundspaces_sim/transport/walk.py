"""Walks: sound is emitted here, and here it bounces.

A walk leaves its point in a uniform direction and bounces until it is absorbed, escapes, or is too
long. Sources and listeners are both omnidirectional points, so the same walk serves in both roles:
what it deposits at other points' detectors, and the vertices it leaves for joins.
"""

import math

import numpy as np
from numba import njit, prange

from soundspaces_sim.transport import mis
from soundspaces_sim.transport import records as rec
from soundspaces_sim.transport.deposit import BATCHES, CHANNELS, harmonics
from soundspaces_sim.transport.geometry import cast, hit_point
from soundspaces_sim.transport.hits import pass_detectors
from soundspaces_sim.transport.records import Job, Scratch, Tables, Walk
from soundspaces_sim.transport.rng import combine, hashed_uniform, uniform
from soundspaces_sim.transport.sampling import (
    reflect,
    sample_cosine,
    sample_sphere,
    stratified_pair,
)
from soundspaces_sim.transport.surface import DIFFUSE, MIRROR, choose_lobe, weigh

_ORDER = 2  # mirror paths of up to this order are found by transport.mirror, not by walks


@njit(cache=True)
def emit(key, index):
    """First direction of walk `index`: stratified within its batch.

    Every batch is a randomly shifted low-discrepancy set of its own, so batches are independent.
    """
    batch = index % BATCHES
    batch_key = combine(key, 2 * batch + 1)
    u, v = stratified_pair(index // BATCHES, hashed_uniform(batch_key, 1), hashed_uniform(batch_key, 2))
    return sample_sphere(u, v)


@njit(cache=True)
def choose_hero(walk_key, proposals):
    """Proposal that a walk follows: independent from walk to walk, since joins multiply two weights."""
    return min(int(hashed_uniform(walk_key, 1) * proposals), proposals - 1)


@njit(cache=True)
def scatter(lobe, dx, dy, dz, nx, ny, nz, u, v):
    """New direction after the chosen lobe."""
    if lobe == DIFFUSE:
        return sample_cosine(nx, ny, nz, u, v)
    if lobe == MIRROR:
        return reflect(dx, dy, dz, nx, ny, nz)
    return dx, dy, dz


@njit(cache=True)
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


@njit(cache=True)
def trace_walk(geometry, surfaces, job, point, key, owner, index, segment, vertices, scratch, out):
    """One walk from emission to its end; returns the updated segment counter."""
    settings = job.settings
    walk_key = combine(key, 2 * index)
    stream = walk_key
    hero = choose_hero(walk_key, len(scratch.mixture))
    dx, dy, dz = emit(key, index)
    harmonics(dx, dy, dz, scratch.first)
    scratch.beta[:] = 1.0
    scratch.mixture[:] = 1.0
    joined = index < settings.joined
    if joined:
        vertices.first[owner, index, :] = scratch.first

    ox, oy, oz = point
    nx, ny, nz = 0.0, 0.0, 0.0
    d_vcm, a, b = mis.start(settings.kappa)
    length = 0.0
    p_diffuse = 0.0  # of the last bounce, 0 after a delta lobe
    events, reflections = 0, 0
    early_mirror = True  # so far only mirrored, at planes that transport.mirror knows
    count = 1.0  # samples of a join across the next step
    while events <= settings.max_bounces:
        remaining = settings.max_length - length
        t, triangle = cast(geometry, ox, oy, oz, dx, dy, dz, remaining)
        if reflections > 0 and not (early_mirror and reflections <= _ORDER):
            harmonics(-dx, -dy, -dz, scratch.arrival)
            walk = Walk(walk_key, segment, index % BATCHES, events, length, p_diffuse, a, b)
            leg = (ox, oy, oz, dx, dy, dz, min(t, remaining))
            pass_detectors(job, walk, leg, (nx, ny, nz), scratch, out)
            segment += 1
        if triangle < 0:
            break

        length += t
        x, y, z, nx, ny, nz = hit_point(geometry, triangle, ox, oy, oz, dx, dy, dz, t)
        cos_in = -(nx * dx + ny * dy + nz * dz)
        if cos_in < 1e-6:
            break  # grazing within rounding: carries no energy
        d_vcm, a, b = mis.arrive(d_vcm, a, b, t, cos_in, count)
        events += 1
        material = geometry.material[triangle]
        nominal = surfaces.nominal_diffuse[material]
        eps = geometry.epsilon
        if joined and nominal > 0.0 and length <= settings.join_length and events <= settings.join_depth:
            _store_vertex(
                vertices, owner, index, (x + eps * nx, y + eps * ny, z + eps * nz), (nx, ny, nz),
                cos_in, length, (d_vcm, a, b), material, events, scratch.beta,
            )  # fmt: skip

        stream, u0 = uniform(stream)
        stream, u1 = uniform(stream)
        stream, u2 = uniform(stream)
        lobe = choose_lobe(surfaces.proposal, material, hero, u0)
        if lobe < 0 or not weigh(surfaces, material, lobe, scratch.beta, scratch.mixture):
            break
        dx, dy, dz = scatter(lobe, dx, dy, dz, nx, ny, nz, u1, u2)
        if lobe == DIFFUSE:
            cos_out = max(nx * dx + ny * dy + nz * dz, 1e-9)
            d_vcm, a, b = mis.leave_diffuse(d_vcm, a, b, nominal, cos_in, cos_out)
            p_diffuse, early_mirror = nominal, False
        else:
            d_vcm, a, b = mis.leave_delta(a, b, cos_in)
            p_diffuse = 0.0
            early_mirror &= lobe == MIRROR and geometry.plane[triangle] >= 0
        side = eps
        if lobe == DIFFUSE or lobe == MIRROR:
            reflections += 1
        else:
            side = -eps
        ox, oy, oz = x + side * nx, y + side * ny, z + side * nz
        count = settings.vv
    return segment


@njit(cache=True)
def trace_point(geometry, surfaces, job, point, key, owner, vertices, scratch, out):
    """All walks of one point."""
    segment = 0
    for index in range(job.settings.walks):
        segment = trace_walk(
            geometry, surfaces, job, point, key, owner, index, segment, vertices, scratch, out
        )


@njit(cache=True)
def _scratch(bands, proposals):
    return Scratch(
        np.empty(bands), np.empty(proposals), np.empty(bands),
        np.empty(CHANNELS), np.empty(CHANNELS),
    )  # fmt: skip


@njit(cache=True, parallel=True)
def trace_points(
    geometry, surfaces, settings, points, keys, own_section, detectors, early_length,
    bin_of_step, air, vertices, arrive, leave, batches,
):  # fmt: skip
    """Walks of every point, deposited at every detector. One thread owns a point's rows.

    `arrive`, `leave`: (P, N, bins, 9, b), or (P, N, 0, …) where not wanted; `batches`: (P, N, …).
    """
    bands, proposals = surfaces.energy.shape[2], surfaces.proposal.shape[1]
    for i in prange(len(points)):
        scratch = _scratch(bands, proposals)
        job = Job(detectors, settings, own_section[i], early_length[i], bin_of_step, air)
        out = Tables(arrive[i], leave[i], batches[i])
        point = (points[i, 0], points[i, 1], points[i, 2])
        trace_point(geometry, surfaces, job, point, keys[i], i, vertices, scratch, out)


@njit(cache=True, parallel=True)
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
            hero = choose_hero(stream, proposals)
            dx, dy, dz = emit(keys[i], index)
            ox, oy, oz = points[i]
            beta[:] = 1.0
            mixture[:] = 1.0
            length, at = 0.0, 0
            for _ in range(max_bounces + 1):
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
                lobe = choose_lobe(surfaces.proposal, material, hero, u0)
                if at >= steps or lobe < 0:
                    break
                if not weigh(surfaces, material, lobe, beta, mixture):
                    break
                dx, dy, dz = scatter(lobe, dx, dy, dz, nx, ny, nz, u1, u2)
                side = geometry.epsilon if lobe <= MIRROR else -geometry.epsilon
                ox, oy, oz = x + side * nx, y + side * ny, z + side * nz
    return decay
