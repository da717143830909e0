"""Which wedges the points of a side see, and where the points are about them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.scene.rays.geometry import Geometry, unoccluded
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.wedges import (
    WedgeCoordinates,
    Wedges,
    clear_point,
    wedge_coordinates,
)
from soundspaces_sim.transport.tile import Side

_SPACING = 0.4  # m, between the points of an edge that are tried
_BLOCK = 32  # points that are tried against all wedges at a time


class VisibleWedges(NamedTuple):
    """The wedges that N points see, and the points' coordinates about them: rows start[i]:start[i + 1] are those
    of point i."""

    start: np.ndarray  # (N + 1,)
    wedge: np.ndarray  # (n,) ascending for a point
    z: np.ndarray  # (n,) m
    r: np.ndarray  # (n,) m
    phi: np.ndarray  # (n,) rad


@part(forceinline=True)
def coordinates_in(visible: VisibleWedges, row: int) -> WedgeCoordinates:
    """Coordinates of a row's point about the row's wedge."""
    return WedgeCoordinates(visible.z[row], visible.r[row], visible.phi[row])


@kernel
def _try_points(
    first: int,
    last: int,
    geometry: Geometry,
    wedges: Wedges,
    points: np.ndarray,
    seen: np.ndarray,
    coordinates: np.ndarray,
) -> None:
    """Flags `seen` (N, E): some point of edge e is seen from point i; `coordinates` (N, E, 3) of i about e."""
    for i in range(first, last):
        p = row(points, i)
        for e in range(len(wedges.length)):
            c = wedge_coordinates(wedges, e, p)
            if c.phi > math.pi * wedges.n[e] or c.r < geometry.epsilon:
                continue
            coordinates[i, e, 0], coordinates[i, e, 1], coordinates[i, e, 2] = c
            count = max(int(math.ceil(wedges.length[e] / _SPACING)), 2)
            for k in range(count):
                if unoccluded(geometry, p, clear_point(wedges, e, (k + 0.5) / count * wedges.length[e])):
                    seen[i, e] = True
                    break


def see_in_blocks(
    count: int, edges: int, block: int, look: Callable[[slice, np.ndarray, np.ndarray], None]
) -> VisibleWedges:
    """What `count` points see of so many `edges`, `block` points at a time.

    `look` fills flags (n, E) and coordinates (n, E, 3) of a slice of the points.
    """
    rows, found, places = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty((0, 3))]
    for begin in range(0, count, block):
        part_of = slice(begin, min(begin + block, count))
        seen = np.zeros((part_of.stop - begin, edges), np.bool_)
        coordinates = np.empty((*seen.shape, 3))
        look(part_of, seen, coordinates)
        i, e = np.nonzero(seen)
        rows.append(begin + i)
        found.append(e)
        places.append(coordinates[i, e])
    start = np.searchsorted(np.concatenate(rows), np.arange(count + 1))
    z, r, phi = np.ascontiguousarray(np.concatenate(places).T)
    return VisibleWedges(start, np.concatenate(found), z, r, phi)


def visible_wedges(side: Side) -> VisibleWedges:
    """What the points of a side see of the wedges: `side.once(visible_wedges)`."""
    geometry, points = side.model.world.geometry, side.ends.points
    wedges = side.model.prepared.part(prepare_wedges).wedges

    def look(block: slice, seen: np.ndarray, coordinates: np.ndarray) -> None:
        over_rows(_try_points, len(seen), geometry, wedges, points[block], seen, coordinates, chunk=1)

    return see_in_blocks(len(points), len(wedges.length), _BLOCK, look)
