"""Diffraction at the edges of finite reflectors: reflected energy is continuous across the reflection boundary.

The edge of a reflector diffracts about the reflection boundary as it does about the shadow boundary: by the terms
of the reflected wave in the coefficient (`utd.reflected_fields`). Over the reflection by an endless plane that is
r = p_d / p_mirror. A reflector between parallel edges has the field 1 + r_1 + r_2 where a ray meets it, and r_1 +
r_2 beside it; one with edges in several directions has the product over them, which is the separable Kirchhoff
integral of a rectangle (Rindel 1986, Attenuation of sound reflections due to diffraction, Nordic Acoustical
Meeting). So a reflector that is small against the wave reflects nothing. The specular path takes |field|² as a
factor; beside the reflector there is an arrival of its own, by way of the nearest edge.

Only edges of a short detour count, as for the direct sound; those farther than `paths.MAX_DETOUR` are neglected.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.io.disk_cache import cached_on_disk
from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, distance, dot, row, subtract
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry, material_met
from soundspaces_sim.transport.bsdf.surface import attenuate_specular
from soundspaces_sim.transport.check_cached import scene_key
from soundspaces_sim.transport.diffraction.ends import edge_path
from soundspaces_sim.transport.diffraction.image_wedges import ImageSide, image_side, seen_image
from soundspaces_sim.transport.diffraction.near_edges import (
    NearEdges,
    Pair,
    ReflectorEdges,
    find_near_edges,
)
from soundspaces_sim.transport.diffraction.pair_energies import pair_energies
from soundspaces_sim.transport.diffraction.paths import faded_in
from soundspaces_sim.transport.diffraction.plane_edges import (
    PlaneEdges,
    face_of,
    find_plane_edges,
    fits,
)
from soundspaces_sim.transport.diffraction.plane_pieces import triangle_at
from soundspaces_sim.transport.diffraction.points import edges_of_scene, seen_point
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.reflector_field import (
    MIN_FIELD,
    ReflectorField,
    ReflectorScratch,
    make_reflector_scratch,
    may_be_heard,
    reflector_field,
)
from soundspaces_sim.transport.diffraction.spectrum import make_spectrum
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.reflections import (
    Reflections,
    scale_reflections,
    specular_reflections,
)
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.path_table import (
    WAVE_POINTS,
    PathSlots,
    PathTable,
    store_wave,
    with_group,
)
from soundspaces_sim.transport.tile import Tile

_MIN_SHARE = 1e-4  # of the free field's energy
_HEARD = 2e-3  # of a pair's energy in a band: where arrivals from images begin to be heard


class _Context(NamedTuple):
    """What the kernel reads, and `factor` and `wave`, which it fills."""

    edges: ReflectorEdges
    a: ImageSide
    b: ImageSide
    walls: np.ndarray  # (A, B) between the points
    heard: np.ndarray  # (A * B, b) J/m², below which arrivals from images fade
    reflections: Reflections
    factor: np.ndarray  # (n, b) of each reflection
    wave: np.ndarray  # (n, b, p) complex, of each reflection


class _Scratch(NamedTuple):
    reflector: ReflectorScratch
    energy: np.ndarray  # (b,)
    least: np.ndarray  # (b,) of `_set_least`


class _Between(NamedTuple):
    """Two ends of a pair, of side a and of side b, and where their paths go."""

    pair: Pair
    number: int  # of the pair, in `Reflections`
    slots: PathSlots
    row: int  # of `slots`


@part(forceinline=True)
def _off(geometry: Geometry, triangle: int, p: Vec3) -> float:
    """How far a point is off the plane of a triangle, on the side of its normal, m."""
    return dot(row(geometry.normal, triangle), subtract(p, row(geometry.anchor, triangle)))


@part
def _store_arrival(
    context: _Context, between: _Between, plane: int, found: ReflectorField, scratch: _Scratch
) -> None:
    """The arrival beside a reflector, by way of its nearest edge: the reflection by the endless plane times the
    factor."""
    view, edges, pair = context.edges.sight, context.edges.plane_edges, between.pair
    energy, length, geometry = scratch.energy, found.length, view.geometry
    energy[:] = INV_4PI / (length * length)
    face = face_of(edges, found.edge, plane)
    triangle = edges.triangle[found.edge, face]
    p, q = pair.p.end, pair.q.end
    heights = abs(_off(geometry, triangle, p.at)) + abs(_off(geometry, triangle, q.at))
    cos = min(heights / length, 1.0)
    material = material_met(geometry, triangle, subtract(row(geometry.anchor, triangle), p.at))
    attenuate_specular(view.surfaces, material, cos, energy)
    most, share = 0.0, 0.0 if max(p.plane, q.plane) >= 0 else 1.0
    for b in range(len(energy)):
        energy[b] *= scratch.reflector.wave.energy[b]
        most = max(most, energy[b])
        if share < 1.0:
            share = max(share, faded_in(energy[b], context.heard[between.number, b]))
    if share > 0.0 and most >= _MIN_SHARE * INV_4PI / (length * length):
        for b in range(len(energy)):
            energy[b] *= share
        by_edge = distance(p.at, found.at) + distance(found.at, q.at)
        at, edge = (found.at, found.at), (found.edge, -1)
        path = edge_path(view, (p, q), False, edge, at, by_edge, energy)
        path = with_group(path, view.surfaces.group[material])
        store_wave(between.slots, between.row, path, energy, scratch.reflector.wave.field)


@part
def _seen_before(near: NearEdges, n: int) -> bool:
    """Whether the reflector of row n has a near edge before it."""
    for m in range(n):
        if near.piece[m] == near.piece[n]:
            return True
    return False


@part
def _meets_piece(edges: ReflectorEdges, pair: Pair, n: int, found: int, near: NearEdges) -> bool:
    """Whether the reflection by the plane of row n meets the piece of that row, of so many `found`: where no
    triangle is at the place, that of the nearest edge."""
    plane, geometry, plane_edges = near.plane[n], edges.sight.geometry, edges.plane_edges
    e = pair.p.visible.wedge[near.row_p[n]]
    triangle = plane_edges.triangle[e, face_of(plane_edges, e, plane)]
    normal, p, q = row(geometry.normal, triangle), pair.p.end.at, pair.q.end.at
    from_p, from_q = _off(geometry, triangle, p), _off(geometry, triangle, q)
    share = abs(from_p) / max(abs(from_p) + abs(from_q), geometry.epsilon)
    a, b = along(p, -from_p, normal), along(q, -from_q, normal)
    met = triangle_at(geometry, along(a, share, subtract(b, a)), normal, plane)
    if met >= 0:
        return plane_edges.of_triangle[met] == near.piece[n]
    nearest = n
    for m in range(found):
        if near.plane[m] == plane and near.detour[m] < near.detour[nearest]:
            nearest = m
    return near.piece[nearest] == near.piece[n]


@part
def _reflection_by(reflections: Reflections, number: int, planes: tuple[int, int, int]) -> int:
    """Row of a pair's reflection by planes in order from a, -1 for none; -1 if there is none."""
    found = -1
    for m in range(reflections.start[number], reflections.start[number + 1]):
        met = reflections.plane[m] == planes[0] and reflections.then[m] == planes[1]
        if met and reflections.back[m] == (planes[2] >= 0):
            found = m
    return found


@part(forceinline=True)
def _in_order(first: int, plane: int, last: int) -> tuple[int, int, int]:
    """The planes of a reflection by `plane` between images in the planes `first` and `last`, -1 for points."""
    return (plane, last, -1) if first < 0 else (first, plane, last)


@part
def _set_least(context: _Context, between: _Between, length: float, least: np.ndarray) -> bool:
    """Energies (b,), over that of the reflection by an endless plane, `length` m long, that are heard; whether one
    is less than that of the endless plane."""
    images, some = max(between.pair.p.end.plane, between.pair.q.end.plane) >= 0, False
    for b in range(len(least)):
        least[b] = MIN_FIELD
        if images:
            least[b] = max(MIN_FIELD, context.heard[between.number, b] * length * length / INV_4PI)
        some |= least[b] < 1.0
    return some


@part
def _paths_between(context: _Context, between: _Between, scratch: _Scratch) -> None:
    """Arrivals beside the finite reflectors between two ends, and the factors of the reflections by them."""
    edges, pair, near, wave = (
        context.edges,
        between.pair,
        scratch.reflector.near,
        scratch.reflector.wave,
    )
    first, last = pair.p.end.plane, pair.q.end.plane
    found = find_near_edges(edges, pair, near)
    for n in range(found):
        plane = near.plane[n]
        if _seen_before(near, n) or plane == first or plane == last:
            continue
        planes = _in_order(first, plane, last)
        reflection = _reflection_by(context.reflections, between.number, planes)
        if reflection >= 0 and not _meets_piece(edges, pair, n, found, near):
            reflection = -1  # it is by another piece of the plane
        if not _set_least(context, between, near.length[n], scratch.least):
            continue
        if reflection < 0 and not may_be_heard(edges, pair, n, found, scratch.least, scratch.reflector):
            continue
        reflector = reflector_field(edges, pair, n, found, reflection >= 0, scratch.reflector)
        if not reflector.acts:
            continue
        if reflection < 0:
            _store_arrival(context, between, plane, reflector, scratch)
            continue
        for b in range(len(wave.energy)):
            context.factor[reflection, b] *= wave.energy[b]
            for m in range(context.wave.shape[2]):
                context.wave[reflection, b, m] *= wave.field[b, m]


@kernel
def _reflector_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, scratch: _Scratch
) -> None:
    """Arrivals beside finite reflectors, and the factors of the reflections by them."""
    view, images_a, images_b = context.edges.sight, context.a.images, context.b.images
    for k in range(first, last):
        i, j = pairs[k]
        p, q = seen_point(context.a.points, i), seen_point(context.b.points, j)
        number = i * len(context.b.points.at) + j
        for m in range(context.reflections.start[number], context.reflections.start[number + 1]):
            context.factor[m, :] = 1.0
            context.wave[m, :, :] = 1.0
        _paths_between(
            context, _Between(Pair(p, q, context.walls[i, j] == 0), number, slots, k), scratch
        )
        for u in range(images_a.start[i], images_a.start[i + 1]):
            image = seen_image(view, images_a, u)
            lit = _reflection_by(context.reflections, number, (image.end.plane, -1, -1)) >= 0
            _paths_between(context, _Between(Pair(image, q, lit), number, slots, k), scratch)
        for v in range(images_b.start[j], images_b.start[j + 1]):
            image = seen_image(view, images_b, v)
            lit = _reflection_by(context.reflections, number, (image.end.plane, -1, -1)) >= 0
            _paths_between(context, _Between(Pair(p, image, lit), number, slots, k), scratch)
            for u in range(images_a.start[i], images_a.start[i + 1]):
                if images_a.plane[u] == image.end.plane:
                    other = seen_image(view, images_a, u)
                    _paths_between(
                        context, _Between(Pair(other, image, False), number, slots, k), scratch
                    )


def _plane_edges(model: Model) -> PlaneEdges:
    """Which planes end at which edges, of which there are some: `model.once(_plane_edges)`."""
    wedges, mutual = model.prepared.part(prepare_wedges)
    scene, corners = model.once(edges_of_scene), model.scene.corners - model.scene.center
    assert scene is not None
    return cached_on_disk(
        PlaneEdges,
        (scene_key(model.scene),),
        lambda: find_plane_edges(model.world.geometry, corners, wedges, mutual, scene.strip),
        lambda edges: fits(edges, len(wedges.length), len(corners), len(scene.sight.planes.offset)),
    )


def connect(tile: Tile) -> PathTable | None:
    """What the edges of finite reflectors do to the reflections of every pair."""
    model = tile.model
    wedges = model.prepared.part(prepare_wedges).wedges
    planes = model.prepared.part(prepare_planes)
    if len(wedges.length) == 0 or len(planes.offset) == 0:
        return None
    scene = model.once(edges_of_scene)
    assert scene is not None  # there are wedges
    spectrum = make_spectrum(model.config.bands, model.config.c)
    reflections, bands = specular_reflections(tile), len(spectrum.lit.k)
    context = _Context(
        edges=ReflectorEdges(scene.sight, wedges, model.once(_plane_edges), spectrum),
        a=tile.a.once(image_side),
        b=tile.b.once(image_side),
        walls=tile.walls,
        heard=_HEARD * pair_energies(tile, bands).reshape(-1, bands),
        reflections=reflections,
        factor=np.ones((len(reflections.row), bands)),
        wave=np.ones((len(reflections.row), bands, WAVE_POINTS), np.complex128),
    )

    def scratch() -> _Scratch:
        return _Scratch(make_reflector_scratch(len(wedges.length), spectrum), *np.empty((2, bands)))

    paths = for_each_pair(tile, _reflector_paths, context, tile.pairs, scratch)
    scale_reflections(tile, reflections, context.factor, context.wave)
    return paths
