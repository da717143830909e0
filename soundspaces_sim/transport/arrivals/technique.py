"""All that arrives discretely, as a technique; and the direct sound.

The direct sound is the straight segment, attenuated by every surface that it crosses: of 1 J emitted, per m²,
1 / (4 pi r²), times the transmission of every surface between, times air.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.limits import LEAST_DISTANCE
from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.core.numerics.vec3 import distance, row
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.transport.arrivals.connect import (
    Context,
    Marked,
    Pair,
    Scratch,
    Surroundings,
    find_arrivals,
)
from soundspaces_sim.transport.arrivals.double_wedge import make_double_wedge_scratch
from soundspaces_sim.transport.arrivals.field import make_spectrum
from soundspaces_sim.transport.arrivals.for_each_pair import for_each_pair
from soundspaces_sim.transport.arrivals.images import View, most_reflected
from soundspaces_sim.transport.arrivals.prepared import mark_planes, prepare_planes, prepare_wedges
from soundspaces_sim.transport.arrivals.scene_edges import Edges, find_faces, find_links
from soundspaces_sim.transport.arrivals.sight import Sight, find_sight
from soundspaces_sim.transport.arrivals.specular_planes import make_cover, plane_boxes
from soundspaces_sim.transport.arrivals.waves import make_waves
from soundspaces_sim.transport.arrivals.ways import make_way_scratch
from soundspaces_sim.transport.bsdf import SPECULAR
from soundspaces_sim.transport.bsdf.surface import Surfaces, lambertian_energy
from soundspaces_sim.transport.elements import cross_walls
from soundspaces_sim.transport.model import Model, air_transmission
from soundspaces_sim.transport.state import Ends
from soundspaces_sim.transport.technique import Technique
from soundspaces_sim.transport.tile import Arrived, Side, Tile, nothing_arrived

_LEAST_DIRECT = 1e-9  # of the unobstructed energy


class _Scene(NamedTuple):
    geometry: Geometry
    surfaces: Surfaces
    least_distance: float  # m, shorter ones count as this


@kernel
def _direct_paths(
    first: int,
    last: int,
    scene: _Scene,
    a: Ends,
    b: Ends,
    energy: np.ndarray,
    walls: np.ndarray,
) -> None:
    """Fill rows of `energy` (A, B, b), without air, and of `walls` (A, B)."""
    for i in range(first, last):
        for j in range(len(b.points)):
            p, q = row(a.points, i), row(b.points, j)
            if a.keys[i] > b.keys[j]:  # one direction per pair, so that both ends agree to the bit
                p, q = q, p
            e = energy[i, j]
            e[:] = 1.0
            walls[i, j] = cross_walls(scene.geometry, scene.surfaces, p, q, e)
            r = max(distance(q, p), scene.least_distance)
            for band in range(len(e)):
                e[band] = e[band] * INV_4PI / r**2
                if e[band] < _LEAST_DIRECT * INV_4PI / r**2:
                    e[band] = 0.0


def direct_sound(tile: Tile) -> tuple[np.ndarray, np.ndarray]:
    """Direct sound of every pair (A, B, b), without air, and the walls (A, B) that it crosses."""
    world, a, b = tile.model.world, tile.a.ends, tile.b.ends
    scene = _Scene(world.geometry, world.surfaces, LEAST_DISTANCE)
    direct, walls = np.zeros(tile.shape), np.zeros(tile.shape[:2], np.int64)
    over_rows(_direct_paths, len(a.points), scene, a, b, direct, walls)
    return direct, walls


_ROOM = 1024  # waves of a pair that there is room for at first
#: m², of what hangs together of a plane in which points have images: the first Fresnel zone of 4 m + 4 m at 500 Hz
_MIN_AREA = 4.0


def view_of(model: Model) -> View:
    """What rays meet: `model.once(view_of)`."""
    planes, geometry = model.prepared.part(prepare_planes), model.world.geometry
    corners = model.scene.corners - model.scene.center
    boxes = plane_boxes(geometry.plane, corners, planes)
    cover, area = make_cover(geometry.plane, corners, planes)
    reflects = most_reflected(
        model.world.surfaces, geometry, len(planes.offset), len(model.config.bands) - 1
    )
    return View(geometry, model.world.surfaces, planes, boxes, cover, reflects, area >= _MIN_AREA)


def edges_of(model: Model) -> Edges:
    """A scene's edges: `model.once(edges_of)`."""
    wedges, mutual = model.prepared.part(prepare_wedges)
    geometry, surfaces = model.world.geometry, model.world.surfaces
    half, whole = 0.5 * np.pi / wedges.n, np.pi * wedges.n
    turn = np.stack([np.cos(half), np.sin(half), np.cos(whole), np.sin(whole)], axis=1)
    plane, material = find_faces(geometry, wedges)
    energy = surfaces.energy[:, SPECULAR] + lambertian_energy(surfaces)
    reflects = np.where(plane[:, :, None] >= 0, np.sqrt(energy[material]), 1.0)
    lost = 1.0 - reflects.min(axis=(1, 2))
    links = find_links(wedges, mutual)
    return Edges(wedges, plane, material, reflects, lost, mutual, links, turn)


def sight_of(side: Side) -> Sight:
    """What a side's points see: `side.once(sight_of)`."""
    model = side.model
    points = side.ends.points
    keys = point_keys(points, 0)  # what arrives is the same with every seed
    return find_sight(model.once(view_of), model.once(edges_of), points, keys)


def context_of(
    tile: Tile, direct: np.ndarray, walls: np.ndarray
) -> tuple[Context, Callable[[int], Scratch]]:
    """(What the kernel reads, what makes room for so many waves)."""
    model, edges = tile.model, tile.model.once(edges_of)
    spectrum = make_spectrum(model.config.bands, model.config.c)
    context = Context(
        scene=Surroundings(model.once(view_of), edges, spectrum),
        a=tile.a.once(sight_of),
        b=tile.b.once(sight_of),
        walls=walls,
        direct=direct,
        joined=np.zeros_like(direct),
    )
    bands = spectrum.k.shape[0]

    def scratch(room: int) -> Scratch:
        pair = Pair(
            waves=make_waves(room, spectrum),
            field=np.empty(spectrum.k.shape, np.complex128),
            energy=np.empty(bands),
            heard=np.empty(bands),
            least=np.empty(bands),
            images=np.empty((bands, 2)),
        )
        return Scratch(
            pair=pair,
            marked=Marked(
                wedge=np.full(len(edges.wedges.length), -1), link=np.full(len(edges.links.wedge), -1)
            ),
            double=make_double_wedge_scratch(len(spectrum.node)),
            way=make_way_scratch(),
        )

    return context, scratch


def connect(tile: Tile) -> Arrived:
    """The direct sound of every pair, and its other arrivals."""
    direct, walls = direct_sound(tile)
    model, (context, scratch) = tile.model, context_of(tile, direct, walls)
    paths = for_each_pair(tile, find_arrivals, context, tile.pairs, scratch, _ROOM)
    direct = context.joined * air_transmission(model.config, tile.distance)
    if tile.same:  # pairs i <= j were done, and count for both directions
        upper = np.tri(len(direct), dtype=bool).T[:, :, None]
        direct = np.where(upper, direct, direct.transpose(1, 0, 2))
    return Arrived(direct, walls, paths)


ARRIVALS = Technique(
    "arrivals",
    "direct sound, reflections off planes, round edges, and both",
    prepare=(prepare_planes, prepare_wedges),
    mark=mark_planes,
    connect=connect,
)


def _connect_direct(tile: Tile) -> Arrived:
    direct, walls = direct_sound(tile)
    direct *= air_transmission(tile.model.config, tile.distance)
    return nothing_arrived(tile)._replace(direct=direct, walls=walls)


#: Of `ARRIVALS` the direct sound alone, for programs that ask for it.
DIRECT = Technique("direct", "straight, through walls that transmit", connect=_connect_direct)
