"""Sound that is mirrored once and bends round one edge, in either order: an edge path of a mirror image.

For a pair out of sight, by every large mirror that one end meets and every edge that both ends see: the path from
that end's image round the edge to the other end, if it is bent into the shadow there, times what the mirror
reflects. A reflection that the pair has takes the factor of the edges that it passes closely, as the direct sound
does. Both ends' images are tried, so that both orders are there. The mirror's own rim is `rims`' matter.

Restricted to what is heard (docs/lab_notes.md has the shares): pairs without direct sound, which masks such paths;
mirrors that fill a Fresnel zone; edges that the mirrored end sees directly as well.

A path from p's image to q is computed from that image whichever end is asked: the same bits both ways.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.echogram import EDGE_MIRROR, MIRROR_EDGE
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import visible
from soundspaces_sim.scene.triangles import cross_products
from soundspaces_sim.transport.bsdf import MIRROR
from soundspaces_sim.transport.bsdf.surface import weaken
from soundspaces_sim.transport.diffraction.single import (
    ASIDE,
    DOUBT,
    FARTHEST,
    INSET,
    LIT_POINTS,
    about,
    as_paths,
    beat,
    bend_at,
    both_ways,
    distance,
    doubt_at,
    in_order,
    make_spectrum,
    next_common,
    on_edge,
    roomier,
    shade,
    sights,
    weaken_by,
)
from soundspaces_sim.transport.diffraction.utd import finite, wedge
from soundspaces_sim.transport.image_source.image_source import (
    bounce_at,
    crossing,
    image_of,
    reflections,
    sequences,
    side_of,
    weaken_reflections,
)
from soundspaces_sim.transport.tile import Side, Tile

_LEAST_AREA = 4.0  # m², of a mirror: about the first Fresnel zone of 4 m + 4 m at 500 Hz
_CLEAR = 0.06  # m: an edge nearer to a mirror is part of it
_LEAST = 3e-3  # of the free field's energy
_SLOTS = 16  # paths per pair that there is room for at first


@part(forceinline=True)
def _in_box(boxes, a, x):
    low, high = boxes[a, 0], boxes[a, 1]
    return low[0] <= x[0] <= high[0] and low[1] <= x[1] <= high[1] and low[2] <= x[2] <= high[2]


@part
def _way(geometry, mirrors, boxes, a, p, image, target):
    """(Triangle of mirror `a` by which p sees a place, the point of reflection); the triangle -1 if it does not."""
    ok, x = crossing(mirrors, a, image, target)
    if not ok or not _in_box(boxes, a, x):
        return -1, x
    triangle, lifted = bounce_at(geometry, mirrors, a, p, x)
    if triangle < 0:
        return -1, x
    if not visible(geometry, lifted[0], lifted[1], lifted[2], target[0], target[1], target[2]):
        return -1, x
    return triangle, x


def _areas(tile: Tile) -> np.ndarray:
    """(P,) m² of each mirror."""
    of_face, triangles = tile.model.world.geometry.plane, tile.model.scene.corners
    area = 0.5 * np.linalg.norm(cross_products(triangles), axis=1)
    count = len(tile.model.mirrors.offset)
    return np.bincount(of_face[of_face >= 0], area[of_face >= 0], count)


def _boxes(tile: Tile) -> np.ndarray:
    """(P, 2, 3) least and greatest coordinates of what belongs to each mirror, with some room."""
    model = tile.model
    of_face, mirrors = model.world.geometry.plane, model.mirrors
    face = np.flatnonzero(of_face >= 0)
    face = face[np.argsort(of_face[face], kind="stable")]
    corners = model.scene.corners[face] - model.scene.center
    boxes = np.empty((len(mirrors.offset), 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf  # no face has it: nothing is in it
    row, first = np.unique(of_face[face], return_index=True)
    boxes[row, 0] = np.minimum.reduceat(corners.min(axis=1), first)
    boxes[row, 1] = np.maximum.reduceat(corners.max(axis=1), first)
    room = (mirrors.margin + 0.01)[:, None]
    boxes[:, 0] -= room
    boxes[:, 1] += room
    return boxes


@part(forceinline=True)
def _strength(bend, k):
    """|p_d|² of a bend at a wave number, free field 1/r²."""
    near, far = wedge(bend.wedge, bend.ts, bend.tr, bend.ds, bend.dr, bend.sin_beta, k)
    p = (near + far) * finite(k, bend.apex, bend.length, bend.low, bend.high)
    return bend.share * (p.real * p.real + p.imag * p.imag)


class _Images(NamedTuple):
    """Where points' images are about the edges that the points see: rows start[k]:start[k + 1] are those of row k
    of their `Sights`. A point has them, not a pair."""

    start: np.ndarray  # (n + 1,)
    plane: np.ndarray  # (m,)
    place: np.ndarray  # (m, 3) of the image about the edge: z m, distance m, angle


@kernel
def _find_images(first, last, geometry, mirrors, edges, points, planes, start, edge, count, images):
    """Counts (n,) images of each of the points' sights `start`, `edge` in `planes` (N, P); fills `images` unless
    they are empty."""
    for i in range(first, last):
        p = (points[i, 0], points[i, 1], points[i, 2])
        for row in range(start[i], start[i + 1]):
            e, found = edge[row], 0
            full = math.pi * edges.wedge[e]
            for a in range(planes.shape[1]):
                if not planes[i, a] or _near_plane(mirrors, edges, e, a):
                    continue
                here = about(edges, e, image_of(mirrors, a, p[0], p[1], p[2]))
                if here[2] > full or here[1] < geometry.epsilon:
                    continue
                if len(images.plane) > 0:
                    at = images.start[row] + found
                    images.plane[at] = a
                    images.place[at, 0], images.place[at, 1], images.place[at, 2] = here
                found += 1
            count[row] = found


def _look_at_images(tile: Tile, side: Side, large: np.ndarray) -> _Images:
    model, of, points = tile.model, sights(tile, side), side.ends.points
    planes = sequences(tile, side).seen[:, :, -1] & large
    count, start = np.zeros(len(of.edge), np.int64), np.zeros(len(of.edge) + 1, np.int64)

    def find(images: _Images) -> _Images:
        over_rows(
            _find_images, len(points), model.world.geometry, model.mirrors, model.edges, points, planes,
            of.start, of.edge, count, images,
        )  # fmt: skip
        return images

    find(_Images(start, np.empty(0, np.int64), np.empty((0, 3))))  # how many
    np.cumsum(count, out=start[1:])
    return find(_Images(start, np.empty(start[-1], np.int64), np.empty((start[-1], 3))))


@part
def _bent(
    geometry, surfaces, mirrors, boxes, edges, spectrum, p, p_sights, i, images, q, q_sights, j, reflection,
    beats, weights, touched, rows, count, swapped, energy,
):  # fmt: skip
    """Paths of the images of p, point i of its side, round edges to q, point j of its own: how many there are with
    them, room or none; see `_mirrored_bends`. `reflection` (P,): row of the pair's reflections, or -1."""
    p_edge, q_edge = p_sights.edge, q_sights.edge
    own, last, other, end = (
        p_sights.start[i] - 1,
        p_sights.start[i + 1],
        q_sights.start[j] - 1,
        q_sights.start[j + 1],
    )
    while True:
        own, other = next_common(p_edge, own + 1, last, q_edge, other + 1, end)
        if own >= last or other >= end:
            break
        e, there = p_edge[own], q_sights.place[other]
        full, lift = math.pi * edges.wedge[e], edges.lift[e]
        if max(there[2], full - there[2]) <= math.pi:  # in no place's shadow
            continue
        lifted = math.sqrt(lift[0] * lift[0] + lift[1] * lift[1] + lift[2] * lift[2])
        for k in range(images.start[own], images.start[own + 1]):
            a, here = images.plane[k], images.place[k]
            mirrored, depth = reflection[a], abs(here[2] - there[2]) - math.pi
            if mirrored < 0 and (-depth - DOUBT) * min(here[1], there[1]) > 2.0 * lifted + ASIDE:
                continue  # in light, farther than `doubt_at`
            image = image_of(mirrors, a, p[0], p[1], p[2])
            s, r = in_order((here[0], here[1], here[2]), (there[0], there[1], there[2]))
            depth, doubt = r[2] - s[2] - math.pi, doubt_at(edges, e, s, r)
            if (depth > doubt) if mirrored >= 0 else (depth < -doubt):
                continue
            side = math.pi - ASIDE if mirrored >= 0 else math.pi + ASIDE
            angle = s[2] + (min(r[2] - s[2], side) if mirrored >= 0 else max(r[2] - s[2], side))
            bend = bend_at(edges.wedge[e], edges.length[e], s[0], s[1], s[2], r[0], r[1], angle)
            total, straight = bend.ds + bend.dr, distance(image, q)
            if bend.share <= 0.0 or (mirrored >= 0 and total - straight > FARTHEST):
                continue
            if mirrored < 0 and _strength(bend, spectrum.k[0, 0]) * total * total < _LEAST:
                continue  # higher, they are weaker yet
            inset = min(INSET, 0.25 * bend.length)
            at = on_edge(edges, e, min(max(bend.apex, inset), bend.length - inset))
            if not visible(geometry, q[0], q[1], q[2], at[0], at[1], at[2]):
                continue
            triangle, x = _way(geometry, mirrors, boxes, a, p, image, at)
            if triangle < 0:
                continue
            if mirrored >= 0:
                beat(bend, spectrum, straight, beats[mirrored], weights[mirrored])
                touched[mirrored] = True
                continue
            shade(bend, spectrum, energy)
            cos = min(abs(side_of(mirrors, a, *p)) / distance(p, x), 1.0)
            left = weaken(surfaces, geometry.material[triangle], MIRROR, cos, energy, 1.0)
            if left * total * total < _LEAST * INV_4PI:
                continue
            if count < rows.shape[0]:
                _write(rows[count], swapped, a, e, p, image, x, at, q, energy)
            count += 1
    return count


@part(forceinline=True)
def _near_plane(mirrors, edges, e, a):
    """Whether an edge is part of a mirror."""
    s, f, length = edges.start[e], edges.along[e], edges.length[e]
    one = side_of(mirrors, a, s[0], s[1], s[2])
    other = side_of(mirrors, a, s[0] + length * f[0], s[1] + length * f[1], s[2] + length * f[2])
    return max(abs(one), abs(other)) < _CLEAR + mirrors.margin[a]


@part
def _write(row, swapped, a, e, p, image, x, at, q, energy):
    """A path as a row of `_mirrored_bends`; `swapped`: p is the partner."""
    row[0], row[1], row[2] = (1.0 if swapped else 0.0), a, e
    to_p, to_q, first = distance(image, at), distance(at, q), distance(x, p)
    row[3] = to_p + to_q
    for axis in range(3):
        there, here = (at[axis] - q[axis]) / to_q, (x[axis] - p[axis]) / first
        row[4 + axis], row[7 + axis] = (here, there) if swapped else (there, here)
    for b in range(len(energy)):
        row[10 + b] = energy[b]


@kernel
def _mirrored_bends(
    first, last, geometry, surfaces, mirrors, boxes, edges, spectrum, p, i, p_sights, p_images, points, partners,
    q_sights, q_images, mirror_start, mirror_plane, factors, rows, counts, scratch,
):  # fmt: skip
    """Paths from one point, `i` of its side, to several by a mirror and an edge.

    Fills `rows` (partners, slots, 10 + b): whether the edge comes first, plane, edge, length, direction at q, at p,
    energy per band; `counts` (partners,) says how many there are, room or none. Multiplies rows of `factors`
    (reflections, b), those of partner j being mirror_start[j]:mirror_start[j + 1].
    """
    energy, beats, weights, touched, reflection = scratch
    for k in range(first, last):
        j = partners[k]
        q = (points[j, 0], points[j, 1], points[j, 2])
        begin, end = mirror_start[j], mirror_start[j + 1]
        reflection[:] = -1
        for m in range(end - begin):
            reflection[mirror_plane[begin + m]] = m
            beats[m], weights[m], touched[m] = 0.0, 0.0, False
        count = _bent(
            geometry, surfaces, mirrors, boxes, edges, spectrum, p, p_sights, i, p_images, q, q_sights, j,
            reflection, beats, weights, touched, rows[k], 0, False, energy,
        )  # fmt: skip
        counts[k] = _bent(
            geometry, surfaces, mirrors, boxes, edges, spectrum, q, q_sights, j, q_images, p, p_sights, i,
            reflection, beats, weights, touched, rows[k], count, True, energy,
        )  # fmt: skip
        for m in range(end - begin):
            if touched[m]:
                weaken_by(factors[begin + m], beats[m], weights[m], spectrum.lit_weight)


def close(tile: Tile) -> None:
    """Paths by a mirror and an edge of every pair out of sight, and what edges take from its reflections."""
    model, edges, a, b = tile.model, tile.model.edges, tile.a.ends, tile.b.ends
    if len(edges.length) == 0 or len(model.mirrors.offset) == 0:
        return
    geometry, bands, n_b = model.world.geometry, model.world.air.shape[1], len(b.points)
    boxes, spectrum, found = _boxes(tile), make_spectrum(model.config), reflections(tile)
    large = _areas(tile) >= _LEAST_AREA
    of_a, of_b = sights(tile, tile.a), sights(tile, tile.b)
    images_a = _look_at_images(tile, tile.a, large)
    images_b = images_a if tile.same else _look_at_images(tile, tile.b, large)
    most = int(np.diff(found.start).max(initial=0))
    factors = np.ones((len(found.row), bands))
    parts: list[tuple[np.ndarray, np.ndarray]] = []

    def scratch() -> tuple[np.ndarray, ...]:
        shape = most, bands, LIT_POINTS
        return (
            np.empty(bands), np.empty(shape, np.complex128), np.empty(shape), np.empty(most, np.bool_),
            np.empty(len(large), np.int64),
        )  # fmt: skip

    slots = _SLOTS
    for i, p in enumerate(a.points):
        partners = np.arange(i if tile.same else 0, n_b)
        partners = partners[tile.walls[i, partners] > 0]
        mine = slice(found.start[i * n_b], found.start[(i + 1) * n_b])
        while len(partners):
            rows = np.empty((len(partners), slots, 10 + bands))
            counts = np.zeros(len(partners), np.int64)
            factor = np.ones((mine.stop - mine.start, bands))
            over_rows(
                _mirrored_bends, len(partners), geometry, model.world.surfaces, model.mirrors, boxes, edges,
                spectrum, (p[0], p[1], p[2]), i, of_a, images_a, b.points, partners, of_b, images_b,
                found.start[i * n_b : (i + 1) * n_b + 1] - mine.start, found.plane[mine], factor, rows, counts,
                scratch=scratch,
            )  # fmt: skip
            if counts.max() <= slots:
                factors[mine] = factor
                there = np.arange(slots) < counts[:, None]
                parts.append((i * n_b + partners[np.nonzero(there)[0]], rows[there]))
                break
            slots = roomier(counts)
    weaken_reflections(tile, found, factors)
    pair = np.concatenate([k for k, _ in parts] or [np.empty(0, np.int64)])
    rows = np.concatenate([r for _, r in parts] or [np.empty((0, 10 + bands))])
    kind = np.where(rows[:, 0] > 0.0, EDGE_MIRROR, MIRROR_EDGE)
    paths = as_paths(tile, pair, kind, rows[:, 2:3], rows[:, 3:], rows[:, 1])
    tile.early.append(both_ways(tile, paths))
