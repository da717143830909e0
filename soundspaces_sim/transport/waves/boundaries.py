"""Walls, openings and layers on the lattice's links, in the form that the time loop takes.

A wall's branch has the mass of the air between it and the cell's centre in series, which makes the scheme of
second order there. An opening is the impedance of air. A limp wall is a mass between the two cells, and either
of its faces absorbs; a layer that hangs free is a resistance between them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.transport.waves.branches import Branch, WallBranches
from soundspaces_sim.transport.waves.lattice import AXES, Crossings, Lattice
from soundspaces_sim.transport.waves.operator import Cut, link_area, outside

_OPENING = Branch(1.0, 0.0, 0.0)


class WallLinks(NamedTuple):
    """Blocked links that absorb, in the order of their cells."""

    cell: np.ndarray  # (b,)
    area: np.ndarray  # (b,) over h²
    resistance: np.ndarray  # (b,)
    mass: np.ndarray  # (b,) s, with that of the air before the wall
    stiffness: np.ndarray  # (b,) 1/s


class LayerLinks(NamedTuple):
    """Links through layers and limp walls."""

    near: np.ndarray  # (n,)
    far: np.ndarray  # (n,)
    area: np.ndarray  # (n,) over h²
    resistance: np.ndarray  # (n,)
    mass: np.ndarray  # (n,) s, with that of the air


def find_boundaries(
    lattice: Lattice,
    cut: Cut,
    crossings: Crossings,
    material: np.ndarray,
    branches: WallBranches,
    c: float,
) -> tuple[WallLinks, LayerLinks]:
    """`material`: (F,) of the faces; `c`: speed of sound, m/s."""
    cell, side = np.nonzero(cut.blocked)
    row = _rows(material, crossings.triangle[cell, side])
    beyond = outside(lattice)[cell, side]
    hangs = (row >= 0) & ~np.isnan(branches.resistance)[row]
    limp = (row >= 0) & np.isfinite(branches.mass)[row] & ~hangs
    across = ~beyond & (hangs | limp)

    kinds = [
        *branches.wall,
        *branches.face,
        _OPENING,
        *(Branch(r + 1.0, 0.0, 0.0) for r in branches.resistance),
    ]
    count = len(branches.wall)
    kind = np.where(row < 0, 2 * count, np.where(limp & ~beyond, count, 0) + np.maximum(row, 0))
    kind = np.where(hangs, 2 * count + 1 + row, kind)
    values = np.array([[b.resistance, b.mass, b.stiffness] for b in kinds])[kind]
    absorbs = np.isfinite(values[:, 0]) & ~(hangs & ~beyond)
    distance = np.where(row >= 0, np.minimum(crossings.distance[cell, side], 1.0), 0.5)
    air = distance * cut.along[cell, side] * lattice.spacing / c
    walls = WallLinks(
        cell[absorbs],
        _wall_area(cut, cell, side)[absorbs],
        values[absorbs, 0],
        (values[:, 1] + air)[absorbs],
        values[absorbs, 2],
    )
    forward = across & (side < AXES)
    return walls, _layers(lattice, cut, cell[forward], side[forward], row[forward], branches, c)


def _rows(material: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Materials of triangles, -1 for none."""
    return np.where(triangle >= 0, material[triangle], -1)


def _wall_area(cut: Cut, cell: np.ndarray, side: np.ndarray) -> np.ndarray:
    extent = cut.extent[cell]
    rows = np.arange(len(cell))
    return np.asarray(cut.along[cell, side] * extent.prod(axis=1) / extent[rows, side % AXES])


def _layers(
    lattice: Lattice,
    cut: Cut,
    near: np.ndarray,
    axis: np.ndarray,
    row: np.ndarray,
    branches: WallBranches,
    c: float,
) -> LayerLinks:
    far = near + np.array(lattice.strides)[axis]
    area = np.empty(len(near))
    for d in range(AXES):
        area[axis == d] = link_area(cut, near[axis == d], far[axis == d], d)
    along = cut.along[near, axis]
    hangs = ~np.isnan(branches.resistance)[row]
    resistance = np.where(hangs, np.nan_to_num(branches.resistance)[row] * along, 0.0)
    mass = lattice.spacing / c + np.where(hangs, 0.0, branches.mass[row])
    return LayerLinks(near, far, area * np.where(hangs, 1.0, along), resistance, mass)
