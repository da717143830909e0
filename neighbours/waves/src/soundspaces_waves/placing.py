"""Points between cells: weights of the cells around that give the pressure, or its gradient, at a point.

The weights are the smallest that are exact for polynomials up to the third degree over the cells in sight of
the point; where walls leave too few of them, up to a lower one. Sources are fed with the weights that listeners
are read with, so a response is the same from either end.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from soundspaces_sim import PointError, Scene
from soundspaces_sim.parts import Geometry, kernel, over_rows, unoccluded, vector_row as row
from soundspaces_waves.lattice import AXES, Lattice

ROWS = 1 + AXES  # pressure, and its derivatives along x, y and z
_DEGREES = (3, 2, 1, 0)
_REACH = 1.2  # of the weights' decay, in spacings
_EXACT, _LARGEST = (
    1e-6,
    4.0,
)  # error of a polynomial, and sum of magnitudes of pressure weights, of a degree that is taken


def place_points(
    scene: Scene, lattice: Lattice, component: np.ndarray, points: np.ndarray, what: str
) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each of (n, 3) points in m, world axes: its (k,) cells, all of one air, and (4, k) weights, of the
    pressure and of its derivatives in 1/m.

    Raises `PointError` for a point with no cell in sight.
    """
    at = np.ascontiguousarray(points - scene.center)
    place = (at - lattice.origin) / lattice.spacing
    block = np.array(list(product(range(-1, 3), repeat=AXES)))
    index = np.floor(place).astype(int)[:, None] + block
    inside = ((index >= 0) & (index < np.array(lattice.shape))).all(axis=2)
    cells = np.where(inside, index @ np.array(lattice.strides), -1)
    seen = np.zeros(cells.shape, np.bool_)
    over_rows(sight, len(at), scene.geometry, at, lattice.centres(), cells, seen)
    placed = []
    for i in range(len(at)):
        if not seen[i].any():
            x, y, z = points[i]
            raise PointError(
                f"{what}: point {i} at ({x:.3f}, {y:.3f}, {z:.3f}) m is in sight of no cell of the lattice of "
                f"waves ({lattice.spacing:.3g} m); move it into the open, or use more cells per wavelength"
            )
        offset = index[i] - place[i]
        nearest = np.where(seen[i], (offset**2).sum(axis=1), np.inf).argmin()
        own = seen[i] & (component[cells[i]] == component[cells[i, nearest]])
        placed.append((cells[i, own], _weights(offset[own], lattice.spacing)))
    return placed


def _weights(offset: np.ndarray, spacing: float) -> np.ndarray:
    """(4, k) for cells at (k, 3) spacings from the point."""
    decay = np.exp(-0.5 * (offset**2).sum(axis=1) / _REACH**2)
    for degree in _DEGREES:
        powers = [e for e in product(range(degree + 1), repeat=AXES) if sum(e) <= degree]
        basis = np.stack([np.prod(offset ** np.array(e), axis=1) for e in powers])
        wanted = np.zeros((len(powers), ROWS))
        wanted[powers.index((0, 0, 0)), 0] = 1.0
        for axis in range(AXES if degree else 0):
            wanted[powers.index(tuple(np.eye(AXES, dtype=int)[axis].tolist())), 1 + axis] = 1.0
        weights = decay[:, None] * (np.linalg.pinv(basis * decay, rcond=1e-9) @ wanted)
        exact = np.abs(basis @ weights - wanted).max() < _EXACT
        if degree == 0 or (exact and np.abs(weights[:, 0]).sum() < _LARGEST):
            break
    return np.asarray(weights.T * np.array([1.0, *(1.0 / spacing,) * AXES])[:, None])


@kernel
def sight(
    first: int,
    last: int,
    geometry: Geometry,
    points: np.ndarray,
    centres: np.ndarray,
    cells: np.ndarray,
    seen: np.ndarray,
) -> None:
    """Which of the cells (n, k), -1 for none, are in sight of their point."""
    for i in range(first, last):
        for k in range(cells.shape[1]):
            if cells[i, k] >= 0:
                seen[i, k] = unoccluded(geometry, row(points, i), row(centres, cells[i, k]))
