"""One specular reflection and one diffraction, in either order: a path by an edge from an image source.

For a pair out of sight of each other, by every large specular plane that rays from one end meet and every wedge
that both ends see: the path from that end's image by the edge to the other end, if it is in the wedge's shadow,
times what the plane reflects. A reflection of the pair takes the interference factor of the edges that it passes
closely, as the direct sound does (`energy`). Both ends' images are tried, so that both orders are there. The
edges of the plane itself are `finite_reflectors`' matter.

Restricted to what is audible (docs/lab_notes.md has the shares): pairs without direct sound, which masks such
paths; planes that fill a Fresnel zone; wedges that the image's end sees directly as well.

A path from p's image to q is computed from that image whichever end is the source: the same bits in both
directions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, row, subtract
from soundspaces_sim.echogram.echogram import EDGE_MIRROR, MIRROR_EDGE
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry, unoccluded
from soundspaces_sim.transport.bsdf.surface import Surfaces, attenuate_specular
from soundspaces_sim.transport.diffraction.energy import (
    Interference,
    add_edge,
    clear,
    shadow_energy,
    write_factor,
)
from soundspaces_sim.transport.diffraction.image_wedges import (
    Images,
    Search,
    find_images,
    image_coordinates,
)
from soundspaces_sim.transport.diffraction.paths import (
    MAX_DETOUR,
    DiffractedPath,
    apex_point,
    beyond_tolerance,
    contradicts,
    diffracted_path,
    in_order,
    next_common,
    off_boundary,
    offset_length,
    path_field,
)
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.spectrum import Spectrum, make_spectrum
from soundspaces_sim.transport.diffraction.visible_wedges import (
    VisibleWedges,
    coordinates_in,
    visible_wedges,
)
from soundspaces_sim.transport.diffraction.wedges import (
    WedgeCoordinates,
    Wedges,
)
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.image_source.images import image_of, sees_by_plane, signed_distance
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.reflections import (
    Reflections,
    first_order_reflections,
    scale_reflections,
)
from soundspaces_sim.transport.image_source.sequences import plane_sequences
from soundspaces_sim.transport.image_source.specular_planes import (
    SpecularPlanes,
    plane_areas,
    plane_boxes,
)
from soundspaces_sim.transport.path_table import FoundPath, PathSlots, PathTable, store
from soundspaces_sim.transport.tile import Side, Tile

_MIN_AREA = 4.0  # m², of a plane: about the first Fresnel zone of 4 m + 4 m at 500 Hz
_MIN_SHARE = 3e-3  # of the free field's energy


class _Points(NamedTuple):
    """One side of the tile."""

    at: np.ndarray  # (N, 3) m
    visible: VisibleWedges
    images: Images


class _Context(NamedTuple):
    """What the kernel reads, and `factor`, which it fills."""

    geometry: Geometry
    surfaces: Surfaces
    planes: SpecularPlanes
    boxes: np.ndarray  # (P, 2, 3) m, bounds of each plane's triangles
    wedges: Wedges
    spectrum: Spectrum
    a: _Points
    b: _Points
    reflections: Reflections
    factor: np.ndarray  # (n, b) of each reflection


class _Scratch(NamedTuple):
    """The reflections of the pair at hand, at most m, numbered from 0; and energies of a path."""

    of_plane: np.ndarray  # (P,) reflection by each plane, -1 for none
    sums: Interference  # (m, b, h) each
    passed: np.ndarray  # (m,) whether some edge has been added to `sums`
    energy: np.ndarray  # (b,)


class _Ends(NamedTuple):
    """The ends of a path from p's image to q; `swapped`: p is the point of side b."""

    pair: int  # row of the slots
    p: Vec3
    q: Vec3
    swapped: bool


@kernel
def _mixed_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, scratch: _Scratch
) -> None:
    """Paths of pairs by a plane and an edge, and the factors of their reflections."""
    found, a, b = context.reflections, context.a, context.b
    for k in range(first, last):
        i, j = pairs[k]
        number = i * len(b.at) + j
        begin, count = found.start[number], found.start[number + 1] - found.start[number]
        scratch.of_plane[:] = -1
        for m in range(count):
            scratch.of_plane[found.plane[begin + m]] = m
            scratch.passed[m] = False
            clear(_sums_of(scratch, m))
        p, q = row(a.at, i), row(b.at, j)
        _paths_from_images(context, a, i, b, j, _Ends(k, p, q, False), slots, scratch)
        _paths_from_images(context, b, j, a, i, _Ends(k, q, p, True), slots, scratch)
        for m in range(count):
            if scratch.passed[m]:
                write_factor(_sums_of(scratch, m), context.spectrum.lit, context.factor[begin + m])


@part(forceinline=True)
def _sums_of(scratch: _Scratch, m: int) -> Interference:
    return Interference(scratch.sums.ratio[m], scratch.sums.weight[m])


@part
def _paths_from_images(
    context: _Context,
    own: _Points,
    i: int,
    other: _Points,
    j: int,
    ends: _Ends,
    slots: PathSlots,
    scratch: _Scratch,
) -> None:
    """Paths from the images of point i of one side by edges to point j of the other."""
    visible, seen = own.visible, other.visible
    k, end = visible.start[i] - 1, visible.start[i + 1]
    n, stop = seen.start[j] - 1, seen.start[j + 1]
    while True:
        k, n = next_common(visible.wedge, k + 1, end, seen.wedge, n + 1, stop)
        if k >= end or n >= stop:
            break
        e, there = visible.wedge[k], coordinates_in(seen, n)
        if max(there.phi, math.pi * context.wedges.n[e] - there.phi) <= math.pi:
            continue  # in no point's shadow
        offset = offset_length(context.wedges, e)
        for m in range(own.images.start[k], own.images.start[k + 1]):
            a, here = own.images.plane[m], image_coordinates(own.images, m)
            if scratch.of_plane[a] < 0 and beyond_tolerance(here, there, offset):
                continue
            _path_from_image(context, a, e, in_order(here, there), ends, slots, scratch)


@part
def _path_from_image(
    context: _Context,
    a: int,
    e: int,
    about: tuple[WedgeCoordinates, WedgeCoordinates],
    ends: _Ends,
    slots: PathSlots,
    scratch: _Scratch,
) -> None:
    """The path from p's image in plane `a` by edge `e` to q, which are `about` it; or what it adds to the
    interference of the pair's reflection by that plane."""
    geometry, wedges, planes = context.geometry, context.wedges, context.planes
    (s, r), p, q = about, ends.p, ends.q
    image, reflection = image_of(planes, a, p), scratch.of_plane[a]
    lit = reflection >= 0
    if contradicts(wedges, e, s, r, lit):
        return
    path = diffracted_path(wedges.n[e], wedges.length[e], s, r, off_boundary(s, r, lit))
    total, straight = path.d_s + path.d_r, distance(image, q)
    if path.taper <= 0.0 or (lit and total - straight > MAX_DETOUR):
        return
    if not lit and _strength(path, context.spectrum.shadow.k[0, 0]) * total * total < _MIN_SHARE:
        return  # weaker yet at higher frequencies
    at = apex_point(wedges, e, path)
    if not unoccluded(geometry, q, at):
        return
    triangle, x = sees_by_plane(geometry, planes, context.boxes, a, p, image, at)
    if triangle < 0:
        return
    if lit:
        add_edge(path, context.spectrum.lit, straight, _sums_of(scratch, reflection))
        scratch.passed[reflection] = True
        return
    shadow_energy(path, context.spectrum.shadow, scratch.energy)
    cos = min(abs(signed_distance(planes, a, p)) / distance(p, x), 1.0)
    material = geometry.material[triangle]
    left = attenuate_specular(context.surfaces, material, cos, scratch.energy)
    if left * total * total >= _MIN_SHARE * INV_4PI:
        group = context.surfaces.group[material]
        store(slots, ends.pair, _found_path(a, e, x, at, image, ends, group), scratch.energy)


@part(forceinline=True)
def _strength(path: DiffractedPath, k: float) -> float:
    """|p_d|² at a wave number, 1/m²."""
    p = path_field(path, k, 1.0)
    return path.taper * (p.real * p.real + p.imag * p.imag)


@part
def _found_path(a: int, e: int, x: Vec3, at: Vec3, image: Vec3, ends: _Ends, group: int) -> FoundPath:
    """The path from p by `x` on plane `a`, of a material of `group`, and `at` on edge `e` to q."""
    to_image, to_q = distance(image, at), distance(at, ends.q)
    at_q = divide(subtract(at, ends.q), to_q)
    at_p = divide(subtract(x, ends.p), distance(x, ends.p))
    at_b, at_a = (at_p, at_q) if ends.swapped else (at_q, at_p)
    kind = EDGE_MIRROR if ends.swapped else MIRROR_EDGE
    return FoundPath(to_image + to_q, at_b, at_a, (a, -1), kind, (e, -1), (group, -1))


def _points(side: Side, large: np.ndarray) -> _Points:
    """A side; `large` (P,): planes in which it has images."""
    prepared, at, visible = side.model.prepared, side.ends.points, side.once(visible_wedges)
    met = side.once(plane_sequences).seen[:, :, -1] & large
    planes, wedges = prepared.part(prepare_planes), prepared.part(prepare_wedges).wedges
    search = Search(side.model.world.geometry, planes, wedges, at, met, visible)
    return _Points(at, visible, find_images(search))


def connect(tile: Tile) -> PathTable | None:
    """Paths by a plane and an edge of every pair out of sight, and what edges take from its reflections."""
    model, planes = tile.model, tile.model.prepared.part(prepare_planes)
    wedges = model.prepared.part(prepare_wedges).wedges
    if len(wedges.length) == 0 or len(planes.offset) == 0:
        return None
    spectrum = make_spectrum(model.config.bands, model.config.c)
    of_face, corners = model.world.geometry.plane, model.scene.corners - model.scene.center
    reflections, large = (
        first_order_reflections(tile),
        plane_areas(of_face, model.scene.corners, planes) >= _MIN_AREA,
    )
    of_a = _points(tile.a, large)
    context = _Context(
        geometry=model.world.geometry,
        surfaces=model.world.surfaces,
        planes=planes,
        boxes=plane_boxes(of_face, corners, planes),
        wedges=wedges,
        spectrum=spectrum,
        a=of_a,
        b=of_a if tile.same else _points(tile.b, large),
        reflections=reflections,
        factor=np.ones((len(reflections.row), len(spectrum.lit.k))),
    )
    most = int(np.diff(reflections.start).max(initial=0))

    def scratch() -> _Scratch:
        shape = most, *spectrum.lit.k.shape
        sums = Interference(np.empty(shape, np.complex128), np.empty(shape))
        return _Scratch(
            np.empty(len(large), np.int64), sums, np.empty(most, np.bool_), np.empty(shape[1])
        )

    pairs = tile.pairs
    hidden = pairs[tile.walls[pairs[:, 0], pairs[:, 1]] > 0]
    paths = for_each_pair(tile, _mixed_paths, context, hidden, scratch)
    scale_reflections(tile, reflections, context.factor)
    return paths
