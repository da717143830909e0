"""The kernel of paths by edges: of two points, by one edge or by two, and of their images, by either.

One kernel for the three techniques, since compiling what it consists of (`by_edges`) takes longest of all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import distance
from soundspaces_sim.transport.diffraction.by_edges import (
    Between,
    EdgeScratch,
    make_edge_scratch,
    nearest_passed,
    one_edge_paths,
    pair_of,
    points_between,
    release,
    two_edge_paths,
)
from soundspaces_sim.transport.diffraction.image_wedges import ImageSide, no_images, seen_image
from soundspaces_sim.transport.diffraction.passed_edges import EdgesOfScene
from soundspaces_sim.transport.diffraction.paths import MAX_DETOUR
from soundspaces_sim.transport.diffraction.points import edge_points, seen_point
from soundspaces_sim.transport.diffraction.seen_ends import SeenEnd, sees_edges
from soundspaces_sim.transport.diffraction.spectrum import Spectrum, make_spectrum
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.image_source.reflections import Reflections, no_reflections
from soundspaces_sim.transport.path_table import WAVE_POINTS, PathSlots, PathTable
from soundspaces_sim.transport.tile import Side, Tile

BY_ONE, BY_TWO, OF_IMAGES = 1, 2, 3  # paths of points by so many edges; of images, by one and by two


class EdgeContext(NamedTuple):
    """What the kernel reads, and `factor`, `wave` and `passed`, which it fills: rows are pairs i * B + j, or
    `reflections` if paths are `OF_IMAGES`."""

    scene: EdgesOfScene
    spectrum: Spectrum
    a: ImageSide
    b: ImageSide
    paths: int  # `BY_ONE` …
    walls: np.ndarray  # (A, B) between the points; 0: they see each other
    heard: np.ndarray  # (A, B) J/m², below which paths of images fade
    reflections: Reflections
    factor: np.ndarray  # (n, b) of the direct sound, or of each reflection
    wave: np.ndarray  # (n, b, p) complex, of the same
    passed: np.ndarray  # (n,) m, least detour by an edge that it passes; of points, 0 out of sight


class _Scratch(NamedTuple):
    of_plane: np.ndarray  # (P,) reflection of the pair at hand by each plane, -1 for none
    nearest: np.ndarray  # (P,) m, least detour by an edge that this reflection passes
    edges: EdgeScratch


@kernel
def edge_paths(
    first: int, last: int, context: EdgeContext, pairs: np.ndarray, slots: PathSlots, scratch: _Scratch
) -> None:
    """Paths of pairs by edges, and the factors of their direct sound or of their reflections."""
    for k in range(first, last):
        i, j = pairs[k]
        p, q = seen_point(context.a.points, i), seen_point(context.b.points, j)
        if distance(p.end.at, q.end.at) <= context.scene.sight.geometry.epsilon:
            continue
        if context.paths == OF_IMAGES:
            _of_images(context, p, q, slots, k, scratch)
        else:
            swapped = context.a.points.keys[i] > context.b.points.keys[j]
            between = points_between(p, q, context.walls[i, j], swapped, slots, k)
            _between(context, between, i * len(context.b.points.at) + j, scratch.edges)


@part
def _of_images(
    context: EdgeContext, p: SeenEnd, q: SeenEnd, slots: PathSlots, k: int, scratch: _Scratch
) -> None:
    """Paths of two points' images, row `k` of the slots: of one with the other point, of both in one plane."""
    found, view, i, j = context.reflections, context.scene.sight, p.row, q.row
    images_a, images_b = context.a.images, context.b.images
    number = i * len(context.b.points.at) + j
    scratch.of_plane[:] = -1
    for m in range(found.start[number], found.start[number + 1]):
        scratch.of_plane[found.plane[m]] = m
        context.factor[m, :] = 1.0
        context.wave[m, :, :] = 1.0
    swapped, heard = context.a.points.keys[i] > context.b.points.keys[j], context.heard[i, j]
    _find_nearest(context, p, q, slots, scratch)
    for u in range(images_a.start[i], images_a.start[i + 1]):
        image = seen_image(view, images_a, u)
        m, nearest = scratch.of_plane[image.end.plane], scratch.nearest[image.end.plane]
        between = Between(image, q, False, m >= 0, heard, nearest, slots, k)
        _between(context, between, m, scratch.edges)
    for v in range(images_b.start[j], images_b.start[j + 1]):
        image = seen_image(view, images_b, v)
        m, nearest = scratch.of_plane[image.end.plane], scratch.nearest[image.end.plane]
        between = Between(image, p, True, m >= 0, heard, nearest, slots, k)
        _between(context, between, m, scratch.edges)
        for u in range(images_a.start[i], images_a.start[i + 1]):
            if images_a.plane[u] == image.end.plane:
                own, other = seen_image(view, images_a, u), image
                if swapped:
                    own, other = other, own
                between = Between(own, other, swapped, False, heard, MAX_DETOUR, slots, k)
                _between(context, between, -1, scratch.edges)


@part
def _find_nearest(
    context: EdgeContext, p: SeenEnd, q: SeenEnd, slots: PathSlots, scratch: _Scratch
) -> None:
    """Into `scratch.nearest` the least detour by an edge that each reflection of a pair passes, before the plane or
    after it: paths beside it fade with that, whichever end they are an image of."""
    images_a, images_b, view = context.a.images, context.b.images, context.scene.sight
    scratch.nearest[:] = MAX_DETOUR
    for u in range(images_a.start[p.row], images_a.start[p.row + 1]):
        if scratch.of_plane[images_a.plane[u]] >= 0:
            _note_nearest(context.scene, seen_image(view, images_a, u), q, slots, scratch)
    for v in range(images_b.start[q.row], images_b.start[q.row + 1]):
        if scratch.of_plane[images_b.plane[v]] >= 0:
            _note_nearest(context.scene, seen_image(view, images_b, v), p, slots, scratch)


@part
def _note_nearest(
    scene: EdgesOfScene, image: SeenEnd, other: SeenEnd, slots: PathSlots, scratch: _Scratch
) -> None:
    if not (sees_edges(image) and sees_edges(other)):
        return
    a = image.end.plane
    between = Between(image, other, False, True, 0.0, scratch.nearest[a], slots, 0)
    scratch.nearest[a] = nearest_passed(scene, between, pair_of(between, scratch.edges))
    release(between, scratch.edges)


@part
def _between(context: EdgeContext, between: Between, row: int, scratch: EdgeScratch) -> None:
    """Paths between two ends, and the factor of what goes straight between them."""
    if not (sees_edges(between.first) and sees_edges(between.second)):
        return
    scene, spectrum, pair = context.scene, context.spectrum, pair_of(between, scratch)
    if context.paths == BY_TWO:
        nearest = nearest_passed(scene, between, pair)
    else:
        passed, nearest, least = one_edge_paths(scene, spectrum, between, pair, scratch)
        if row >= 0:
            context.passed[row] = least
        if passed:
            for b in range(context.factor.shape[1]):
                context.factor[row, b] *= scratch.wave.energy[b]
                for n in range(context.wave.shape[2]):
                    context.wave[row, b, n] *= scratch.wave.field[b, n]
    if context.paths != BY_ONE:
        two_edge_paths(scene, spectrum, between, nearest, scratch)
    release(between, scratch)


def find_paths(tile: Tile, context: EdgeContext) -> PathTable:
    """What the kernel finds for all pairs of a tile."""
    scene, planes = context.scene, len(context.scene.sight.planes.offset)

    def scratch() -> _Scratch:
        edges = make_edge_scratch(len(scene.wedges.length), len(scene.mutual.wedge), context.spectrum)
        return _Scratch(np.empty(planes, np.int64), np.empty(planes), edges)

    return for_each_pair(tile, edge_paths, context, tile.pairs, scratch)


def _without_images(side: Side) -> ImageSide:
    """The points of a side: `side.once(_without_images)`."""
    points = side.once(edge_points)
    return ImageSide(points, no_images(points.at))


def of_points(tile: Tile, scene: EdgesOfScene, paths: int) -> EdgeContext:
    """The context of paths of points, `BY_ONE` or `BY_TWO`, with factors of 1."""
    config, shape = tile.model.config, (tile.walls.size, tile.direct.shape[2])
    a, b = tile.a.once(_without_images), tile.b.once(_without_images)
    return EdgeContext(
        scene,
        make_spectrum(config.bands, config.c),
        a,
        b,
        paths,
        tile.walls,
        np.zeros(tile.walls.shape),
        no_reflections(tile.walls.size),
        np.ones(shape),
        np.ones((*shape, WAVE_POINTS), np.complex128),
        np.where(tile.walls.ravel() == 0, MAX_DETOUR, 0.0),
    )
