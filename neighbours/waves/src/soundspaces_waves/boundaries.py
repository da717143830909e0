"""Walls, openings and layers on the lattice's links, in the form that the time loop takes.

A wall's area on a link is that of the cell across it, times |n|: over the stairs of an oblique wall that sums to
its true area (the sum of n² is 1), if two things are seen to. Sides that end at the same wall count with their
mean, one half: where a wall is met along an axis and along another, in which its normal has more weight, it is
always the nearer half of that cell. And where walls meet in an edge, lines of links pass through air shorter
than a cell, and no link meets the walls unless a centre lies in between, which happens in as many of all places
of the lattice as the air is long over h: a wall that is met stands for one over that (Horvitz & Thompson 1952).
Walls that face each other across a gap are met or missed as a whole.

A wall's branch has the mass of the air between it and the cell's centre in series, which makes the scheme of
second order there. An opening is the impedance of air. A limp wall is a mass between the two cells, and either
of its faces absorbs; a layer that hangs free is a resistance between them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim import Scene
from soundspaces_waves.branches import Branch, WallBranches
from soundspaces_waves.lattice import AXES, DIRECTIONS, Crossings, Lattice
from soundspaces_waves.operator import LEAST_EXTENT, Cut, link_area, outside

_OPENING = Branch(1.0, 0.0, 0.0)
_PARALLEL = 0.999  # cosine from which walls are taken for parallel


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
    scene: Scene,
    lattice: Lattice,
    cut: Cut,
    crossings: Crossings,
    branches: WallBranches,
    c: float,
) -> tuple[WallLinks, LayerLinks]:
    """`c`: speed of sound, m/s."""
    cell, side = np.nonzero(cut.blocked)
    row = _rows(scene.face_material, crossings.triangle[cell, side])
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
        wall_area(scene, cut, crossings, cell[absorbs], side[absorbs]),
        values[absorbs, 0],
        (values[:, 1] + air)[absorbs],
        values[absorbs, 2],
    )
    forward = across & (side < AXES)
    return walls, _layers(lattice, cut, cell[forward], side[forward], row[forward], branches, c)


def _rows(material: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Materials of triangles, -1 for none."""
    return np.where(triangle >= 0, material[triangle], -1)


def wall_area(
    scene: Scene, cut: Cut, crossings: Crossings, cell: np.ndarray, side: np.ndarray
) -> np.ndarray:
    """(n,) over h², of walls on links (n,) out of `cell` on `side`."""
    links, opposite = np.arange(len(cell)), (side + AXES) % (2 * AXES)
    alike = _alike(scene, crossings.triangle[cell], side)
    sides = np.where(alike > _PARALLEL, 0.5, cut.sides[cell])
    extent = np.maximum(sides[:, :AXES] + sides[:, AXES:], LEAST_EXTENT)
    extent[links, side % AXES] = 1.0
    air = crossings.distance[cell, side] + crossings.distance[cell, opposite]
    met = np.where(alike[links, opposite] < -_PARALLEL, 1.0, np.clip(air, LEAST_EXTENT, 1.0))
    return np.asarray(cut.along[cell, side] * extent.prod(axis=1) / met)


def _alike(scene: Scene, triangle: np.ndarray, side: np.ndarray) -> np.ndarray:
    """(n, 6) cosines between the normals of what ends cells' six links, `triangle` (n, 6), and of what ends that on
    `side` (n,); normals point out of the cell. 0 where there is nothing."""
    normal = scene.normals[triangle]
    outward = np.einsum("nsa,sa->ns", normal, DIRECTIONS)
    normal = np.where(triangle >= 0, np.sign(outward), 0.0)[:, :, None] * normal
    return np.asarray(np.einsum("nsa,na->ns", normal, normal[np.arange(len(side)), side]))


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
