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

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, row, subtract
from soundspaces_sim.echogram.echogram import EDGE
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.transport.bsdf.surface import Surfaces, attenuate_specular
from soundspaces_sim.transport.diffraction.plane_edges import PlaneEdges, find_plane_edges
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.reflector_field import (
    NearEdges,
    Pair,
    ReflectorEdges,
    ReflectorField,
    ReflectorScratch,
    find_near_edges,
    make_reflector_scratch,
    may_be_heard,
    reflector_field,
)
from soundspaces_sim.transport.diffraction.spectrum import make_spectrum
from soundspaces_sim.transport.diffraction.visible_wedges import visible_wedges
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.reflections import (
    Reflections,
    first_order_reflections,
    scale_reflections,
)
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.path_table import (
    WAVE_POINTS,
    FoundPath,
    PathSlots,
    PathTable,
    store_wave,
)
from soundspaces_sim.transport.tile import Tile

_MIN_SHARE = 1e-4  # of the free field's energy


class _Context(NamedTuple):
    """What the kernel reads, and `factor` and `wave`, which it fills."""

    edges: ReflectorEdges
    surfaces: Surfaces
    points_a: np.ndarray  # (A, 3) m
    points_b: np.ndarray  # (B, 3) m
    walls: np.ndarray  # (A, B) between the points
    reflections: Reflections
    factor: np.ndarray  # (n, b) of each reflection
    wave: np.ndarray  # (n, b, p) complex, of each reflection


class _Scratch(NamedTuple):
    reflector: ReflectorScratch
    energy: np.ndarray  # (b,)


@part(forceinline=True)
def _height(geometry: Geometry, triangle: int, p: Vec3) -> float:
    """Distance of a point from the plane of a triangle, m."""
    n, anchor = geometry.normal[triangle], geometry.anchor[triangle]
    return abs(n[0] * (p[0] - anchor[0]) + n[1] * (p[1] - anchor[1]) + n[2] * (p[2] - anchor[2]))


@part(forceinline=True)
def _by_edge(e: int, at: Vec3, pair: Pair, group: int) -> FoundPath:
    """The path by a point of edge `e`; `group` of what reflects it there."""
    to_q, to_p = distance(at, pair.q), distance(at, pair.p)
    at_q, at_p = divide(subtract(at, pair.q), to_q), divide(subtract(at, pair.p), to_p)
    return FoundPath(to_p + to_q, at_q, at_p, (-1, -1), EDGE, (e, -1), (group, -1))


@part
def _store_arrival(
    context: _Context,
    pair: Pair,
    number: int,
    plane: int,
    found: ReflectorField,
    slots: PathSlots,
    scratch: _Scratch,
) -> None:
    """The arrival beside a reflector, by way of its nearest edge: the reflection by the endless plane times the
    factor."""
    geometry, edges = context.edges.geometry, context.edges.plane_edges
    energy, length = scratch.energy, found.length
    energy[:] = INV_4PI / (length * length)
    face = 0 if edges.plane[found.edge, 0] == plane else 1
    triangle = edges.triangle[found.edge, face]
    height = _height(geometry, triangle, pair.p) + _height(geometry, triangle, pair.q)
    cos = min(height / length, 1.0)
    attenuate_specular(context.surfaces, geometry.material[triangle], cos, energy)
    most = 0.0
    for b in range(len(energy)):
        energy[b] *= scratch.reflector.wave.energy[b]
        most = max(most, energy[b])
    if most >= _MIN_SHARE * INV_4PI / (length * length):
        group = context.surfaces.group[geometry.material[triangle]]
        path = _by_edge(found.edge, found.at, pair, group)
        store_wave(slots, number, path, energy, scratch.reflector.wave.field)


@part
def _seen_before(near: NearEdges, n: int) -> bool:
    """Whether the plane of row n has a near edge before it."""
    for m in range(n):
        if near.plane[m] == near.plane[n]:
            return True
    return False


@part
def _reflection_by(reflections: Reflections, number: int, plane: int) -> int:
    """Row of the reflection of a pair of this number by a plane, -1 if there is none."""
    found = -1
    for m in range(reflections.start[number], reflections.start[number + 1]):
        if reflections.plane[m] == plane:
            found = m
    return found


@kernel
def _reflector_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, scratch: _Scratch
) -> None:
    """Arrivals beside finite reflectors, and the factors of the reflections by them."""
    near, wave = scratch.reflector.near, scratch.reflector.wave
    for k in range(first, last):
        i, j = pairs[k]
        pair = Pair(row(context.points_a, i), row(context.points_b, j), context.walls[i, j] == 0)
        found = find_near_edges(context.edges, i, j, near)
        for n in range(found):
            if _seen_before(near, n):
                continue
            reflection = _reflection_by(
                context.reflections, i * len(context.points_b) + j, near.plane[n]
            )
            if reflection < 0 and not may_be_heard(context.edges, n, found, scratch.reflector):
                continue
            reflector = reflector_field(
                context.edges, pair, n, found, reflection >= 0, scratch.reflector
            )
            if not reflector.acts:
                continue
            if reflection < 0:
                _store_arrival(context, pair, k, near.plane[n], reflector, slots, scratch)
                continue
            for b in range(len(wave.energy)):
                context.factor[reflection, b] = wave.energy[b]
                for m in range(context.wave.shape[2]):
                    context.wave[reflection, b, m] = wave.field[b, m]


def _plane_edges(model: Model) -> PlaneEdges:
    """Which planes end at which edges: `model.once(_plane_edges)`."""
    wedges, mutual = model.prepared.part(prepare_wedges)
    return find_plane_edges(model.world.geometry, wedges, mutual)


def connect(tile: Tile) -> PathTable | None:
    """What the edges of finite reflectors do to the reflections of every pair."""
    model = tile.model
    wedges = model.prepared.part(prepare_wedges).wedges
    planes = model.prepared.part(prepare_planes)
    if len(wedges.length) == 0 or len(planes.offset) == 0:
        return None
    spectrum = make_spectrum(model.config.bands, model.config.c)
    geometry, reflections, bands = (
        model.world.geometry,
        first_order_reflections(tile),
        len(spectrum.lit.k),
    )
    edges = ReflectorEdges(
        geometry=geometry,
        wedges=wedges,
        plane_edges=model.once(_plane_edges),
        spectrum=spectrum,
        visible_a=tile.a.once(visible_wedges),
        visible_b=tile.b.once(visible_wedges),
    )
    context = _Context(
        edges=edges,
        surfaces=model.world.surfaces,
        points_a=tile.a.ends.points,
        points_b=tile.b.ends.points,
        walls=tile.walls,
        reflections=reflections,
        factor=np.ones((len(reflections.row), bands)),
        wave=np.ones((len(reflections.row), bands, WAVE_POINTS), np.complex128),
    )

    def scratch() -> _Scratch:
        return _Scratch(make_reflector_scratch(len(wedges.length), spectrum), np.empty(bands))

    paths = for_each_pair(tile, _reflector_paths, context, tile.pairs, scratch)
    scale_reflections(tile, reflections, context.factor, context.wave)
    return paths
