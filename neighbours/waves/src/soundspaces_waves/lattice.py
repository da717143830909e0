"""A cubic lattice over a scene, and what its links cross.

Cells are cubes of side h about the points of the lattice, cut by the walls; a link connects the centres of two
cells that share a face. Walls lie on links, not in cells: two rays along every link, one from either end, find
the first surface and how far it is, so partitions need no thickness, and the air on both sides of a wall ends
where the wall is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim import Scene, SimulationError
from soundspaces_sim.parts import Geometry, cast_ray, check_memory, kernel, over_rows, vector_row as row

AXES = 3
_OF_CELL = 2600  # bytes of memory per cell, while a lattice and its scheme are made
#: Of the middle of the lattice from that of the scene, in cells: no wall at a round number lies on a cell's centre.
_SHIFT = np.array([3.1e-3, 4.7e-3, 5.9e-3])
_MOST_CELLS = 100_000_000
DIRECTIONS = np.concatenate([np.eye(AXES), -np.eye(AXES)])


class Lattice(NamedTuple):
    """Cells at `origin` + h (i, j, k), relative to the scene's centre; cell number (i ny + j) nz + k."""

    spacing: float  # h, m
    origin: np.ndarray  # (3,) m
    shape: tuple[int, int, int]

    @property
    def cells(self) -> int:
        nx, ny, nz = self.shape
        return nx * ny * nz

    @property
    def strides(self) -> tuple[int, int, int]:
        """Of the cell's number along each axis."""
        return self.shape[1] * self.shape[2], self.shape[2], 1

    def centres(self) -> np.ndarray:
        """(cells, 3) m, relative to the scene's centre."""
        grid = np.stack(np.unravel_index(np.arange(self.cells), self.shape), axis=1)
        return np.asarray(self.origin + self.spacing * grid)


class Crossings(NamedTuple):
    """The first surface on the links from every cell, along +x, +y, +z, -x, -y, -z."""

    distance: np.ndarray  # (cells, 6) from the centre over h, 0 to 1; inf where the link is clear
    triangle: np.ndarray  # (cells, 6), -1 where there is none


def make_lattice(scene: Scene, spacing: float) -> Lattice:
    """The lattice that fills a scene's bounds, in the middle of them. Raises `SimulationError` for too many
    cells."""
    extent = scene.bounds[1] - scene.bounds[0]
    counts = np.maximum(np.round(extent / spacing), 1.0)
    if not counts.prod() <= _MOST_CELLS:
        raise SimulationError(
            f"{scene.name}: {counts.prod():.3g} cells of {spacing:.3g} m fill its bounds, expected at most "
            f"{_MOST_CELLS:.0e}; lower the edge, or use fewer cells per wavelength"
        )
    check_memory(_OF_CELL * counts.prod(), f"a lattice of {counts.prod():,.0f} cells of {spacing:.3g} m")
    nx, ny, nz = counts.astype(int).tolist()
    origin = -0.5 * spacing * (counts - 1.0) + _SHIFT * spacing
    return Lattice(spacing, origin, (nx, ny, nz))


def cast_links(geometry: Geometry, lattice: Lattice) -> Crossings:
    """What the links of every cell cross. A link is blocked from both ends if it is from one."""
    centres = lattice.centres()
    distance = np.full((lattice.cells, 2 * AXES), np.inf)
    triangle = np.full((lattice.cells, 2 * AXES), -1)
    over_rows(_cast, lattice.cells, geometry, centres, DIRECTIONS, lattice.spacing, distance, triangle)
    distance /= lattice.spacing
    for axis in range(AXES):
        at, beyond = pairs_along(lattice, axis)
        one_way(distance, triangle, (at, axis), (beyond, axis + AXES))
        one_way(distance, triangle, (beyond, axis + AXES), (at, axis))
    return Crossings(distance, triangle)


def pairs_along(lattice: Lattice, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """(n,) cells and (n,) their neighbours along +axis."""
    numbers = np.arange(lattice.cells).reshape(lattice.shape)
    at = np.take(numbers, range(lattice.shape[axis] - 1), axis).ravel()
    return at, at + lattice.strides[axis]


def one_way(
    distance: np.ndarray,
    triangle: np.ndarray,
    seen: tuple[np.ndarray, int],
    missed: tuple[np.ndarray, int],
) -> None:
    """Give the links that only one end's ray found blocked the same surface from the other end."""
    alone = (triangle[seen] >= 0) & (triangle[missed] < 0)
    cells, column = missed[0][alone], missed[1]
    distance[cells, column] = 1.0 - distance[seen][alone]
    triangle[cells, column] = triangle[seen][alone]


@kernel
def _cast(
    first: int,
    last: int,
    geometry: Geometry,
    centres: np.ndarray,
    directions: np.ndarray,
    limit: float,
    distance: np.ndarray,
    triangle: np.ndarray,
) -> None:
    """Distance (cells, 6), m, and triangle of the first surface on every link."""
    for i in range(first, last):
        for k in range(2 * AXES):
            t, hit = cast_ray(geometry, row(centres, i), row(directions, k), limit)
            if hit >= 0:
                distance[i, k] = t
                triangle[i, k] = hit
