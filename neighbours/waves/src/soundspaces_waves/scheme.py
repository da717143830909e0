"""A scene as a scheme: lattice, time step, stencil, walls and layers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim import MaterialTable, Scene
from soundspaces_waves.boundaries import LayerLinks, WallLinks, find_boundaries
from soundspaces_waves.branches import WallBranches, wall_branches
from soundspaces_waves.lattice import Lattice, cast_links, make_lattice
from soundspaces_waves.operator import courant_number, cut_cells, stiffness_matrix
from soundspaces_waves.row_algebra import FOUR
from soundspaces_waves.stepping import Layers, Scheme, Sealed, Stencil, Walls


@dataclass(frozen=True)
class WaveScene:
    """What depends on a scene and the lattice alone."""

    scene: Scene
    lattice: Lattice
    c: float  # m/s
    step: float  # s
    volume: np.ndarray  # (cells,) over h³
    matrix: csr_array  # (cells, cells) A
    component: np.ndarray  # (cells,) which of the separate airs a cell belongs to
    walls: WallLinks
    layers: LayerLinks
    branches: WallBranches

    @property
    def courant(self) -> float:
        """c T / h."""
        return self.c * self.step / self.lattice.spacing

    def scheme(self, components: np.ndarray) -> Scheme:
        """The time loop's form of some of the airs."""
        inside = np.isin(self.component, components)
        return Scheme(
            _stencil(self.matrix, self.courant**2 / self.volume, np.flatnonzero(inside)),
            self._walls(inside),
            self._layers(inside),
            self._sealed(components),
        )

    def _walls(self, inside: np.ndarray) -> Walls:
        links = WallLinks(*(column[inside[self.walls.cell]] for column in self.walls))
        gain = 1.0 / (
            links.resistance + 2.0 * links.mass / self.step + 0.5 * links.stiffness * self.step
        )
        share = self.courant * links.area / self.volume[links.cell]
        cell, start = np.unique(links.cell, return_index=True)
        pull = np.add.reduceat(share * gain, start) if len(start) else np.empty(0)
        return Walls(
            cell,
            np.append(start, len(links.cell)),
            1.0 / (1.0 + 0.5 * pull),
            share,
            gain,
            4.0 * links.mass / self.step,
            links.stiffness * self.step,
        )

    def _layers(self, inside: np.ndarray) -> Layers:
        links = LayerLinks(*(column[inside[self.layers.near]] for column in self.layers))
        share = (
            self.courant * links.area[:, None] / self.volume[np.stack([links.near, links.far], axis=1)]
        )
        gain = 1.0 / (links.mass / self.step + 0.5 * links.resistance)
        return Layers(links.near, links.far, share, gain, links.resistance)

    def _sealed(self, components: np.ndarray) -> Sealed:
        leaks = self.component[self.walls.cell[self.walls.stiffness == 0.0]]
        tight = np.setdiff1d(components, leaks)
        inside = np.isin(self.component, tight)
        air = np.where(inside, np.searchsorted(tight, self.component), -1)
        whole = np.bincount(air[inside], self.volume[inside], len(tight))
        return Sealed(air, self.volume, whole)


def make_wave_scene(
    scene: Scene, edge: float, cells_per_wavelength: float, c: float, reactance: float = 0.0
) -> WaveScene:
    """A scheme for frequencies up to `edge`, Hz, with so many cells per wavelength there.

    Raises `SimulationError` for a lattice that is too large, `ConfigError` for one that memory does not hold.
    """
    lattice = make_lattice(scene, c / (edge * cells_per_wavelength))
    branches = wall_branches(scene.materials, edge, reactance)
    crossings = cast_links(scene.geometry, lattice)
    layer = ~np.isnan(branches.resistance)[scene.face_material]
    cut = cut_cells(scene, lattice, crossings, layer, 2.0 * np.pi / cells_per_wavelength)
    walls, layers = find_boundaries(scene, lattice, cut, crossings, branches, c)
    matrix = stiffness_matrix(lattice, cut)
    between = _between_layers(lattice, layers, c)
    courant = courant_number((matrix + between).tocsr(), cut.volume)
    between_cells = _graph(matrix, lattice, cut.clear) + abs(between)
    _, component = connected_components(between_cells, directed=False)
    return WaveScene(
        scene,
        lattice,
        c,
        courant * lattice.spacing / c,
        cut.volume,
        matrix,
        component,
        walls,
        layers,
        branches,
    )


def table_misfit(table: MaterialTable, branches: WallBranches, used: np.ndarray) -> tuple[str, float]:
    """Name and misfit of that wall's material in use whose branch is farthest from the table's absorption."""
    walls = [m for m in np.unique(used).tolist() if np.isnan(branches.resistance[m])]
    if not walls:
        return "", 0.0
    worst = max(walls, key=lambda m: branches.wall[m].misfit)
    return table.names[worst], branches.wall[worst].misfit


def _graph(matrix: csr_array, lattice: Lattice, clear: tuple[np.ndarray, ...]) -> csr_array:
    """Open links alone: squares connect no cells that these do not."""
    near = np.concatenate(clear)
    far = np.concatenate([at + stride for at, stride in zip(clear, lattice.strides, strict=True)])
    return coo_array((np.ones(len(near)), (near, far)), shape=matrix.shape).tocsr()


def _between_layers(lattice: Lattice, layers: LayerLinks, c: float) -> csr_array:
    """What layers without resistance would add to A."""
    weight = layers.area * lattice.spacing / (c * layers.mass)
    i, j = layers.near, layers.far
    data = np.concatenate([weight, weight, -weight, -weight])
    rows, columns = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
    return coo_array((data, (rows, columns)), shape=(lattice.cells, lattice.cells)).tocsr()


def _stencil(matrix: csr_array, factor: np.ndarray, cells: np.ndarray) -> Stencil:
    """Rows of -factor A without the diagonal, each kind of row once."""
    part = matrix[cells].tocoo()
    row, column = part.coords
    keep = (column != cells[row]) & (part.data != 0.0)
    row, column = row[keep], column[keep]
    order = np.lexsort((column, row))
    row, column = row[order], column[order]
    weight = (-part.data[keep][order] * factor[cells[row]]).astype(np.float32)
    offset = (column - cells[row]).astype(np.int32)
    start = np.searchsorted(row, np.arange(len(cells) + 1))
    width = int(np.diff(start).max(initial=0))
    padded = np.zeros((len(cells), 2, width), np.int32)
    place = np.arange(len(row)) - start[row]
    padded[row, 0, place], padded[row, 1, place] = offset, weight.view(np.int32)
    records = padded.reshape(len(cells), -1)
    _, first, kind = np.unique(
        records.view([("", records.dtype)] * records.shape[1]).ravel()
        if width
        else np.zeros(len(cells)),
        return_index=True,
        return_inverse=True,
    )
    spans = [np.arange(start[i], start[i + 1]) for i in first]
    taken = np.concatenate(spans) if spans else np.empty(0, int)
    ends = np.concatenate([[0], np.cumsum([len(s) for s in spans])]).astype(int)
    kind = kind.ravel()
    return Stencil(cells, kind, _alike(cells, kind), ends, offset[taken], weight[taken])


def _alike(cells: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """(n,) whether a cell and those after it, four in all, are of one kind and follow each other."""
    next_to = (np.diff(cells) == 1) & (np.diff(kind) == 0)
    out = np.zeros(len(cells), np.bool_)
    if len(cells) >= FOUR:
        out[: len(cells) - FOUR + 1] = np.lib.stride_tricks.sliding_window_view(next_to, FOUR - 1).all(
            axis=1
        )
    return out
