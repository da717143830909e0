"""Sound that bends round two edges: round a wall as thick as it is, over one obstacle and then another.

For a pair out of sight, a path by every two edges that see each other, of which one sees one end and the other
the other, and that is bent into the shadow at both: the string that one would pull tight round them. Of the
two coefficients the one that turns farther takes the whole path for its distances and the other its own legs
(Pierce 1974); along a common face the amplitude is halved, for the face's image is in both. Thin walls are thin to
sound: the thinner a wall is against the wave, the more its two edges are taken as the one edge of a screen. Rigid
wedges, as `edges`.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.echogram import TWO_EDGES
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import visible
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.single import (
    Sights,
    about,
    as_paths,
    both_ways,
    distance,
    make_spectrum,
    on_edge,
    roomier,
    sights,
)
from soundspaces_sim.transport.diffraction.utd import finite, wedge
from soundspaces_sim.transport.diffraction.wedges import Links
from soundspaces_sim.transport.tile import EarlyPaths, Tile

_STEPS = 12  # of Newton's method; it ends sooner
_LEAST = 1e-6  # of the free field's energy
_ON_FACE = 0.01  # rad
_THIN = 2.0  # wave number times thickness at which a wall's edges are half one, half two
_SLOTS = 16  # paths per pair that there is room for at first


@part
def _tight(edges, e, f, p, q):
    """(z on edge e, z on edge f) of the shortest way from p to q by way of the lines of both; Newton's method on a
    convex function."""
    s, a, t, b = edges.start[e], edges.along[e], edges.start[f], edges.along[f]
    x, y = 0.5 * edges.length[e], 0.5 * edges.length[f]
    ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    for _ in range(_STEPS):
        ux, uy, uz = s[0] + x * a[0] - p[0], s[1] + x * a[1] - p[1], s[2] + x * a[2] - p[2]
        vx, vy, vz = t[0] + y * b[0] - q[0], t[1] + y * b[1] - q[1], t[2] + y * b[2] - q[2]
        wx = t[0] + y * b[0] - s[0] - x * a[0]
        wy = t[1] + y * b[1] - s[1] - x * a[1]
        wz = t[2] + y * b[2] - s[2] - x * a[2]
        u, v = math.sqrt(ux * ux + uy * uy + uz * uz), math.sqrt(vx * vx + vy * vy + vz * vz)
        w = math.sqrt(wx * wx + wy * wy + wz * wz)
        if u < 1e-6 or v < 1e-6 or w < 1e-6:
            return math.nan, math.nan
        ua, vb = (ux * a[0] + uy * a[1] + uz * a[2]) / u, (vx * b[0] + vy * b[1] + vz * b[2]) / v
        wa, wb = (wx * a[0] + wy * a[1] + wz * a[2]) / w, (wx * b[0] + wy * b[1] + wz * b[2]) / w
        gx, gy = ua - wa, vb + wb
        xx, yy = (1.0 - ua * ua) / u + (1.0 - wa * wa) / w, (1.0 - vb * vb) / v + (1.0 - wb * wb) / w
        xy = -(ab - wa * wb) / w
        det = xx * yy - xy * xy
        if det < 1e-12:
            return math.nan, math.nan
        dx, dy = (gx * yy - gy * xy) / det, (gy * xx - gx * xy) / det
        far = max(abs(dx), abs(dy))
        scale = min(1.0, 2.0 / far) if far > 0.0 else 1.0  # m, at most, in a step
        x, y = x - scale * dx, y - scale * dy
        if far < 1e-7:
            break
    return x, y


@part(forceinline=True)
def _place(edges, e, z):
    s, a = edges.start[e], edges.along[e]
    return s[0] + z * a[0], s[1] + z * a[1], s[2] + z * a[2]


@part(forceinline=True)
def _ordered(one, other):
    return (one, other) if one < other else (other, one)


@part
def _solve(geometry, edges, spectrum, e, f, p, q, row, energy):
    """The path from p by edges e and f to q: whether there is one; if so `row`: edges, length, direction at q,
    at p, energy per band."""
    x, y = _tight(edges, e, f, p, q)
    le, lf = edges.length[e], edges.length[f]
    if not (0.0 < x < le and 0.0 < y < lf):
        return False
    at_e, at_f = _place(edges, e, x), _place(edges, f, y)
    d1, d12, d2 = distance(p, at_e), distance(at_e, at_f), distance(at_f, q)
    total = d1 + d12 + d2
    _, re, te = about(edges, e, p)
    _, ref, tef = about(edges, e, at_f)
    _, rf, tf = about(edges, f, q)
    _, rfe, tfe = about(edges, f, at_e)
    if min(re, ref, rf, rfe) < 1e-6:
        return False
    full_e, full_f = math.pi * edges.wedge[e], math.pi * edges.wedge[f]
    # a place on a face is at its angle, whichever side of it rounding puts it
    tef, tfe = _snap(tef, full_e), _snap(tfe, full_f)
    if max(te, tef) > full_e or max(tf, tfe) > full_f:
        return False
    turn_e, turn_f = abs(tef - te) - math.pi, abs(tf - tfe) - math.pi
    if turn_e <= 0.0 or turn_f <= 0.0:
        return False
    lifted_e, lifted_f = on_edge(edges, e, x), on_edge(edges, f, y)
    if not (
        visible(geometry, p[0], p[1], p[2], lifted_e[0], lifted_e[1], lifted_e[2])
        and visible(geometry, q[0], q[1], q[2], lifted_f[0], lifted_f[1], lifted_f[2])
        and visible(
            geometry, lifted_e[0], lifted_e[1], lifted_e[2], lifted_f[0], lifted_f[1], lifted_f[2]
        )
    ):
        return False
    common = (tef <= 0.0 or tef >= full_e) and (tfe <= 0.0 or tfe >= full_f)
    half = 0.5 if common else 1.0
    if turn_e * re >= turn_f * rf:
        legs, scale = (d1, d12 + d2, d12, d2), half * (d12 + d2)
    else:
        legs, scale = (d1, d12, d1 + d12, d2), half * (d1 + d12)
    ends = (
        _detour(edges, e, 0.0, p, at_f, d1 + d12), _detour(edges, e, le, p, at_f, d1 + d12),
        _detour(edges, f, 0.0, at_e, q, d12 + d2), _detour(edges, f, lf, at_e, q, d12 + d2),
    )  # fmt: skip
    (s1, r1), (s2, r2) = _ordered(te, tef), _ordered(tfe, tf)
    # as one edge: a wedge of both turns, each end at its angle from its own outer face
    outer_s, outer_r = (te if tef > te else full_e - te), (tf if tfe > tf else full_f - tf)
    one_wedge = edges.wedge[e] + edges.wedge[f] - 1.0
    as_one = common and _parallel(edges, e, f) and one_wedge <= 2.0 + 1e-9
    most = 0.0
    for b in range(len(energy)):
        mean = 0.0
        for g in range(len(spectrum.weight)):
            k = spectrum.k[b, g]
            one, image = wedge(edges.wedge[e], s1, r1, legs[0], legs[1], re / d1, k)
            two, mirror = wedge(edges.wedge[f], s2, r2, legs[2], legs[3], rf / d2, k)
            value = (one + image) * (two + mirror) * scale
            size = abs(value)
            if as_one:
                one, image = wedge(
                    one_wedge,
                    outer_s,
                    math.pi * one_wedge - outer_r,
                    d1 + 0.5 * d12,
                    d2 + 0.5 * d12,
                    re / d1,
                    k,
                )
                thick = k * d12 / (_THIN + k * d12)
                size = thick * size + (1.0 - thick) * abs(one + image)
            size *= abs(finite(k, x, le, ends[0], ends[1]) * finite(k, y, lf, ends[2], ends[3]))
            mean += spectrum.weight[g] * size * size
        energy[b] = mean * INV_4PI
        most = max(most, energy[b])
    if most < _LEAST * INV_4PI / (total * total):
        return False
    row[0], row[1], row[2] = e, f, total
    for axis in range(3):
        row[3 + axis] = (at_f[axis] - q[axis]) / d2
        row[6 + axis] = (at_e[axis] - p[axis]) / d1
    for b in range(len(energy)):
        row[9 + b] = energy[b]
    return True


@part(forceinline=True)
def _parallel(edges, e, f):
    a, b = edges.along[e], edges.along[f]
    return abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) > 0.999


@part(forceinline=True)
def _snap(angle, full):
    if angle < _ON_FACE or angle > 2.0 * math.pi - _ON_FACE:
        return 0.0 if full < 2.0 * math.pi - _ON_FACE or angle < _ON_FACE else full
    return full if abs(angle - full) < _ON_FACE else angle


@part(forceinline=True)
def _detour(edges, e, z, p, q, shortest):
    end = _place(edges, e, z)
    return max(distance(p, end) + distance(end, q) - shortest, 0.0)


class _Turns(NamedTuple):
    """How sound goes on from edges that points see: rows start[i]:start[i + 1] of point i are those of `Links`,
    from an edge that it sees to another one, on whose way sound bends into the first one's shadow."""

    start: np.ndarray  # (N + 1,)
    link: np.ndarray  # (n,)


@kernel
def _find_turns(first, last, links, start, edge, angle, count, begin, link):
    """Counts (N,) rows of `_Turns` of points whose sights are `start`, `edge`, `angle`; fills `link` from `begin`
    (N,) on unless it is empty."""
    for i in range(first, last):
        found = 0
        for row in range(start[i], start[i + 1]):
            e = edge[row]
            for other in range(links.start[e], links.start[e + 1]):
                there = links.there[other]
                if max(there[1] - angle[row], angle[row] - there[0]) > math.pi:
                    if len(link) > 0:
                        link[begin[i] + found] = other
                    found += 1
        count[i] = found


def _turns(links: Links, of: Sights) -> _Turns:
    points, angle = len(of.start) - 1, np.ascontiguousarray(of.place[:, 2])
    count, start = np.zeros(points, np.int64), np.zeros(points + 1, np.int64)

    def find(link: np.ndarray) -> np.ndarray:
        over_rows(_find_turns, points, links, of.start, of.edge, angle, count, start, link)
        return link

    find(np.empty(0, np.int64))  # how many
    np.cumsum(count, out=start[1:])
    link = find(np.empty(start[-1], np.int64))
    return _Turns(start, link)


@kernel
def _double_paths(
    first, last, geometry, edges, links, spectrum, p, meets, points, partners, q_start, q_link, swap, rows,
    counts, scratch,
):  # fmt: skip
    """Fill `rows` (partners, slots, 9 + b), see `_solve`; `counts` (partners,) says how many there are, room or
    none.

    `meets` flags links, from an edge that the partner sees to one that p sees, by which sound from p bends;
    `swap`: solve from the partner's side.
    """
    energy, spare = scratch
    for k in range(first, last):
        j = partners[k]
        q = (points[j, 0], points[j, 1], points[j, 2])
        counts[k] = 0
        if distance(p, q) <= geometry.epsilon:
            continue
        for n in range(q_start[j], q_start[j + 1]):
            link = q_link[n]
            if not meets[link]:
                continue
            e, f = links.edge[link], links.edge[links.twin[link]]
            row = rows[k, counts[k]] if counts[k] < rows.shape[1] else spare
            if swap[k]:
                found = _solve(geometry, edges, spectrum, f, e, q, p, row, energy)
                if found:
                    row[0], row[1] = e, f
                    for axis in range(3):
                        row[3 + axis], row[6 + axis] = row[6 + axis], row[3 + axis]
            else:
                found = _solve(geometry, edges, spectrum, e, f, p, q, row, energy)
            if found:
                counts[k] += 1


def connect(tile: Tile) -> EarlyPaths | None:
    """Paths by two edges of every pair out of sight."""
    model, a, b = tile.model, tile.a.ends, tile.b.ends
    wedges = model.prepared.part(prepare_wedges)
    edges = wedges.edges
    if len(edges.length) < 2:
        return None
    spectrum, bands = make_spectrum(model.config), model.world.air.shape[1]
    links = wedges.links
    of_a = _turns(links, sights(tile.a))
    of_b = of_a if tile.same else _turns(links, sights(tile.b))
    n_b, meets = len(b.points), np.zeros(len(links.edge), np.bool_)
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    slots = _SLOTS
    for i, p in enumerate(a.points):
        partners = np.arange(i if tile.same else 0, n_b)
        partners = partners[tile.walls[i, partners] > 0]
        own = links.twin[of_a.link[of_a.start[i] : of_a.start[i + 1]]]
        meets[own] = True
        while len(partners):
            rows = np.empty((len(partners), slots, 9 + bands))
            counts = np.zeros(len(partners), np.int64)
            over_rows(
                _double_paths, len(partners), model.world.geometry, edges, links, spectrum, (p[0], p[1], p[2]),
                meets, b.points, partners, of_b.start, of_b.link, a.keys[i] > b.keys[partners], rows, counts,
                scratch=lambda: (np.empty(bands), np.empty(9 + bands)),
            )  # fmt: skip
            if counts.max() <= slots:
                found = np.arange(slots) < counts[:, None]
                parts.append((i * n_b + partners[np.nonzero(found)[0]], rows[found]))
                break
            slots = roomier(counts)
        meets[own] = False
    pair = np.concatenate([k for k, _ in parts] or [np.empty(0, np.int64)])
    rows = np.concatenate([r for _, r in parts] or [np.empty((0, 9 + bands))])
    return both_ways(tile, as_paths(tile, pair, TWO_EDGES, rows[:, :2], rows[:, 2:]))
