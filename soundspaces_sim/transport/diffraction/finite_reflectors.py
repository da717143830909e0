"""The rims of mirrors: a reflection slides, and does not step, where the plate that mirrors it ends.

The edge of a plate bends sound about the reflection's boundary as it does about the shadow's: the term of the
mirror image in the coefficient (`utd.wedge`). Over the reflection by an endless plate it is r = p_d / p_mirror; a
plate between parallel edges has the field 1 + r_1 + r_2 where a ray meets it and r_1 + r_2 beside it, one with
edges along several directions the product over them: the separable Kirchhoff integral of a rectangle (Rindel 1986),
in which a plate that is small against the wave reflects nothing. The mirror path takes |field|² as a factor; beside
the plate it is an arrival of its own, by way of the nearest edge.

Edges count whose detour is short, as for the direct sound: the rest of a wall does not mind its end.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.echogram import EDGE
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import cast
from soundspaces_sim.transport.bsdf.surface import attenuate_specular
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.single import (
    ASIDE,
    FARTHEST,
    as_paths,
    bend_at,
    both_ways,
    distance,
    doubt_at,
    in_order,
    in_view,
    make_spectrum,
    nearness,
    next_common,
    roomier,
    share_of_far,
    sights,
    write,
)
from soundspaces_sim.transport.diffraction.utd import beyond, image_term
from soundspaces_sim.transport.image_source.image_source import reflections, weaken_reflections
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.tile import EarlyPaths, Tile

_ACROSS = 0.03  # m, from an edge, where it is tried whether its plane goes on
_ABOVE = 0.05  # m, from a plane, whence
_PLACES = np.array([1.0 / 6.0, 0.5, 5.0 / 6.0])
_GROUPS = 4  # directions of a plate's edges
_ALONG = math.cos(math.radians(30.0))  # edges within it are of one direction
_HEARD = 0.04  # of the reflection by a plate without end: what is less beside it is left out
_LEAST = 1e-4  # of the free field's energy
_SLOTS = 4  # paths per pair that there is room for at first


class Rims(NamedTuple):
    """Mirror planes that end at each edge: of its first face, and of its second."""

    plane: np.ndarray  # (E, 2), -1 for none
    triangle: np.ndarray  # (E, 2) of that face


@kernel
def _find_rims(first, last, geometry, edges, plane, triangle):
    """Fill rows of `Rims`: the plane of a face at most places near the edge, unless it goes on beyond."""
    for e in range(first, last):
        s, a, f, t, m = edges.start[e], edges.along[e], edges.face[e], edges.turn[e], edges.lift[e]
        full = math.pi * edges.wedge[e]
        for side in range(2):
            plane[e, side] = triangle[e, side] = -1
            c, d = (1.0, 0.0) if side == 0 else (math.cos(full), math.sin(full))
            ux, uy, uz = c * f[0] + d * t[0], c * f[1] + d * t[1], c * f[2] + d * t[2]
            sign = 1.0 if side == 0 else -1.0
            nx, ny, nz = (
                sign * (c * t[0] - d * f[0]), sign * (c * t[1] - d * f[1]), sign * (c * t[2] - d * f[2])
            )  # fmt: skip
            reach = _ABOVE + 0.5 * _ABOVE + math.sqrt(m[0] ** 2 + m[1] ** 2 + m[2] ** 2)
            votes = 0
            for k in range(len(_PLACES)):
                z = _PLACES[k] * edges.length[e]
                x, y, w = (
                    s[0] + z * a[0] + _ABOVE * nx,
                    s[1] + z * a[1] + _ABOVE * ny,
                    s[2] + z * a[2] + _ABOVE * nz,
                )
                _, on = cast(
                    geometry, x + _ACROSS * ux, y + _ACROSS * uy, w + _ACROSS * uz, -nx, -ny, -nz, reach
                )
                if on < 0 or geometry.plane[on] < 0:
                    continue
                _, off = cast(
                    geometry, x - _ACROSS * ux, y - _ACROSS * uy, w - _ACROSS * uz, -nx, -ny, -nz, reach
                )
                if off >= 0 and geometry.plane[off] == geometry.plane[on]:
                    votes -= 1
                elif plane[e, side] < 0 or plane[e, side] == geometry.plane[on]:
                    plane[e, side], triangle[e, side] = geometry.plane[on], on
                    votes += 1
            if votes <= 0:
                plane[e, side] = triangle[e, side] = -1


@part
def _reflected(edges, e, s, r):
    """(Face whose reflection an edge ends, angle by which a ray misses that face, length by way of its plane
    without end) for places `s`, `r` in order."""
    full, both = math.pi * edges.wedge[e], s[2] + r[2]
    face = 0 if both <= full else 1
    half = both if face == 0 else 2.0 * full - both
    dz = r[0] - s[0]
    straight = math.sqrt(dz * dz + s[1] * s[1] + r[1] * r[1] - 2.0 * s[1] * r[1] * math.cos(half))
    return face, half - math.pi, straight


@part
def _beside(edges, e, s, r, beside):
    """The path by an edge, its reflection missing the face by `beside` rad."""
    full, both = math.pi * edges.wedge[e], s[2] + r[2]
    target = math.pi + beside if both <= full else 2.0 * full - math.pi - beside
    return bend_at(edges.wedge[e], edges.length[e], s[0], s[1], s[2], r[0], r[1], r[2] + target - both)


@part
def _near_rims(edges, rims, p_edge, p_place, q_edge, q_place, begin, end, near, ray):
    """How many edges of mirrors a reflection passes closely: rows of both lists and the plane into `near` (E, 3);
    detour, angle by which the reflection misses the plane, length by way of it without end into `ray` (E, 3)."""
    found, own, other = 0, -1, begin - 1
    while True:
        own, other = next_common(p_edge, own + 1, len(p_edge), q_edge, other + 1, end)
        if own >= len(p_edge) or other >= end:
            break
        e = p_edge[own]
        if rims.plane[e, 0] >= 0 or rims.plane[e, 1] >= 0:
            s, r = in_order(p_place[own], q_place[other])
            face, beside, straight = _reflected(edges, e, s, r)
            dz = r[0] - s[0]
            detour = math.sqrt((s[1] + r[1]) ** 2 + dz * dz) - straight
            if rims.plane[e, face] >= 0 and detour < FARTHEST and r[2] - s[2] < math.pi:
                near[found, 0], near[found, 1], near[found, 2] = own, other, rims.plane[e, face]
                ray[found, 0], ray[found, 1], ray[found, 2] = detour, beside, straight
                found += 1
    return found


@part
def _group_of(edges, e, axes, groups):
    """Row of the group of an edge's direction, and how many there are with it."""
    a, best, at = edges.along[e], -1.0, 0
    for g in range(groups):
        b = edges.along[axes[g]]
        cos = abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
        if cos > best:
            best, at = cos, g
    if best > _ALONG or groups == _GROUPS:
        return at, groups
    axes[groups] = e
    return groups, groups + 1


@part
def _hopeful(edges, spectrum, p_edge, near, ray, first, count, scratch):
    """Whether the plate of `first` may be heard beside its reflection: Kirchhoff's field, all edges in sight."""
    sums, axes, closest, inside = scratch
    outer = False
    for n in range(first, count):
        outer |= near[n, 2] == near[first, 2] and ray[n, 1] > 0.0
    if not outer:
        return False
    groups = 0
    sums[:, :, 0] = 0.0
    for n in range(first, count):
        if near[n, 2] != near[first, 2]:
            continue
        before = groups
        g, groups = _group_of(edges, p_edge[near[n, 0]], axes, groups)
        if groups > before:
            closest[g] = math.inf
        if ray[n, 0] < closest[g]:
            closest[g], inside[g] = ray[n, 0], 1.0 if ray[n, 1] < 0.0 else 0.0
        sign = -1.0 if ray[n, 1] < 0.0 else 1.0
        for b in range(sums.shape[1]):
            k = spectrum.k[b, 1]
            sums[g, b, 0] += sign * nearness(ray[n, 0], k) * beyond(k, ray[n, 0])
    for b in range(sums.shape[1]):
        field = 1.0
        for g in range(groups):
            value = sums[g, b, 0] + inside[g]
            field *= value.real * value.real + value.imag * value.imag
        if field > _HEARD:
            return True
    return False


@part
def _add(bend, ks, straight, weight, taken, over, group):
    """Add an edge's p_d / p_mirror at wave numbers `ks` to the sums `group` (b, h), but for the part that goes with
    the direct sound: `taken` of it, faded by the edge's detour `over` that, m."""
    detour = bend.ds + bend.dr - straight
    for b in range(group.shape[0]):
        for h in range(ks.shape[1]):
            k = ks[b, h]
            scale = weight * nearness(detour, k) * straight
            if scale <= 0.0:
                continue
            if taken > 0.0:
                scale *= 1.0 - taken * nearness(over, k)
            r = image_term(bend.wedge, bend.ts, bend.tr, bend.ds, bend.dr, bend.sin_beta, k)
            group[b, h] += r * complex(scale * math.cos(k * detour), -scale * math.sin(k * detour))


@part
def _plate(
    geometry, edges, spectrum, p, q, p_edge, p_place, q_place, near, ray, first, count, lit, mirrored, scratch,
    factor,
):  # fmt: skip
    """The field of the plate of `first` over that of one without end: |field|² into `factor` (b,).

    (Whether there is anything to it, the edge by which a path goes, its place, the length by way of the plane);
    the edge is -1 where there is none: a mirror path (`mirrored`) needs none, and what is hidden has none.
    """
    sums, axes, closest, inside = scratch
    groups, edge, best, length, where = 0, -1, math.inf, 0.0, (0.0, 0.0, 0.0)
    ks, shares = (spectrum.lit_k, spectrum.lit_weight) if mirrored else (spectrum.k, spectrum.weight)
    sums[:, :, :] = 0.0
    for n in range(first, count):
        if near[n, 2] != near[first, 2]:
            continue
        e = p_edge[near[n, 0]]
        s, r = in_order(p_place[near[n, 0]], q_place[near[n, 1]])
        doubt = doubt_at(edges, e, s, r)
        within = ray[n, 1] < (doubt if mirrored else -doubt)
        bend = _beside(edges, e, s, r, min(ray[n, 1], -ASIDE) if within else max(ray[n, 1], ASIDE))
        if bend.share <= 0.0:
            continue
        ok, at = in_view(geometry, edges, e, bend, p, q)
        if not ok:
            continue
        before = groups
        g, groups = _group_of(edges, e, axes, groups)
        if groups > before:
            closest[g] = math.inf
        if ray[n, 0] < closest[g]:
            closest[g], inside[g] = ray[n, 0], 1.0 if within else 0.0
        if not within and ray[n, 0] < best:
            edge, best, length, where = e, ray[n, 0], ray[n, 2], at
        taken = share_of_far(bend) if lit else 0.0
        over = bend.ds + bend.dr - distance(p, q)
        _add(bend, ks, ray[n, 2], math.sqrt(bend.share), taken, over, sums[g])
    if groups == 0 or (edge < 0 and not mirrored):
        return False, edge, where, length
    for b in range(len(factor)):
        factor[b] = 0.0
        for h in range(len(shares)):
            field = 1.0
            for g in range(groups):
                value = sums[g, b, h] + (1.0 if mirrored else inside[g])
                field *= value.real * value.real + value.imag * value.imag
            factor[b] += shares[h] * field
    return True, edge, where, length


@part(forceinline=True)
def _height(geometry, triangle, p):
    """Distance of a point from the plane of a triangle, m."""
    n, anchor = geometry.normal[triangle], geometry.anchor[triangle]
    return abs(n[0] * (p[0] - anchor[0]) + n[1] * (p[1] - anchor[1]) + n[2] * (p[2] - anchor[2]))


@kernel
def _rim_paths(
    first, last, geometry, surfaces, edges, rims, spectrum, p, p_edge, p_place, points, partners, q_start, q_edge,
    q_place, walls, mirror_start, mirror_plane, factors, rows, counts, scratch,
):  # fmt: skip
    """What rims make of the reflections from one point to several.

    Multiplies rows of `factors` (reflections, b), those of partner j being mirror_start[j]:mirror_start[j + 1];
    fills `rows` (partners, slots, 8 + b): edge, length, direction at q, at p, energy per band; `counts`
    (partners,) says how many there are, room or none.
    """
    near, ray, energy, factor, plate = scratch
    for k in range(first, last):
        j = partners[k]
        q = (points[j, 0], points[j, 1], points[j, 2])
        counts[k] = 0
        found = _near_rims(
            edges, rims, p_edge, p_place, q_edge, q_place, q_start[j], q_start[j + 1], near, ray
        )
        for n in range(found):
            plane, seen, row = near[n, 2], False, -1
            for m in range(n):
                seen |= near[m, 2] == plane
            if seen:
                continue
            for m in range(mirror_start[j], mirror_start[j + 1]):
                if mirror_plane[m] == plane:
                    row = m
            if row < 0 and not _hopeful(edges, spectrum, p_edge, near, ray, n, found, plate):
                continue
            ok, edge, at, length = _plate(
                geometry, edges, spectrum, p, q, p_edge, p_place, q_place, near, ray, n, found, walls[j] == 0,
                row >= 0, plate, factor,
            )  # fmt: skip
            if not ok:
                continue
            if row >= 0:
                for b in range(len(factor)):
                    factors[row, b] *= factor[b]
                continue
            energy[:] = INV_4PI / (length * length)
            side = 0 if rims.plane[edge, 0] == plane else 1
            triangle = rims.triangle[edge, side]
            cos = min((_height(geometry, triangle, p) + _height(geometry, triangle, q)) / length, 1.0)
            attenuate_specular(surfaces, geometry.material[triangle], cos, energy)
            most = 0.0
            for b in range(len(energy)):
                energy[b] *= factor[b]
                most = max(most, energy[b])
            if most < _LEAST * INV_4PI / (length * length):
                continue
            if counts[k] < rows.shape[1]:
                write(rows[k, counts[k]], edge, at, p, q, energy)
            counts[k] += 1


def connect(tile: Tile) -> EarlyPaths | None:
    """What the rims of mirrors do to the reflections of every pair."""
    model, a, b = tile.model, tile.a.ends, tile.b.ends
    edges = model.prepared.part(prepare_wedges).edges
    mirrors = model.prepared.part(prepare_planes)
    if len(edges.length) == 0 or len(mirrors.offset) == 0:
        return None
    geometry, bands = model.world.geometry, model.world.air.shape[1]
    rims, spectrum, found = find_rims(model), make_spectrum(model.config), reflections(tile)
    of_a = sights(tile.a)
    of_b = of_a if tile.same else sights(tile.b)
    n_b = len(b.points)
    factors = np.ones((len(found.row), bands))
    parts: list[tuple[np.ndarray, np.ndarray]] = []

    def scratch() -> tuple[object, ...]:
        shape = _GROUPS, bands, len(spectrum.lit_weight)
        plate = (
            np.empty(shape, np.complex128),
            np.empty(_GROUPS, np.int64),
            np.empty(_GROUPS),
            np.empty(_GROUPS),
        )
        count = len(edges.length)
        return (
            np.empty((count, 3), np.int64),
            np.empty((count, 3)),
            np.empty(bands),
            np.empty(bands),
            plate,
        )

    slots = _SLOTS
    for i, p in enumerate(a.points):
        partners = np.arange(i if tile.same else 0, n_b)
        own = slice(of_a.start[i], of_a.start[i + 1])
        while True:
            rows = np.empty((len(partners), slots, 8 + bands))
            counts = np.zeros(len(partners), np.int64)
            mine = slice(found.start[i * n_b], found.start[(i + 1) * n_b])
            factor = np.ones((mine.stop - mine.start, bands))
            over_rows(
                _rim_paths, len(partners), geometry, model.world.surfaces, edges, rims, spectrum,
                (p[0], p[1], p[2]), of_a.edge[own], of_a.place[own], b.points, partners, of_b.start, of_b.edge,
                of_b.place, tile.walls[i], found.start[i * n_b : (i + 1) * n_b + 1] - mine.start,
                found.plane[mine], factor, rows, counts, scratch=scratch,
            )  # fmt: skip
            if counts.max(initial=0) <= slots:
                break
            slots = roomier(counts)
        factors[mine] = factor
        there = np.arange(slots) < counts[:, None]
        parts.append((i * n_b + partners[np.nonzero(there)[0]], rows[there]))
    weaken_reflections(tile, found, factors)
    pair = np.concatenate([k for k, _ in parts] or [np.empty(0, np.int64)])
    rows = np.concatenate([r for _, r in parts] or [np.empty((0, 8 + bands))])
    return both_ways(tile, as_paths(tile, pair, EDGE, rows[:, :1], rows[:, 1:]))


def find_rims(model: Model) -> Rims:
    """Which mirrors end at which edges of a scene."""
    edges = model.prepared.part(prepare_wedges).edges
    count = len(edges.length)
    rims = Rims(np.empty((count, 2), np.int64), np.empty((count, 2), np.int64))
    over_rows(_find_rims, count, model.world.geometry, edges, *rims)
    return rims
