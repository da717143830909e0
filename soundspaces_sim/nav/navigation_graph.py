"""The navigation graph of a dataset: nodes where an agent can stand, headings, and the effect of each action.

Conventions: a state is 4 * node + k, the agent at row `node` of the dataset's points facing `HEADINGS[k]`
degrees counter-clockwise from +X. Distance is that of SoundSpaces' code: edges on a shortest path times the
grid's spacing, not the geodesic of the table of pairs, which cuts corners.
"""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import shortest_path

from soundspaces_sim.core.errors import DatasetError, PointError
from soundspaces_sim.dataset.reader import RirDataset

HEADINGS = (0, 90, 180, 270)
STOP, FORWARD, LEFT, RIGHT = range(4)
ACTIONS = ("STOP", "FORWARD", "LEFT", "RIGHT")
_TOLERANCE = 5.0  # degrees between an edge and its heading
_TURNS = np.array([[0, 1, 2, 1], [1, 0, 1, 2], [2, 1, 0, 1], [1, 2, 1, 0]])  # quarter turns from k to j


class NavigationGraph:
    """`scene`; `points` (N, 3) m; `nodes` (K,) points on which an agent can stand; `neighbour` (N, 4): the
    point reached by a step in each heading, -1 for none; `hops` (N, N): edges on a shortest path, -1 where
    there is none; `moves` (4N, 4): the state after each action.

    Raises `DatasetError` if the dataset has no navigation graph, or one whose edges do not lie along headings.
    """

    def __init__(self, ds: RirDataset) -> None:
        manifest = ds.manifest
        self.scene = ds.scene
        self.points = ds.points
        self.spacing = float(manifest.config.grid.spacing)
        self.height = float(manifest.config.grid.height)
        self.nodes = np.array(manifest.nodes, np.int64)
        if len(self.nodes) == 0:
            raise DatasetError(
                f"{ds.path}: an agent can stand on none of the {len(ds.points)} points; agents need a dataset "
                "of a scene with a floor (see `soundspaces-sim inspect`)"
            )
        edges = np.array(manifest.edges, np.int64).reshape(-1, 2)
        self.neighbour = _neighbours(ds.points, edges, str(ds.path))
        self.moves = _moves(self.neighbour)
        self._actions = lru_cache(maxsize=512)(self._actions_to)
        for array in (self.nodes, self.neighbour, self.moves):
            array.setflags(write=False)

    @cached_property
    def hops(self) -> np.ndarray:
        """(N, N) edges on a shortest path between points, -1 where there is none."""
        n = len(self.points)
        a, k = np.nonzero(self.neighbour >= 0)
        matrix = coo_array((np.ones(len(a)), (a, self.neighbour[a, k])), shape=(n, n)).tocsr()
        length = shortest_path(matrix, unweighted=True)
        return np.where(np.isfinite(length), length, -1).astype(np.int32)

    def distance(self, a: int, b: int) -> float:
        """Walking distance between two points, m; inf where there is no way."""
        hops = int(self.hops[a, b])
        return hops * self.spacing if hops >= 0 else float("inf")

    def actions_to(self, goal: int) -> np.ndarray:
        """(4N,) fewest actions from each state along a shortest path to `goal`, STOP included; -1 for none."""
        return self._actions(int(goal))

    def _actions_to(self, goal: int) -> np.ndarray:
        """Of all shortest paths the one with the fewest turns, by growing distance from the goal."""
        far = self.hops[:, goal]
        cost = np.full((len(far), 4), np.inf)
        cost[goal] = 1.0
        for h in range(1, int(far.max()) + 1):
            rows = np.flatnonzero(far == h)
            ahead = self.neighbour[rows]
            nearer = (ahead >= 0) & (far[ahead] == h - 1)
            step = np.where(nearer, 1.0 + cost[ahead, np.arange(4)], np.inf)
            cost[rows] = (step[:, None, :] + _TURNS[None]).min(axis=2)
        out = np.where(np.isfinite(cost), cost, -1.0).astype(np.int64).ravel()
        out.setflags(write=False)
        return out


def heading_index(heading_deg: float, what: str = "heading") -> int:
    """k of a heading in degrees. Raises `PointError` unless it is a multiple of 90."""
    turns = heading_deg / 90.0
    if not np.isfinite(turns) or abs(turns - round(turns)) > 0.005:
        raise PointError(
            f"{what}: expected a multiple of 90 degrees, got {heading_deg:g}; agents face along the grid"
        )
    return round(turns) % 4


def _neighbours(points: np.ndarray, edges: np.ndarray, where: str) -> np.ndarray:
    out = np.full((len(points), 4), -1, np.int64)
    both = np.concatenate([edges, edges[:, ::-1]])
    offset = points[both[:, 1]] - points[both[:, 0]]
    angle = np.rad2deg(np.arctan2(offset[:, 1], offset[:, 0]))
    k = np.rint(angle / 90.0).astype(np.int64)
    off = np.abs(angle - 90.0 * k)
    if len(off) and off.max() > _TOLERANCE:
        a, b = both[off.argmax()]
        raise DatasetError(
            f"{where}: the walk from point {a} to {b} lies {off.max():.1f} degrees off the nearest of the "
            f"headings 0, 90, 180, 270; agents walk on square grids along x and y (at most {_TOLERANCE:g} off)"
        )
    for (a, b), heading in zip(both, k % 4, strict=True):
        if out[a, heading] not in (-1, b):
            raise DatasetError(
                f"{where}: points {out[a, heading]} and {b} both lie in heading {90 * heading} of point {a}; "
                "agents need a grid with one neighbour in each heading"
            )
        out[a, heading] = b
    return out


def _moves(neighbour: np.ndarray) -> np.ndarray:
    """(4N, 4) state after each action; a step without a neighbour stays."""
    n = len(neighbour)
    node, k = np.repeat(np.arange(n), 4), np.tile(np.arange(4), n)
    ahead = neighbour[node, k]
    stay = 4 * node + k
    forward = np.where(ahead >= 0, 4 * ahead + k, stay)
    return np.stack([stay, forward, 4 * node + (k + 1) % 4, 4 * node + (k - 1) % 4], axis=1)
