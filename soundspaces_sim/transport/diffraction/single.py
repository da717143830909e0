"""Sound that bends round edges: first-order diffraction at rigid wedges, one arrival for each edge.

For a pair out of sight, a path by every edge that both ends see and whose shadow hides them from each other, by
way of the point where its legs make the same angle with the edge (Keller's cone); its energy is that of the
uniform theory (`utd`). For a pair in sight, the direct sound takes the factor |1 + p_d / p_direct|² of the edges
that it passes closely, so that levels slide through a shadow's boundary: by half a wave and more it has
gone over into 1. Walks never bend: nothing is counted twice.

Everything is computed from the end at the smaller angle about an edge to the other one, so that a pair gives the
same bits whichever end is asked.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.echogram import EDGE
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import visible
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.utd import band_weights, finite, wave_numbers, wedge
from soundspaces_sim.transport.model import air_transmission
from soundspaces_sim.transport.tile import EarlyPaths, Side, Tile, join_paths

_SPACING = 0.4  # m, between the places of an edge at which a point looks whether it sees it
_POINTS, LIT_POINTS = (
    3,
    8,
)  # per band, in the shadow, and where the diffracted wave beats with the direct one
FARTHEST = 0.5  # m, detour by an edge, or by its end, up to which lit sound minds it
PHASE = 2.0 * math.pi  # the same, times k
DOUBT, ASIDE = 1e-5, 1e-8  # rad
INSET = 0.01  # m, from an edge's end: there, it often stands on something
_LEAST = 1e-6  # of the free field's energy
_BLOCK = 32  # points that look at all edges at a time
_SLOTS = 16  # paths per pair that there is room for at first


@part(forceinline=True)
def distance(a, b):
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@part(forceinline=True)
def about(edges, e, point):
    """(z, distance, angle) of a point about edge `e`."""
    s, a, f, t = edges.start[e], edges.along[e], edges.face[e], edges.turn[e]
    vx, vy, vz = point[0] - s[0], point[1] - s[1], point[2] - s[2]
    x = vx * f[0] + vy * f[1] + vz * f[2]
    y = vx * t[0] + vy * t[1] + vz * t[2]
    angle = math.atan2(y, x)
    if angle < 0.0:
        angle += 2.0 * math.pi
    return vx * a[0] + vy * a[1] + vz * a[2], math.sqrt(x * x + y * y), angle


@part(forceinline=True)
def on_edge(edges, e, z):
    """The place at `z` on an edge, lifted off it."""
    s, a, m = edges.start[e], edges.along[e], edges.lift[e]
    return s[0] + z * a[0] + m[0], s[1] + z * a[1] + m[1], s[2] + z * a[2] + m[2]


@kernel
def _look(first, last, geometry, edges, points, seen, place):
    """Flags `seen` (N, E): some place of edge e is in sight of point i; `place` (N, E, 3): where i is about it."""
    for i in range(first, last):
        p = (points[i, 0], points[i, 1], points[i, 2])
        for e in range(len(edges.length)):
            z, r, angle = about(edges, e, p)
            if angle > math.pi * edges.wedge[e] or r < geometry.epsilon:
                continue
            place[i, e, 0], place[i, e, 1], place[i, e, 2] = z, r, angle
            count = max(int(math.ceil(edges.length[e] / _SPACING)), 2)
            for k in range(count):
                x, y, w = on_edge(edges, e, (k + 0.5) / count * edges.length[e])
                if visible(geometry, p[0], p[1], p[2], x, y, w):
                    seen[i, e] = True
                    break


class Sights(NamedTuple):
    """The edges that each point of a side sees: rows start[i]:start[i + 1] are those of point i."""

    start: np.ndarray  # (N + 1,)
    edge: np.ndarray  # (n,) ascending for a point
    place: np.ndarray  # (n, 3) of the point about the edge: z m, distance m, angle


def sights(side: Side) -> Sights:
    """What the points of a side see of the edges; it is looked up once."""
    return side.once(_look_round)


def _look_round(side: Side) -> Sights:
    model, points = side.model, side.ends.points
    edges = model.prepared.part(prepare_wedges).edges
    rows, found, places = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty((0, 3))]
    for begin in range(0, len(points), _BLOCK):
        block = points[begin : begin + _BLOCK]
        seen = np.zeros((len(block), len(edges.length)), np.bool_)
        place = np.empty((*seen.shape, 3))
        over_rows(_look, len(block), model.world.geometry, edges, block, seen, place, chunk=1)
        i, e = np.nonzero(seen)
        rows.append(begin + i)
        found.append(e)
        places.append(place[i, e])
    start = np.searchsorted(np.concatenate(rows), np.arange(len(points) + 1))
    return Sights(start, np.concatenate(found), np.concatenate(places))


@part(forceinline=True)
def in_order(s, r):
    """Two places about an edge, the one at the smaller angle first: the same whichever end is asked."""
    if s[2] != r[2]:
        first = s[2] < r[2]
    elif s[1] != r[1]:
        first = s[1] < r[1]
    else:
        first = s[0] <= r[0]
    return (s, r) if first else (r, s)


@part(forceinline=True)
def doubt_at(edges, e, s, r):
    """Angle within which rays do not tell light from shadow: they do it no better than edges are lifted, rad."""
    m = edges.lift[e]
    return DOUBT + math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]) * (1.0 / s[1] + 1.0 / r[1])


class Spectrum(NamedTuple):
    """Wave numbers of each band and the weights of their mean."""

    k: np.ndarray  # (b, g) 1/m
    weight: np.ndarray  # (g,)
    lit_k: np.ndarray  # (b, h)
    lit_weight: np.ndarray  # (h,)


class Bend(NamedTuple):
    """A path round an edge. Lengths in m; `detour` of the ends' paths over the apex's."""

    wedge: float
    ts: float
    tr: float
    ds: float
    dr: float
    sin_beta: float
    apex: float
    length: float  # of the edge
    low: float
    high: float
    share: float  # 1 at an apex on the edge, down to 0 as it goes off


@part
def bend_at(n, length, zs, rs, ts, zr, rr, tr):
    """The path from (zs, rs, ts) to (zr, rr, tr) about an edge."""
    total = math.sqrt((rs + rr) ** 2 + (zr - zs) ** 2)
    sin_beta = (rs + rr) / total
    apex = zs + (zr - zs) * (rs / (rs + rr))
    low = math.sqrt(rs * rs + zs * zs) + math.sqrt(rr * rr + zr * zr) - total
    xs, xr = length - zs, length - zr
    high = math.sqrt(rs * rs + xs * xs) + math.sqrt(rr * rr + xr * xr) - total
    low, high = max(low, 0.0), max(high, 0.0)
    share = 1.0
    if apex < 0.0 or apex > length:
        share = fade(min(low, high) / FARTHEST)
    return Bend(n, ts, tr, rs / sin_beta, rr / sin_beta, sin_beta, apex, length, low, high, share)


@part(forceinline=True)
def fade(x):
    """From 1 at 0, smoothly to 0 at 1."""
    return math.cos(0.5 * math.pi * x) ** 2 if x < 1.0 else 0.0


@part
def shade(bend, spectrum, energy):
    """Energies (b,) that a bend brings into the shadow, J/m² for 1 J, without air; the largest."""
    most = 0.0
    for b in range(len(energy)):
        mean = 0.0
        for g in range(len(spectrum.weight)):
            k = spectrum.k[b, g]
            near, far = wedge(bend.wedge, bend.ts, bend.tr, bend.ds, bend.dr, bend.sin_beta, k)
            p = (near + far) * finite(k, bend.apex, bend.length, bend.low, bend.high)
            mean += spectrum.weight[g] * (p.real * p.real + p.imag * p.imag)
        energy[b] = mean * INV_4PI * bend.share
        most = max(most, energy[b])
    return most


@part(forceinline=True)
def nearness(detour, k):
    """1 where lit sound passes an edge closely, down to 0 at a wavelength or half a metre of detour."""
    return fade(2.0 * max(detour / min(FARTHEST, PHASE / k) - 0.5, 0.0))


@part(forceinline=True)
def share_of_far(bend):
    """Part of the mirror image's term that goes with the direct sound: 1 at the shadow's boundary, 0 at the
    reflection's and beyond; the rest goes with the reflection."""
    lit = math.pi - (bend.tr - bend.ts)
    mirrored = 2.0 * min(bend.ts, math.pi * bend.wedge - bend.tr)
    return fade(max(lit, 0.0) / mirrored) if lit < mirrored else 0.0


@part
def beat(bend, spectrum, straight, beats, weights):
    """Add an edge's p_d / p_direct to the weighted sums `beats` (b, h) of the edges, and to `weights`.

    The mean of several edges by the fourth power of their strength: the nearest decides, and the two edges of
    a slab count as the one that they are to sound. The mirror image's term belongs to the reflection and
    fades before its own boundary.
    """
    detour = bend.ds + bend.dr - straight
    with_far = share_of_far(bend)
    for b in range(beats.shape[0]):
        for g in range(beats.shape[1]):
            k = spectrum.lit_k[b, g]
            near_by = nearness(detour, k)
            if near_by <= 0.0:
                continue
            near, far = wedge(bend.wedge, bend.ts, bend.tr, bend.ds, bend.dr, bend.sin_beta, k)
            p = (near + with_far * far) * finite(k, bend.apex, bend.length, bend.low, bend.high)
            scale = near_by * math.sqrt(bend.share) * straight
            r = p * complex(scale * math.cos(k * detour), -scale * math.sin(k * detour))
            strength = (r.real * r.real + r.imag * r.imag) ** 2
            beats[b, g] += strength * r
            weights[b, g] += strength


@part
def in_view(geometry, edges, e, bend, p, q):
    """(Whether both ends see the place where the path bends, that place)."""
    inset = min(INSET, 0.25 * bend.length)
    at = on_edge(edges, e, min(max(bend.apex, inset), bend.length - inset))
    ok = visible(geometry, p[0], p[1], p[2], at[0], at[1], at[2])
    return ok and visible(geometry, q[0], q[1], q[2], at[0], at[1], at[2]), at


@part(forceinline=True)
def next_common(edges, own, end, others, other, stop):
    """Rows at or after `own`, `other` of two ascending lists that hold the same edge; the first is `end`, or the
    second `stop`, if there is none."""
    while own < end and other < stop and edges[own] != others[other]:
        if edges[own] < others[other]:
            own += 1
        else:
            other += 1
    return own, other


@kernel
def _bend_paths(
    first, last, geometry, edges, spectrum, p, p_edge, p_place, points, partners, q_start, q_edge, q_place,
    walls, direct, rows, counts, scratch,
):  # fmt: skip
    """Paths from one point to several by the edges that both see.

    Fills `rows` (partners, slots, 8 + b) of pairs with `walls` between: edge, length, direction at q, at p, energy
    per band; `counts` (partners,) says how many there are, room or none. Multiplies `direct` (N, b) of the others.
    """
    energy, beats, weights = scratch
    for k in range(first, last):
        j = partners[k]
        q = (points[j, 0], points[j, 1], points[j, 2])
        straight = distance(p, q)
        lit = walls[j] == 0
        counts[k] = 0
        if straight <= geometry.epsilon:
            continue
        beats[:, :], weights[:, :] = 0.0, 0.0
        touched = False
        own, other, end = -1, q_start[j] - 1, q_start[j + 1]
        while True:
            own, other = next_common(p_edge, own + 1, len(p_edge), q_edge, other + 1, end)
            if own >= len(p_edge) or other >= end:
                break
            e, s, r = p_edge[own], p_place[own], q_place[other]
            s, r = in_order(s, r)
            doubt = doubt_at(edges, e, s, r)
            depth = r[2] - s[2] - math.pi
            if (depth > doubt) if lit else (depth < -doubt):
                continue
            side = (
                math.pi - ASIDE if lit else math.pi + ASIDE
            )  # at the boundary the field's two parts jump
            angle = s[2] + (min(r[2] - s[2], side) if lit else max(r[2] - s[2], side))
            bend = bend_at(edges.wedge[e], edges.length[e], s[0], s[1], s[2], r[0], r[1], angle)
            if bend.share <= 0.0 or (lit and bend.ds + bend.dr - straight > FARTHEST):
                continue
            ok, at = in_view(geometry, edges, e, bend, p, q)
            if not ok:
                continue
            if lit:
                beat(bend, spectrum, straight, beats, weights)
                touched = True
                continue
            total = bend.ds + bend.dr
            if shade(bend, spectrum, energy) < _LEAST * INV_4PI / (total * total):
                continue
            if counts[k] < rows.shape[1]:
                write(rows[k, counts[k]], e, at, p, q, energy)
            counts[k] += 1
        if touched:
            weaken_by(direct[j], beats, weights, spectrum.lit_weight)


@part
def write(row, e, at, p, q, energy):
    """A path as a row of `_bend_paths`."""
    to_q = math.sqrt((at[0] - q[0]) ** 2 + (at[1] - q[1]) ** 2 + (at[2] - q[2]) ** 2)
    to_p = math.sqrt((at[0] - p[0]) ** 2 + (at[1] - p[1]) ** 2 + (at[2] - p[2]) ** 2)
    row[0], row[1] = e, to_p + to_q
    for axis in range(3):
        row[2 + axis] = (at[axis] - q[axis]) / to_q
        row[5 + axis] = (at[axis] - p[axis]) / to_p
    for b in range(len(energy)):
        row[8 + b] = energy[b]


@part
def weaken_by(energy, beats, weights, shares):
    """Multiply `energy` (b,) by |1 + mean of the beats|²."""
    for b in range(len(energy)):
        mean = 0.0
        for g in range(len(shares)):
            if weights[b, g] > 0.0:
                beats[b, g] /= weights[b, g]
            x, y = 1.0 + beats[b, g].real, beats[b, g].imag
            mean += shares[g] * (x * x + y * y)
        energy[b] *= mean


def make_spectrum(config: SimulationConfig) -> Spectrum:
    """The wave numbers of a config's bands."""
    return Spectrum(
        wave_numbers(config.bands, _POINTS, config.c), band_weights(_POINTS),
        wave_numbers(config.bands, LIT_POINTS, config.c), band_weights(LIT_POINTS),
    )  # fmt: skip


def connect(tile: Tile) -> EarlyPaths | None:
    """Paths by one edge of every pair, and what edges take from the direct sound."""
    model, a, b = tile.model, tile.a.ends, tile.b.ends
    edges = model.prepared.part(prepare_wedges).edges
    if len(edges.length) == 0:
        return None
    geometry, bands = model.world.geometry, model.world.air.shape[1]
    spectrum = make_spectrum(model.config)
    of_a = sights(tile.a)
    of_b = of_a if tile.same else sights(tile.b)
    n_a, n_b = len(a.points), len(b.points)
    parts: list[tuple[np.ndarray, np.ndarray]] = []

    def scratch() -> tuple[np.ndarray, ...]:
        shape = bands, LIT_POINTS
        return np.empty(bands), np.empty(shape, np.complex128), np.empty(shape)

    slots = _SLOTS
    for i in range(n_a):
        partners = np.arange(i if tile.same else 0, n_b)
        own, p = slice(of_a.start[i], of_a.start[i + 1]), a.points[i]
        while True:
            rows = np.empty((len(partners), slots, 8 + bands))
            counts = np.zeros(len(partners), np.int64)
            direct = tile.direct[i].copy()
            over_rows(
                _bend_paths, len(partners), geometry, edges, spectrum, (p[0], p[1], p[2]), of_a.edge[own],
                of_a.place[own], b.points, partners, of_b.start, of_b.edge, of_b.place, tile.walls[i],
                direct, rows, counts, scratch=scratch,
            )  # fmt: skip
            if counts.max(initial=0) <= slots:
                break
            slots = roomier(counts)
        tile.direct[i] = direct
        if tile.same:
            tile.direct[i + 1 :, i] = direct[i + 1 :]
        found = np.arange(slots) < counts[:, None]
        parts.append((i * n_b + partners[np.nonzero(found)[0]], rows[found]))
    pair = np.concatenate([k for k, _ in parts] or [np.empty(0, np.int64)])
    rows = np.concatenate([r for _, r in parts] or [np.empty((0, 8 + bands))])
    return both_ways(tile, as_paths(tile, pair, EDGE, rows[:, :1], rows[:, 1:]))


def roomier(counts: np.ndarray) -> int:
    """Paths per pair to make room for, after some had as many as `counts`: some more, for the next point's."""
    most = int(counts.max())
    return most + most // 2


def as_paths(
    tile: Tile, pair: np.ndarray, kind: int | np.ndarray, met: np.ndarray, columns: np.ndarray,
    plane: np.ndarray | int = -1,
) -> EarlyPaths:  # fmt: skip
    """Paths by one or two edges, `met` (n, 1 or 2), and perhaps a mirror; `columns`: length, direction at b, at a,
    energy per band without air."""
    energy = columns[:, 7:] * air_transmission(tile.model.config, columns[:, 0])
    edge = np.full((len(met), 2), -1)
    edge[:, : met.shape[1]] = met
    planes = np.full((len(met), 2), -1)
    planes[:, 0] = plane
    return EarlyPaths(
        pair,
        columns[:, 0],
        columns[:, 1:4],
        columns[:, 4:7],
        energy,
        planes,
        np.full(len(met), kind),
        edge,
    )


def both_ways(tile: Tile, early: EarlyPaths) -> EarlyPaths:
    """The other direction of every pair of two different points as well, in a tile of one side."""
    if not tile.same:
        return early
    n = len(tile.a.ends.points)
    back = early.reversed(n, n)
    other = back.pair // n != back.pair % n
    return join_paths([early, back.rows(other)], tile.model.world.air.shape[1])
