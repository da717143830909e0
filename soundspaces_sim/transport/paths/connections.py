"""Where two walks are joined: a vertex to the other point, and a vertex to a vertex."""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, uniform
from soundspaces_sim.scene.rays.geometry import visible
from soundspaces_sim.transport.bsdf.surface import backward, density, scatter
from soundspaces_sim.transport.paths import mis
from soundspaces_sim.transport.paths.detector import level_of
from soundspaces_sim.transport.paths.receiver_volumes import vertices
from soundspaces_sim.transport.state import Vertices
from soundspaces_sim.transport.tables import (
    BATCHES,
    CHANNELS,
    absorb_air,
    deposit,
    deposit_batch,
    harmonics,
    time_bin,
)
from soundspaces_sim.transport.tile import Tile

_CHUNK = 32  # pairs per call


class _End(NamedTuple):
    """One point of a pair and its joined walks."""

    point: tuple[float, float, float]
    section: np.ndarray  # (LEVELS,) cross-section of its detector
    vertices: Vertices


class _Pair(NamedTuple):
    """Where one pair's joins deposit."""

    to_q: np.ndarray  # (bins, 9, b) of p -> q; no bins: not wanted
    to_p: np.ndarray  # (bins, 9, b) of q -> p
    batches: np.ndarray  # (BATCHES, windows, b)
    energy: np.ndarray  # (b,) scratch


@part
def _deposit_both(world, pair, length, batch, at_p, at_q):
    """Air absorption, then q's row of p -> q (arrival at q) and p's row of q -> p (arrival at p)."""
    bin_index = time_bin(length, world.bin_of_step, world.settings.step)
    if bin_index < 0:
        return
    energy = pair.energy
    absorb_air(energy, world.air, world.settings.air_step, length)
    deposit_batch(pair.batches, batch, world.window_of_bin[bin_index], energy)
    if pair.to_q.shape[0] > 0:
        deposit(pair.to_q, bin_index, at_q, energy)
    if pair.to_p.shape[0] > 0:
        deposit(pair.to_p, bin_index, at_p, energy)


@part
def join_vertex_to_end(world, pair, x, beta, end, eta_own, eta_end, batch, first, at_end):
    """Vertex `x` of p's walk to the other walk's point `end`."""
    geometry, surfaces, settings = world.geometry, world.surfaces, world.settings
    vx, vy, vz = end[0] - x.x, end[1] - x.y, end[2] - x.z
    cos_out_r = vx * x.nx + vy * x.ny + vz * x.nz
    if cos_out_r <= 0.0:
        return
    r2 = vx * vx + vy * vy + vz * vz
    r = math.sqrt(r2)
    length = x.length + r
    if length > settings.join_length:
        return
    if not visible(geometry, x.x, x.y, x.z, end[0], end[1], end[2]):
        return
    cos_out = cos_out_r / r
    came, normal, out = (x.ix, x.iy, x.iz), (x.nx, x.ny, x.nz), (vx / r, vy / r, vz / r)
    level = level_of(world.radii, length)
    weight = mis.weight_vertex_to_end(
        x.d_vcm, x.a, x.b, density(surfaces, x.material, came, normal, out),
        backward(surfaces, x.material, came, normal, out), cos_out, r2, eta_own[level], eta_end[level],
        settings.kappa,
    )  # fmt: skip
    scale = weight * cos_out / (r2 * settings.joined)
    for band in range(len(beta)):
        pair.energy[band] = beta[band] * scale
    scatter(surfaces, x.material, came, normal, out, pair.energy)
    harmonics(-out[0], -out[1], -out[2], at_end)
    _deposit_both(world, pair, length, batch, first, at_end)


@part
def join_vertex_to_vertex(world, pair, x, y, beta_x, beta_y, eta_p, eta_q, factor, batch, at_p, at_q):
    """Vertex `x` of p's walk to vertex `y` of q's walk; `factor` = vertices of y's walk / drawn."""
    geometry, surfaces, settings = world.geometry, world.surfaces, world.settings
    if x.events + y.events > settings.join_depth:
        return
    vx, vy, vz = y.x - x.x, y.y - x.y, y.z - x.z
    cos_x_r = vx * x.nx + vy * x.ny + vz * x.nz
    cos_y_r = -(vx * y.nx + vy * y.ny + vz * y.nz)
    if cos_x_r <= 0.0 or cos_y_r <= 0.0:
        return
    r2 = vx * vx + vy * vy + vz * vz
    r = math.sqrt(r2)
    length = x.length + r + y.length
    if length > settings.join_length or r <= geometry.epsilon:
        return
    if not visible(geometry, x.x, x.y, x.z, y.x, y.y, y.z):
        return
    cos_x, cos_y = cos_x_r / r, cos_y_r / r
    came_x, normal_x, out_x = (x.ix, x.iy, x.iz), (x.nx, x.ny, x.nz), (vx / r, vy / r, vz / r)
    came_y, normal_y = (y.ix, y.iy, y.iz), (y.nx, y.ny, y.nz)
    out_y = (-out_x[0], -out_x[1], -out_x[2])
    level = level_of(world.radii, length)
    term_x = mis.join_term(
        x.d_vcm, x.a, x.b, backward(surfaces, x.material, came_x, normal_x, out_x), eta_p[level],
        density(surfaces, y.material, came_y, normal_y, out_y) * cos_x / r2,
    )  # fmt: skip
    term_y = mis.join_term(
        y.d_vcm, y.a, y.b, backward(surfaces, y.material, came_y, normal_y, out_y), eta_q[level],
        density(surfaces, x.material, came_x, normal_x, out_x) * cos_y / r2,
    )  # fmt: skip
    weight = mis.weight_vertex_to_vertex(term_x, term_y, settings.vv)
    scale = weight * factor * 4.0 * math.pi * cos_x * cos_y / (r2 * settings.joined)
    for band in range(len(beta_x)):
        pair.energy[band] = scale * beta_x[band] * beta_y[band]
    scatter(surfaces, x.material, came_x, normal_x, out_x, pair.energy)
    scatter(surfaces, y.material, came_y, normal_y, out_y, pair.energy)
    _deposit_both(world, pair, length, batch, at_p, at_q)


@part
def _join_pair(world, pair, p, q, stream, at_end):
    settings, of_p, of_q = world.settings, p.vertices, q.vertices
    returned = _Pair(pair.to_p, pair.to_q, pair.batches, pair.energy)  # q plays p
    for index in range(settings.joined):
        # The partner is the next walk, so that a point joined to itself still meets another walk.
        other = (index + 1) % settings.joined
        batch = index % BATCHES
        n_q = of_q.count[other]
        for i in range(of_p.count[index]):
            join_vertex_to_end(
                world, pair, of_p.state[index, i], of_p.beta[index, i], q.point,
                p.section, q.section, batch, of_p.first[index], at_end,
            )  # fmt: skip
            if n_q == 0:
                continue
            for _ in range(settings.joins_per_vertex):
                stream, u = uniform(stream)
                j = min(int(u * n_q), n_q - 1)
                join_vertex_to_vertex(
                    world, pair, of_p.state[index, i], of_q.state[other, j],
                    of_p.beta[index, i], of_q.beta[other, j], p.section, q.section, n_q / settings.joins_per_vertex,
                    batch, of_p.first[index], of_q.first[other],
                )  # fmt: skip
        for i in range(of_q.count[index]):
            join_vertex_to_end(
                world, returned, of_q.state[index, i], of_q.beta[index, i], p.point,
                q.section, p.section, batch, of_q.first[index], at_end,
            )  # fmt: skip


@part
def _end(ends, vertices, i):
    return _End(
        (ends.points[i, 0], ends.points[i, 1], ends.points[i, 2]), ends.detectors.section[i],
        Vertices(vertices.state[i], vertices.beta[i], vertices.count[i], vertices.first[i]),
    )  # fmt: skip


@kernel
def _join_pairs(
    first,
    last,
    world,
    pairs,
    ends_a,
    vertices_a,
    ends_b,
    vertices_b,
    to_b,
    to_a,
    batches,
    work,
):
    """Join the walks of each (row of a, row of b) in `pairs` from `first` to `last`.

    `to_b[a, b]` receives a -> b; `to_a[b, a]` receives b -> a unless it has no bins. A pair's samples do
    not depend on which of its points is called a: the one with the smaller key plays p.
    A point joined to itself is one directed pair, deposited once.
    """
    at_end, energy = work
    for k in range(first, last):
        i, j = pairs[k, 0], pairs[k, 1]
        back = to_a[j, i]
        if ends_a.keys[i] == ends_b.keys[j]:
            back = back[:0]
        a, b = _end(ends_a, vertices_a, i), _end(ends_b, vertices_b, j)
        key_a, key_b = ends_a.keys[i], ends_b.keys[j]
        forth = to_b[i, j]
        if key_a > key_b:
            a, b, forth, back, key_a, key_b = b, a, back, forth, key_b, key_a
        pair = _Pair(forth, back, batches[i, j], energy)
        _join_pair(world, pair, a, b, combine(combine(key_a, 1), key_b), at_end)


def connect(tile: Tile) -> None:
    """Join the walks of every pair."""
    world, pairs = tile.model.world, tile.pairs
    if world.settings.join_length <= 0.0:
        return
    over_rows(
        _join_pairs, len(pairs), world, pairs, tile.a.ends, tile.a.once(vertices), tile.b.ends,
        tile.b.once(vertices),
        tile.to_b, tile.to_a, tile.batches, chunk=_CHUNK,
        scratch=lambda: (np.empty(CHANNELS), np.empty(world.air.shape[1])),
    )  # fmt: skip
