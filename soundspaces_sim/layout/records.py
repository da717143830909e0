"""Records of the layout: grids, navigation graphs, floor plans.

Readers of datasets need these without the tracer, so nothing here imports what makes them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.core.svg import BLACK, BLUE, GREY, Dots, Lines, html, svg

if TYPE_CHECKING:
    import networkx

    from soundspaces_sim.scene.storeys import Storeys

_BELOW = 0.2  # m, a step: floors of a storey begin that far below its level
KEPT, OUTSIDE, TOO_CLOSE, UNREACHABLE, NO_STANDING = range(5)  # what became of a grid's candidate


@dataclass(frozen=True)
class Grid:
    """Points that survived, and what became of every candidate.

    `points` (N, 3) m, `height` above the floor of their `storey` (N,) (row of `floors` (K,) m);
    `candidates` (M, 3) m with `status` (M,) KEPT, OUTSIDE, TOO_CLOSE, UNREACHABLE or NO_STANDING, `closedness` (M,)
    and `clearance` (M,) m. `storeys`: what is known of the floors, if they were looked for.
    """

    points: np.ndarray
    spacing: float
    height: float
    floors: np.ndarray
    storey: np.ndarray
    candidates: np.ndarray
    status: np.ndarray
    closedness: np.ndarray
    clearance: np.ndarray
    storeys: Storeys | None = None

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        pruned = ", ".join(
            f"{(self.status == status).sum()} {why}"
            for status, why in (
                (OUTSIDE, "outside"),
                (TOO_CLOSE, "too close to a surface"),
                (NO_STANDING, "where nobody can stand"),
            )
            if status != NO_STANDING or (self.status == status).any()
        )
        return (
            f"Grid: {len(self):,} points, {self.spacing:g} m apart, {self.height:g} m above "
            f"{len(self.floors)} floor{'s' * (len(self.floors) != 1)}; pruned of "
            f"{len(self.candidates):,} candidates: {pruned}"
        )

    def _repr_html_(self) -> str:
        pruned = self.candidates[self.status != KEPT, :2]
        return html(repr(self), svg([Dots(pruned, GREY, 1.0), Dots(self.points[:, :2], BLUE)]))


@dataclass(frozen=True)
class WalkGraph:
    """`nodes` (K,) and `edges` (E, 2): rows of the grid's points. `component` (N,): connected component
    of each point, the largest first, -1 for points that are no nodes. `geodesic` (N, N) float32 m:
    walking distance, inf where there is no way.
    """

    nodes: np.ndarray
    edges: np.ndarray
    component: np.ndarray
    geodesic: np.ndarray

    def __repr__(self) -> str:
        pieces = len(np.unique(self.component[self.component >= 0]))
        return f"WalkGraph: {len(self.nodes):,} nodes, {len(self.edges):,} edges, {pieces} components"


def to_networkx(graph: WalkGraph, points: np.ndarray) -> networkx.Graph:
    """Nodes are rows of `points` (N, 3) with attribute `point` (m); edges have `length` (m)."""
    import networkx

    out = networkx.Graph()
    for n in graph.nodes:
        out.add_node(int(n), point=tuple(float(x) for x in points[n]))
    for a, b in graph.edges:
        out.add_edge(int(a), int(b), length=float(np.linalg.norm(points[a] - points[b])))
    return out


@dataclass(frozen=True)
class FloorPlan:
    """`walls`: per storey (n, 4) m, x0 y0 x1 y1 of what the mesh leaves at listener height. `furniture`: (storeys,
    nx, ny) row of `labels` seen from there, looking down, -1 for none; cell (i, j) begins at `origin` + `cell` *
    (i, j). `heights`: (storeys,) m, of points above the level of each storey; None in files from before these were
    stored.
    """

    walls: tuple[np.ndarray, ...]
    furniture: np.ndarray
    labels: tuple[str, ...]
    origin: np.ndarray
    cell: float = 0.05
    heights: np.ndarray | None = None

    def __repr__(self) -> str:
        lines = ", ".join(str(len(w)) for w in self.walls)
        storeys = f"{len(self.walls)} storey{'s' * (len(self.walls) != 1)}"
        return f"FloorPlan: {storeys} ({lines} wall segments), cells of {self.cell:g} m"

    def _repr_html_(self) -> str:
        return html(repr(self), svg([Lines(self.walls[0], BLACK)]) if self.walls else "")


def storeys_of(plan: FloorPlan, points: np.ndarray) -> np.ndarray:
    """(N,) the storey of a plan to which points (N, 3) m belong."""
    heights = np.unique(np.round(points[:, 2], 3)) if plan.heights is None else plan.heights
    found = np.searchsorted(heights - _BELOW, points[:, 2], "right") - 1
    return np.clip(found, 0, max(len(plan.walls) - 1, 0))
