"""Specular reflections and edges on one path: paths by edges from image sources.

An end of a path by one edge or two may be the image of a point in a large specular plane that rays from the point
meet: of one end, or of both in the same plane, as when sound goes from the floor over a cupboard and back to the
floor. What `single` and `double` do for two points (`by_edges`) is done for such ends, with what the planes
reflect. A reflection of the pair takes the interference factor of the edges that it passes closely, as the direct
sound does. The edges of the plane itself are `finite_reflectors`' matter.

Restricted to what is audible: the two edges are of one face, as those of a wall's top or of a pillar; paths fade
where they are 30 dB below all that a pair has of its own in the lowest band; and planes fill a Fresnel zone.
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
    release,
    two_edge_paths,
)
from soundspaces_sim.transport.diffraction.image_wedges import ImageSide, image_side, seen_image
from soundspaces_sim.transport.diffraction.pair_energies import pair_energies
from soundspaces_sim.transport.diffraction.passed_edges import EdgesOfScene
from soundspaces_sim.transport.diffraction.paths import MAX_DETOUR
from soundspaces_sim.transport.diffraction.points import edges_of_scene, seen_point
from soundspaces_sim.transport.diffraction.seen_ends import SeenEnd
from soundspaces_sim.transport.diffraction.spectrum import Spectrum, make_spectrum
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.image_source.reflections import (
    Reflections,
    first_order_reflections,
    scale_reflections,
)
from soundspaces_sim.transport.path_table import WAVE_POINTS, PathSlots, PathTable
from soundspaces_sim.transport.tile import Tile

_HEARD = 1e-3  # of a pair's energy in the lowest band


class _Context(NamedTuple):
    """What the kernel reads, and `factor` and `wave`, which it fills."""

    scene: EdgesOfScene
    spectrum: Spectrum
    a: ImageSide
    b: ImageSide
    heard: np.ndarray  # (A, B) J/m², below which paths fade
    reflections: Reflections
    factor: np.ndarray  # (n, b) of each reflection
    wave: np.ndarray  # (n, b, p) complex, of each reflection


class _Scratch(NamedTuple):
    of_plane: np.ndarray  # (P,) reflection of the pair at hand by each plane, -1 for none
    nearest: np.ndarray  # (P,) m, least detour by an edge that this reflection passes
    edges: EdgeScratch


@kernel
def _mixed_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, scratch: _Scratch
) -> None:
    """Paths of pairs by planes and edges, and the factors of their reflections."""
    found, view = context.reflections, context.scene.sight
    images_a, images_b = context.a.images, context.b.images
    for k in range(first, last):
        i, j = pairs[k]
        p, q = seen_point(context.a.points, i), seen_point(context.b.points, j)
        if distance(p.end.at, q.end.at) <= view.geometry.epsilon:
            continue
        number = i * len(context.b.points.at) + j
        scratch.of_plane[:] = -1
        for m in range(found.start[number], found.start[number + 1]):
            scratch.of_plane[found.plane[m]] = m
            context.factor[m, :] = 1.0
            context.wave[m, :, :] = 1.0
        swapped, heard = context.a.points.keys[i] > context.b.points.keys[j], context.heard[i, j]
        _find_nearest(context, (i, j), (p, q), slots, scratch)
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
    context: _Context,
    numbers: tuple[int, int],
    ends: tuple[SeenEnd, SeenEnd],
    slots: PathSlots,
    scratch: _Scratch,
) -> None:
    """Into `scratch.nearest` the least detour by an edge that each reflection of a pair passes, before the plane or
    after it: paths beside it fade with that, whichever end they are an image of."""
    images_a, images_b = context.a.images, context.b.images
    i, j = numbers
    scratch.nearest[:] = MAX_DETOUR
    for u in range(images_a.start[i], images_a.start[i + 1]):
        if scratch.of_plane[images_a.plane[u]] >= 0:
            image = seen_image(context.scene.sight, images_a, u)
            _note_nearest(context.scene, image, ends[1], slots, scratch)
    for v in range(images_b.start[j], images_b.start[j + 1]):
        if scratch.of_plane[images_b.plane[v]] >= 0:
            image = seen_image(context.scene.sight, images_b, v)
            _note_nearest(context.scene, image, ends[0], slots, scratch)


@part
def _note_nearest(
    scene: EdgesOfScene, image: SeenEnd, other: SeenEnd, slots: PathSlots, scratch: _Scratch
) -> None:
    if not (_sees_edges(image) and _sees_edges(other)):
        return
    a = image.end.plane
    between = Between(image, other, False, True, 0.0, scratch.nearest[a], slots, 0)
    scratch.nearest[a] = nearest_passed(scene, between, pair_of(between, scratch.edges))
    release(between, scratch.edges)


@part(forceinline=True)
def _sees_edges(seen: SeenEnd) -> bool:
    return seen.visible.start[seen.row + 1] > seen.visible.start[seen.row]


@part
def _between(context: _Context, between: Between, reflection: int, scratch: EdgeScratch) -> None:
    """Paths between two ends, and the factor of the reflection between them."""
    if not (_sees_edges(between.first) and _sees_edges(between.second)):
        return
    pair = pair_of(between, scratch)
    passed, nearest = one_edge_paths(context.scene, context.spectrum, between, pair, scratch)
    if passed:
        for b in range(context.factor.shape[1]):
            context.factor[reflection, b] *= scratch.wave.energy[b]
            for n in range(context.wave.shape[2]):
                context.wave[reflection, b, n] *= scratch.wave.field[b, n]
    two_edge_paths(context.scene, context.spectrum, between, nearest, scratch)
    release(between, scratch)


def connect(tile: Tile) -> PathTable | None:
    """Paths by planes and edges of every pair, and what edges take from its reflections."""
    model, scene = tile.model, tile.model.once(edges_of_scene)
    if scene is None or len(scene.sight.planes.offset) == 0:
        return None
    spectrum = make_spectrum(model.config.bands, model.config.c)
    reflections, planes = first_order_reflections(tile), len(scene.sight.planes.offset)
    shape = len(reflections.row), len(spectrum.lit.k)
    context = _Context(
        scene=scene,
        spectrum=spectrum,
        a=tile.a.once(image_side),
        b=tile.b.once(image_side),
        heard=np.ascontiguousarray(_HEARD * pair_energies(tile, 1)[:, :, 0]),
        reflections=reflections,
        factor=np.ones(shape),
        wave=np.ones((*shape, WAVE_POINTS), np.complex128),
    )

    def scratch() -> _Scratch:
        edges = make_edge_scratch(len(scene.wedges.length), len(scene.mutual.wedge), spectrum)
        return _Scratch(np.empty(planes, np.int64), np.empty(planes), edges)

    paths = for_each_pair(tile, _mixed_paths, context, tile.pairs, scratch)
    scale_reflections(tile, reflections, context.factor, context.wave)
    return paths
