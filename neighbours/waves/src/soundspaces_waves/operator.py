"""The scheme's weights: volumes and areas of cells that walls cut, the stencil, the largest time step.

A side of a cell reaches half a spacing to the next cell, or to the wall on its link: at n² (d - 1/2) more than
half, with d the distance to the wall and n the share of its normal along the link, so that volumes are those of
the room and walls along the axes stand where they are. A link's area is the product of the mean extents of its
cells across it.

Sound along an oblique wall does not move the air in the corners of stairs, which slows it down: a mode's energy
lacks half a link wherever a side is blocked. The link on the other side of the cell takes over a share of it
(`stair_share`): all where sound passes along the wall, nothing at walls along the axes.

With A the sum over open links of S (p_j - p_i)² less 1/6 of the sum over squares of four cells, all links of
which are open, of their width times (p_00 - p_10 - p_01 + p_11)², the scheme is V (p+ - 2 p + p-) = -courant² A
p: 19 points in the open, fewer at walls. A is positive (a link's four squares take at most 4/6 of it), so the
scheme is stable up to courant² = 4 / (largest eigenvalue of A over V).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array

from soundspaces_sim import Scene
from soundspaces_waves.dispersion import MIXED
from soundspaces_waves.lattice import AXES, Crossings, Lattice, pairs_along

LEAST_EXTENT = 0.1  # of a cell between two walls
_ITERATIONS = 40
_MARGIN = 1.02  # over the eigenvalue that the iteration finds
_STEPS_OF_COURANT = 256
_MOST_COURANT2 = 0.74  # the limit in the open is 3/4
_OF_EDGE2 = (
    0.6  # mean square of the wave numbers of a room's modes up to the edge, over that of the edge
)


class Cut(NamedTuple):
    """Cells cut by walls."""

    sides: np.ndarray  # (cells, 6) from the centre to the end of the cell, over h
    extent: np.ndarray  # (cells, 3) over h
    volume: np.ndarray  # (cells,) over h³
    stairs: (
        np.ndarray
    )  # (cells, 6) what a blocked side adds to the area of the link opposite, over that area
    along: np.ndarray  # (cells, 6) |n|, of the walls on the links
    blocked: np.ndarray  # (cells, 6) walls and layers
    clear: tuple[np.ndarray, ...]  # (n,) cells whose links along +x, +y, +z are open


def stair_share(along: np.ndarray, kh: float) -> np.ndarray:
    """Share of what a mode's energy lacks where a link is blocked that the opposite link takes over; `along`: |n|,
    `kh`: the wave number at the edge times the spacing.

    The mean energy of modes up to the edge, of all directions, beside a rigid wall: equation T53.
    """
    n2 = along**2
    normal = n2**2 * _OF_EDGE2 * kh**2 * (13.0 + 4.0 * n2) / 20.0
    return np.asarray((1.0 - n2) / (1.0 - n2 + normal))


def cut_cells(scene: Scene, lattice: Lattice, crossings: Crossings, layer: np.ndarray, kh: float) -> Cut:
    """`layer`: (F,) faces of porous layers, which block no volume; `kh` as in `stair_share`. Links out of the
    lattice end in the open."""
    triangle, beyond = crossings.triangle, outside(lattice)
    hit = triangle >= 0
    normal = np.abs(scene.normals[triangle].reshape(-1, 2, AXES, AXES))
    along = np.where(hit, np.einsum("isaa->isa", normal).reshape(-1, 2 * AXES), 1.0)
    blocked = hit | beyond
    solid = blocked & ~(hit & layer[triangle])
    distance = np.where(hit, np.minimum(crossings.distance, 1.0), 0.5)
    sides = 0.5 + np.where(solid, along**2 * (distance - 0.5), 0.0)
    extent = np.maximum(sides[:, :AXES] + sides[:, AXES:], LEAST_EXTENT)
    clear = []
    for axis in range(AXES):
        at, _ = pairs_along(lattice, axis)
        clear.append(at[~blocked[at, axis]])
    stairs = np.where(solid & hit, sides * stair_share(along, kh), 0.0)
    return Cut(sides, extent, extent.prod(axis=1), stairs, along, blocked, tuple(clear))


def outside(lattice: Lattice) -> np.ndarray:
    """(cells, 6) links that lead out of the lattice."""
    out = np.zeros((lattice.cells, 2 * AXES), bool)
    place = np.unravel_index(np.arange(lattice.cells), lattice.shape)
    for axis in range(AXES):
        out[:, axis] = place[axis] == lattice.shape[axis] - 1
        out[:, axis + AXES] = place[axis] == 0
    return out


def link_area(cut: Cut, at: np.ndarray, beyond: np.ndarray, axis: int) -> np.ndarray:
    """(n,) over h², of links between cells."""
    across = [t for t in range(AXES) if t != axis]
    return np.asarray((0.5 * (cut.extent[at] + cut.extent[beyond]))[:, across].prod(axis=1))


def stiffness_matrix(lattice: Lattice, cut: Cut) -> csr_array:
    """(cells, cells) A."""
    is_open = np.zeros((AXES, lattice.cells), bool)
    rows: list[np.ndarray] = []
    columns: list[np.ndarray] = []
    weights: list[np.ndarray] = []

    def put(i: np.ndarray, j: np.ndarray, weight: np.ndarray) -> None:
        rows.extend((i, j))
        columns.extend((j, i))
        weights.extend((weight, weight))

    for axis, at in enumerate(cut.clear):
        is_open[axis, at] = True
        beyond = at + lattice.strides[axis]
        stairs = 1.0 + cut.stairs[beyond, axis] + cut.stairs[at, axis + AXES]
        put(at, beyond, -stairs * link_area(cut, at, beyond, axis))
    for d, t in ((0, 1), (1, 2), (2, 0)):
        along, across = lattice.strides[d], lattice.strides[t]
        c00 = np.flatnonzero(is_open[d] & is_open[t])
        c00 = c00[is_open[d, c00 + across] & is_open[t, c00 + along]]
        square = c00, c00 + along, c00 + across, c00 + along + across
        third = 3 - d - t
        mixed = MIXED * np.min([cut.extent[c, third] for c in square], axis=0)
        for i, j in ((0, 1), (0, 2), (1, 3), (2, 3)):
            put(square[i], square[j], mixed)
        put(square[0], square[3], -mixed)
        put(square[1], square[2], -mixed)
    shape = (lattice.cells, lattice.cells)
    between = coo_array(
        (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=shape
    ).tocsr()
    diagonal = np.arange(lattice.cells)
    own = coo_array((-np.asarray(between.sum(axis=1)).ravel(), (diagonal, diagonal)), shape=shape)
    return (between + own.tocsr()).tocsr()


def courant_number(matrix: csr_array, volume: np.ndarray) -> float:
    """c T / h of the largest stable time step, for A with the inertances of layers as `matrix`.

    By Lanczos' iteration; never below what Gershgorin's circles prove. Rounded down, so that nothing depends on
    the order in which a machine adds.
    """
    root = 1.0 / np.sqrt(volume)
    v = np.random.default_rng(0).standard_normal(len(volume))
    v /= np.sqrt(np.einsum("i,i", v, v))
    before, alpha, beta = np.zeros_like(v), [], [0.0]
    for _ in range(min(_ITERATIONS, len(v))):
        w = root * (matrix @ (root * v)) - beta[-1] * before
        alpha.append(float(np.einsum("i,i", w, v)))
        w -= alpha[-1] * v
        beta.append(float(np.sqrt(np.einsum("i,i", w, w))))
        if not beta[-1] > 1e-12:
            break
        before, v = v, w / beta[-1]
    off = beta[1 : len(alpha)]
    found = float(np.linalg.eigvalsh(np.diag(alpha) + np.diag(off, 1) + np.diag(off, -1))[-1])
    proven = float((np.asarray(abs(matrix).sum(axis=1)) / volume).max())
    squared = min(4.0 / max(min(_MARGIN * found, proven), 1e-9), _MOST_COURANT2)
    return float(np.sqrt(np.floor(squared * _STEPS_OF_COURANT) / _STEPS_OF_COURANT))
