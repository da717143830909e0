"""The navigation graph: grid points at which an agent can stand, and the walks between them.

A point is a node if an agent can stand on the floor below it. Two nodes share an edge if
and only if they are neighbours on the grid and the straight walk between them is free. Geodesic
distances also use straight walks to nodes further away and, where the grid is too coarse for a door or a
stair, walks over the floor's cells between neighbouring nodes; they exceed the true ones by up to 1.3 %
in the open (32 directions), and by up to 8 % along walks over cells (8 directions).
"""

from __future__ import annotations

from dataclasses import replace
from math import gcd

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra, shortest_path

from soundspaces_sim.core.config import GraphConfig
from soundspaces_sim.core.errors import ConfigError, SceneError
from soundspaces_sim.layout.records import KEPT, NO_STANDING, Grid, WalkGraph
from soundspaces_sim.scene.scene import Scene, check_scene
from soundspaces_sim.scene.walkable import Columns, find_floors, neighbours, stand_at, walk_straight

MOST_POINTS = 30_000  # whose table of distances takes 3.6 GB
_REACH = 3  # grid steps of straight walks that serve distances


def make_graph(scene: Scene, grid: Grid, config: GraphConfig | None = None) -> WalkGraph:
    """The navigation graph of a grid's points. Scenes without a floor give a graph without nodes."""
    check_scene(scene)
    config = config or GraphConfig()
    if len(grid.points) > MOST_POINTS:
        raise ConfigError(
            f"grid.spacing: {len(grid.points):,} points, where {MOST_POINTS:,} are the most for which distances "
            "between all pairs are kept; take a larger spacing (--spacing)"
        )
    columns = find_floors(scene.corners, config.cell, config.height, config.radius, config.step)
    count = len(grid.points)
    ground = grid.points - np.array([0.0, 0.0, 1.0]) * grid.height
    row = stand_at(columns, ground, config.step)
    nodes = np.flatnonzero(row >= 0)

    lattice = np.rint((ground - ground.min(axis=0)) / grid.spacing).astype(np.int64) if count else ground
    near: dict[tuple[int, int], list[int]] = {}
    for n in nodes.tolist():
        near.setdefault((int(lattice[n, 0]), int(lattice[n, 1])), []).append(n)
    steps = [
        (i, j)
        for i in range(_REACH + 1)
        for j in range(-_REACH, _REACH + 1)
        if gcd(i, j) == 1 and (i > 0 or j > 0)
    ]
    pairs = np.array(
        [
            (n, other)
            for n in nodes.tolist()
            for di, dj in steps
            for other in near.get((int(lattice[n, 0]) + di, int(lattice[n, 1]) + dj), ())
        ],
        np.int64,
    ).reshape(-1, 2)
    length = walk_straight(columns, ground, pairs, config.step)
    apart = np.abs(lattice[pairs[:, 0], :2] - lattice[pairs[:, 1], :2]).sum(axis=1) if count else length
    free = np.isfinite(length)
    edges = pairs[free & (apart == 1)]
    over_cells, cell_length = _walks_over_cells(columns, row, nodes, config.step)
    # Cells are counted from centre to centre: no way is shorter than the straight one.
    straight = np.linalg.norm(ground[over_cells[:, 0]] - ground[over_cells[:, 1]], axis=1)
    cell_length = np.maximum(cell_length, straight)
    geodesic = _distances(
        count,
        nodes,
        np.concatenate([pairs[free], over_cells]),
        np.concatenate([length[free], cell_length]),
    )
    return WalkGraph(nodes, edges, _components(count, nodes, edges), geodesic)


def only_standing(scene: Scene, grid: Grid, graph: WalkGraph) -> tuple[Grid, WalkGraph]:
    """Grid and graph of the nodes alone. Raises `SceneError` if there is none."""
    nodes = graph.nodes
    if len(nodes) == 0:
        raise SceneError(
            f"{scene.name}: an agent can stand at none of the {len(grid)} grid points; check the scene's floor "
            "(`soundspaces-sim inspect`), or set grid.standing = false"
        )
    status = grid.status.copy()
    dropped = np.ones(len(grid), bool)
    dropped[nodes] = False
    status[np.flatnonzero(status == KEPT)[dropped]] = NO_STANDING
    row = np.full(len(grid), -1)
    row[nodes] = np.arange(len(nodes))
    kept = replace(
        grid,
        points=np.ascontiguousarray(grid.points[nodes]),
        storey=grid.storey[nodes],
        status=status,
    )
    return kept, WalkGraph(
        row[nodes],
        row[graph.edges].reshape(-1, 2),
        graph.component[nodes],
        np.ascontiguousarray(graph.geodesic[np.ix_(nodes, nodes)]),
    )


def _walks_over_cells(
    columns: Columns, row: np.ndarray, nodes: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Walks between nodes whose cells (those nearest to them on foot) meet: (P, 2) points, (P,) m."""
    none = np.empty((0, 2), np.int64), np.empty(0)
    links, length = neighbours(columns, step)
    if len(nodes) < 2 or len(links) == 0:
        return none
    size = len(columns.floor)
    matrix = coo_array((length, (links[:, 0], links[:, 1])), shape=(size, size)).tocsr()
    rows, first = np.unique(row[nodes], return_index=True)
    distance, before, source = dijkstra(
        matrix, directed=False, indices=rows, min_only=True, return_predecessors=True
    )
    del matrix, before
    owner = np.full(size, -1, np.int32)
    owner[rows] = nodes[first]
    of_cell = np.where(source >= 0, owner[np.maximum(source, 0)], -1)
    a, b = of_cell[links[:, 0]], of_cell[links[:, 1]]
    meet = (a >= 0) & (b >= 0) & (a != b)
    total = distance[links[meet, 0]] + length[meet] + distance[links[meet, 1]]
    ends = np.sort(np.stack([a[meet], b[meet]], axis=1), axis=1).astype(np.int64)
    order = np.argsort(total, kind="stable")
    unique, best = np.unique(ends[order], axis=0, return_index=True)
    return unique, total[order][best]


def _distances(count: int, nodes: np.ndarray, pairs: np.ndarray, length: np.ndarray) -> np.ndarray:
    out = np.full((count, count), np.inf, np.float32)
    if len(nodes) == 0:
        return out
    order = np.argsort(length, kind="stable")  # of two ways between the same points, the shorter
    unique, best = np.unique(pairs[order], axis=0, return_index=True)
    matrix = coo_array((length[order][best], (unique[:, 0], unique[:, 1])), shape=(count, count)).tocsr()
    out[nodes] = shortest_path(matrix, directed=False, indices=nodes)
    return out


def _components(count: int, nodes: np.ndarray, edges: np.ndarray) -> np.ndarray:
    component = np.full(count, -1)
    if len(nodes) == 0:
        return component
    matrix = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsr()
    label = connected_components(matrix, directed=False)[1][nodes]
    names, first, sizes = np.unique(label, return_index=True, return_counts=True)
    rank = np.empty(names.max() + 1, np.int64)
    rank[names[np.lexsort((first, -sizes))]] = np.arange(len(names))
    component[nodes] = rank[label]
    return component
