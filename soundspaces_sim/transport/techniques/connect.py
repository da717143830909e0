"""Where two walks are joined: a vertex to the other point, and a vertex to a vertex."""

import math

import numpy as np
from numba import prange

from soundspaces_sim.base.kernel import kernel
from soundspaces_sim.base.rng import combine, uniform
from soundspaces_sim.rays.directions import INV_PI
from soundspaces_sim.rays.geometry import visible
from soundspaces_sim.transport import mis
from soundspaces_sim.transport import state as rec
from soundspaces_sim.transport.detector import level_of
from soundspaces_sim.transport.surface import DIFFUSE
from soundspaces_sim.transport.tables import (
    BATCHES,
    CHANNELS,
    absorb_air,
    deposit,
    deposit_batch,
    harmonics,
    time_bin,
)


@kernel
def _deposit_both(shared, pair, length, batch, at_p, at_q, energy):
    """Air absorption, then q's row of p -> q (arrival at q) and p's row of q -> p (arrival at p)."""
    bin_index = time_bin(length, shared.bin_of_step, shared.settings.step)
    if bin_index < 0:
        return
    absorb_air(energy, shared.air, shared.settings.air_step, length)
    deposit_batch(pair.batches, batch, 1 if length > pair.early_length else 0, energy)
    if pair.to_q.shape[0] > 0:
        deposit(pair.to_q, bin_index, at_q, energy)
    if pair.to_p.shape[0] > 0:
        deposit(pair.to_p, bin_index, at_p, energy)


@kernel
def join_vertex_to_end(shared, pair, x, beta, end, eta_own, eta_end, batch, first, at_end, forward):
    """Vertex `x` of a walk to the other walk's point `end`; `forward`: the walk is p's."""
    settings, surfaces = shared.settings, shared.surfaces
    vx, vy, vz = end[0] - x[rec.X], end[1] - x[rec.Y], end[2] - x[rec.Z]
    cos_out_r = vx * x[rec.NX] + vy * x[rec.NY] + vz * x[rec.NZ]
    if cos_out_r <= 0.0:
        return
    r2 = vx * vx + vy * vy + vz * vz
    r = math.sqrt(r2)
    length = x[rec.LENGTH] + r
    if length > settings.join_length:
        return
    if not visible(shared.geometry, x[rec.X], x[rec.Y], x[rec.Z], end[0], end[1], end[2]):
        return
    cos_out = cos_out_r / r
    material = int(x[rec.MATERIAL])
    level = level_of(shared.levels, length)
    weight = mis.weight_vertex_to_end(
        x[rec.D_VCM], x[rec.A], x[rec.B], surfaces.nominal_diffuse[material], x[rec.COS_IN],
        cos_out, r2, eta_own[level], eta_end[level], settings.kappa,
    )  # fmt: skip
    scale = weight * INV_PI * cos_out / (r2 * settings.joined)
    for band in range(len(beta)):
        shared.energy[band] = beta[band] * surfaces.energy[material, DIFFUSE, band] * scale
    harmonics(-vx / r, -vy / r, -vz / r, at_end)
    if forward:
        _deposit_both(shared, pair, length, batch, first, at_end, shared.energy)
    else:
        _deposit_both(shared, pair, length, batch, at_end, first, shared.energy)


@kernel
def join_vertex_to_vertex(shared, pair, x, y, beta_x, beta_y, eta_p, eta_q, factor, batch, at_p, at_q):
    """Vertex `x` of p's walk to vertex `y` of q's walk; `factor` = vertices of y's walk / drawn."""
    settings, surfaces = shared.settings, shared.surfaces
    if x[rec.EVENTS] + y[rec.EVENTS] > settings.join_depth:
        return
    vx, vy, vz = y[rec.X] - x[rec.X], y[rec.Y] - x[rec.Y], y[rec.Z] - x[rec.Z]
    cos_x_r = vx * x[rec.NX] + vy * x[rec.NY] + vz * x[rec.NZ]
    cos_y_r = -(vx * y[rec.NX] + vy * y[rec.NY] + vz * y[rec.NZ])
    if cos_x_r <= 0.0 or cos_y_r <= 0.0:
        return
    r2 = vx * vx + vy * vy + vz * vz
    r = math.sqrt(r2)
    length = x[rec.LENGTH] + r + y[rec.LENGTH]
    if length > settings.join_length or r <= shared.geometry.epsilon:
        return
    if not visible(shared.geometry, x[rec.X], x[rec.Y], x[rec.Z], y[rec.X], y[rec.Y], y[rec.Z]):
        return
    cos_x, cos_y = cos_x_r / r, cos_y_r / r
    geometric = cos_x * cos_y / r2
    mx, my = int(x[rec.MATERIAL]), int(y[rec.MATERIAL])
    px, py = surfaces.nominal_diffuse[mx], surfaces.nominal_diffuse[my]
    level = level_of(shared.levels, length)
    term_x = mis.join_term(
        x[rec.D_VCM], x[rec.A], x[rec.B], px, x[rec.COS_IN], eta_p[level],
        py * INV_PI * geometric,
    )  # fmt: skip
    term_y = mis.join_term(
        y[rec.D_VCM], y[rec.A], y[rec.B], py, y[rec.COS_IN], eta_q[level],
        px * INV_PI * geometric,
    )  # fmt: skip
    weight = mis.weight_vertex_to_vertex(term_x, term_y, settings.vv)
    scale = weight * factor * 4.0 * INV_PI * geometric / settings.joined  # 4 pi / pi^2
    for band in range(len(beta_x)):
        shared.energy[band] = (
            scale
            * beta_x[band]
            * surfaces.energy[mx, DIFFUSE, band]
            * beta_y[band]
            * surfaces.energy[my, DIFFUSE, band]
        )
    _deposit_both(shared, pair, length, batch, at_p, at_q, shared.energy)


@kernel
def _join_pair(shared, pair, p, q, stream, at_end):
    settings = shared.settings
    for index in range(settings.joined):
        # The partner is the next walk, so that a point joined to itself still meets another walk.
        other = (index + 1) % settings.joined
        batch = index % BATCHES
        n_q = q.count[other]
        for i in range(p.count[index]):
            join_vertex_to_end(
                shared, pair, p.state[index, i], p.beta[index, i], q.point, p.section, q.section,
                batch, p.first[index], at_end, True,
            )  # fmt: skip
            if n_q == 0:
                continue
            for _ in range(settings.joins_per_vertex):
                stream, u = uniform(stream)
                j = min(int(u * n_q), n_q - 1)
                join_vertex_to_vertex(
                    shared, pair, p.state[index, i], q.state[other, j], p.beta[index, i],
                    q.beta[other, j], p.section, q.section, n_q / settings.joins_per_vertex,
                    batch, p.first[index], q.first[other],
                )  # fmt: skip
        for i in range(q.count[index]):
            join_vertex_to_end(
                shared, pair, q.state[index, i], q.beta[index, i], p.point, q.section, p.section,
                batch, q.first[index], at_end, False,
            )  # fmt: skip


@kernel
def _side(points, section, vertices, i):
    return rec.Side(
        (points[i, 0], points[i, 1], points[i, 2]), section[i], vertices.state[i],
        vertices.beta[i], vertices.count[i], vertices.first[i],
    )  # fmt: skip


@kernel(parallel=True)
def join_pairs(
    geometry, surfaces, settings, levels, bin_of_step, air, pairs,
    points_a, keys_a, section_a, vertices_a, points_b, keys_b, section_b, vertices_b,
    early_length, to_b, to_a, batches,
):  # fmt: skip
    """Join the walks of each (row of a, row of b) in `pairs`; one thread owns a pair.

    `to_b[a, b]` receives a -> b; `to_a[b, a]` receives b -> a unless it has no bins. A pair's samples do
    not depend on which of its points is called a: the one with the smaller key plays p.
    A point joined to itself is one directed pair, deposited once.
    """
    for k in prange(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        at_end = np.empty(CHANNELS)
        shared = rec.JoinShared(
            geometry, surfaces, settings, levels, bin_of_step, air, np.empty(air.shape[1])
        )
        back = to_a[j, i]
        if keys_a[i] == keys_b[j]:
            back = back[:0]
        a = _side(points_a, section_a, vertices_a, i)
        b = _side(points_b, section_b, vertices_b, j)
        if keys_a[i] <= keys_b[j]:
            pair = rec.JoinPair(to_b[i, j], back, batches[i, j], early_length[i, j])
            stream = combine(combine(keys_a[i], 1), keys_b[j])
            _join_pair(shared, pair, a, b, stream, at_end)
        else:
            pair = rec.JoinPair(back, to_b[i, j], batches[i, j], early_length[i, j])
            stream = combine(combine(keys_b[j], 1), keys_a[i])
            _join_pair(shared, pair, b, a, stream, at_end)
