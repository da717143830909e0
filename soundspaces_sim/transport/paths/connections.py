"""Vertex connections: a vertex of one point's subpath to the other point, and to a vertex of its subpaths.

Deterministic segments between stochastic vertices, as in bidirectional path tracing (Veach 1997, chapter 10); the
fluence at a point is that of an unoccluded segment, cos / r². Weights: `mis`.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.core.numerics.vec3 import Vec3, divide, dot, negate, row, subtract
from soundspaces_sim.scene.rays.geometry import in_sight, unoccluded
from soundspaces_sim.transport.bsdf.surface import evaluate, group_count, pdf, reverse_pdf
from soundspaces_sim.transport.paths import mis
from soundspaces_sim.transport.paths.detector import level_of
from soundspaces_sim.transport.paths.path_state import incident_of, normal_of, sums_of
from soundspaces_sim.transport.paths.subpath import count_tallies
from soundspaces_sim.transport.state import TALLY, Ends, VertexRow, Vertices, World, vertices_of
from soundspaces_sim.transport.tables import (
    BATCHES,
    CHANNELS,
    absorb_air,
    deposit,
    deposit_batch,
    deposit_counts,
    harmonics,
    time_bin,
)
from soundspaces_sim.transport.tile import Sums, Tile, Walks

_CHUNK = 32  # pairs per call


class Side(NamedTuple):
    """The points of a side and the vertices of their connected subpaths."""

    ends: Ends
    vertices: Vertices


class Endpoint(NamedTuple):
    """One point of a pair and the vertices of its connected subpaths."""

    point: Vec3
    section: np.ndarray  # (LEVELS,) m², cross-section of its detector
    vertices: Vertices


class Output(NamedTuple):
    """Where the connections of all pairs of a tile deposit."""

    to_b: np.ndarray  # (A, B, bins, 9, b) of a -> b
    to_a: np.ndarray  # (B, A, bins, 9, b) of b -> a; no bins: not wanted
    batches: np.ndarray  # (A, B, BATCHES, windows, b)


class PairOutput(NamedTuple):
    """Where those of one pair p, q deposit, and working arrays."""

    to_q: np.ndarray  # (bins, 9, b) of p -> q; no bins: not wanted
    to_p: np.ndarray  # (bins, 9, b) of q -> p; likewise
    batches: np.ndarray  # (BATCHES, windows, b)
    energy: np.ndarray  # (b,) of the connection at hand
    arrival: np.ndarray  # (9,) harmonics of its direction at a point
    counts: np.ndarray  # (groups,) of its reflections
    tally: np.ndarray  # (1,) TALLY


@part(forceinline=True)
def _position(vertex: VertexRow) -> Vec3:
    return vertex.x, vertex.y, vertex.z


@part
def _deposit_both(
    world: World, out: PairOutput, length: float, batch: int, at_p: np.ndarray, at_q: np.ndarray
) -> None:
    """Air absorption, then q's row of p -> q (arrival at q) and p's row of q -> p (arrival at p)."""
    bin_index = time_bin(length, world.bin_of_step, world.settings.step)
    if bin_index < 0:
        return
    out.tally[0].deposits += 1
    energy = out.energy
    absorb_air(energy, world.air, world.settings.air_step, length)
    window = world.window_of_bin[bin_index]
    deposit_batch(out.batches, batch, window, energy)
    deposit_counts(out.batches, out.counts, world.surfaces.kept, window, energy)
    if out.to_q.shape[0] > 0:
        deposit(out.to_q, bin_index, at_q, energy)
    if out.to_p.shape[0] > 0:
        deposit(out.to_p, bin_index, at_p, energy)


@part(forceinline=True)
def _count(world: World, of: Vertices, index: int, i: int, counts: np.ndarray) -> None:
    """Add the reflections up to vertex i of subpath `index`, its own included."""
    for m in range(len(counts)):
        counts[m] += of.counts[index, i, m]
    group = world.surfaces.group[of.state[index, i].material]
    if group >= 0 and group < len(counts):
        counts[group] += np.uint16(1)


@part
def connect_vertex_to_point(
    world: World, p: Endpoint, index: int, i: int, q: Endpoint, out: PairOutput
) -> None:
    """Vertex i of p's subpath `index` to the point q."""
    geometry, surfaces, settings = world.geometry, world.surfaces, world.settings
    x, beta = p.vertices.state[index, i], p.vertices.beta[index, i]
    incident, normal = incident_of(x), normal_of(x)
    between = subtract(q.point, _position(x))
    cos_out_r = dot(between, normal)
    if cos_out_r <= 0.0:
        return
    r2 = dot(between, between)
    r = math.sqrt(r2)
    length = x.length + r
    if length > settings.connection_length:
        return
    out.tally[0].rays += 1
    if not unoccluded(geometry, _position(x), q.point):
        return
    out_x = divide(between, r)
    cos_out = cos_out_r / r
    level = level_of(world.radii, length)
    closing = mis.Closing(
        pdf(surfaces, x.material, incident, normal, out_x),
        reverse_pdf(surfaces, x.material, incident, normal, out_x),
        cos_out,
        r2,
    )
    weight = mis.weight_vertex_to_point(
        sums_of(x), closing, p.section[level], q.section[level], settings.kappa
    )
    scale = weight * cos_out / (r2 * settings.connected)
    for band in range(len(beta)):
        out.energy[band] = beta[band] * scale
    evaluate(surfaces, x.material, incident, normal, out_x, out.energy)
    out.counts[:] = 0
    _count(world, p.vertices, index, i, out.counts)
    harmonics(-out_x[0], -out_x[1], -out_x[2], out.arrival)
    _deposit_both(world, out, length, index % BATCHES, p.vertices.first[index], out.arrival)


@part
def connect_vertices(
    world: World, p: Endpoint, index: int, i: int, q: Endpoint, other: int, j: int, out: PairOutput
) -> None:
    """Vertex i of p's subpath `index` to vertex j of q's subpath `other`."""
    geometry, surfaces, settings = world.geometry, world.surfaces, world.settings
    x, y = p.vertices.state[index, i], q.vertices.state[other, j]
    if x.events + y.events > settings.connection_depth:
        return
    normal_x, normal_y = normal_of(x), normal_of(y)
    between = subtract(_position(y), _position(x))
    cos_x_r, cos_y_r = dot(between, normal_x), -dot(between, normal_y)
    if cos_x_r <= 0.0 or cos_y_r <= 0.0:
        return
    r2 = dot(between, between)
    r = math.sqrt(r2)
    length = x.length + r + y.length
    if length > settings.connection_length or r <= geometry.epsilon:
        return
    out.tally[0].rays += 1
    if not in_sight(geometry, _position(x), _position(y)):
        return
    cos_x, cos_y = cos_x_r / r, cos_y_r / r
    incident_x, incident_y = incident_of(x), incident_of(y)
    out_x = divide(between, r)
    out_y = negate(out_x)
    level = level_of(world.radii, length)
    term_x = mis.connection_term(
        sums_of(x),
        reverse_pdf(surfaces, x.material, incident_x, normal_x, out_x),
        p.section[level],
        pdf(surfaces, y.material, incident_y, normal_y, out_y) * cos_x / r2,
    )
    term_y = mis.connection_term(
        sums_of(y),
        reverse_pdf(surfaces, y.material, incident_y, normal_y, out_y),
        q.section[level],
        pdf(surfaces, x.material, incident_x, normal_x, out_x) * cos_y / r2,
    )
    weight = mis.weight_vertex_to_vertex(term_x, term_y, settings.vv)
    drawn = float(q.vertices.count[other])  # vertices for the one that is drawn
    scale = weight * drawn * 4.0 * math.pi * cos_x * cos_y / (r2 * settings.connected)
    beta_x, beta_y = p.vertices.beta[index, i], q.vertices.beta[other, j]
    for band in range(len(beta_x)):
        out.energy[band] = scale * beta_x[band] * beta_y[band]
    evaluate(surfaces, x.material, incident_x, normal_x, out_x, out.energy)
    evaluate(surfaces, y.material, incident_y, normal_y, out_y, out.energy)
    out.counts[:] = 0
    _count(world, p.vertices, index, i, out.counts)
    _count(world, q.vertices, other, j, out.counts)
    first_p, first_q = p.vertices.first[index], q.vertices.first[other]
    _deposit_both(world, out, length, index % BATCHES, first_p, first_q)


@part
def _connect_pair(world: World, out: PairOutput, p: Endpoint, q: Endpoint, key: int) -> None:
    """All connections of a pair; `key` decides which vertices are connected to which."""
    settings, of_p, of_q = world.settings, p.vertices, q.vertices
    returned = PairOutput(  # q plays p
        out.to_p, out.to_q, out.batches, out.energy, out.arrival, out.counts, out.tally
    )
    for index in range(settings.connected):
        # The partner is the next subpath, so that a point connected to itself still meets another subpath.
        other = (index + 1) % settings.connected
        n_q = of_q.count[other]
        for i in range(of_p.count[index]):
            connect_vertex_to_point(world, p, index, i, q, out)
            if n_q == 0:
                continue
            u = hashed_uniform(combine(key, index), i)
            j = min(int(u * n_q), n_q - 1)
            connect_vertices(world, p, index, i, q, other, j, out)
        for i in range(of_q.count[index]):
            connect_vertex_to_point(world, q, index, i, p, returned)


@part
def _endpoint(side: Side, i: int) -> Endpoint:
    of_point = vertices_of(side.vertices, i)
    return Endpoint(row(side.ends.points, i), side.ends.detectors.section[i], of_point)


@kernel
def _connect_pairs(
    first: int,
    last: int,
    world: World,
    pairs: np.ndarray,
    side_a: Side,
    side_b: Side,
    out: Output,
    work: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Connect the subpaths of each (row of a, row of b) in `pairs` (n, 2) from `first` to `last`.

    A pair's samples do not depend on which of its points is called a: the one with the smaller key plays p.
    A point connected to itself is one directed pair, deposited once.
    """
    energy, arrival, counts, tally = work
    for k in range(first, last):
        i, j = pairs[k, 0], pairs[k, 1]
        key_p, key_q = side_a.ends.keys[i], side_b.ends.keys[j]
        to_p = out.to_a[j, i]
        if key_p == key_q:
            to_p = to_p[:0]
        p, q, to_q = _endpoint(side_a, i), _endpoint(side_b, j), out.to_b[i, j]
        if key_p > key_q:
            p, q, to_q, to_p, key_p, key_q = q, p, to_p, to_q, key_q, key_p
        pair = PairOutput(to_q, to_p, out.batches[i, j], energy, arrival, counts, tally)
        _connect_pair(world, pair, p, q, combine(combine(key_p, 1), key_q))


def join(tile: Tile, of_a: Walks, of_b: Walks, sums: Sums) -> None:
    """Connect the subpaths of every pair."""
    world, pairs = tile.model.world, tile.pairs
    if world.settings.connection_length <= 0.0:
        return
    groups, bands = group_count(world.surfaces), world.air.shape[1]
    tallies: list[np.ndarray] = []

    def work() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        tallies.append(np.zeros(1, TALLY))
        return np.empty(bands), np.empty(CHANNELS), np.empty(groups, np.uint16), tallies[-1]

    over_rows(
        _connect_pairs,
        len(pairs),
        world,
        pairs,
        Side(tile.a.ends, of_a.vertices),
        Side(tile.b.ends, of_b.vertices),
        Output(sums.to_b, sums.to_a, sums.batches),
        chunk=_CHUNK,
        scratch=work,
    )
    count_tallies(tallies)
