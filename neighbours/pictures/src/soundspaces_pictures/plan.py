"""Floor plans: walls, furniture, grid points and the navigation graph."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap

from soundspaces_sim import Grid
from soundspaces_sim.parts import (
    POINT_KEPT as KEPT,
    POINT_NO_STANDING as NO_STANDING,
    POINT_OUTSIDE as OUTSIDE,
    POINT_TOO_CLOSE as TOO_CLOSE,
    POINT_UNREACHABLE as UNREACHABLE,
    FloorPlan,
    storeys_of,
)

FURNITURE_NAME = "name of furniture"  # `printed` leaves those out that have no room
BLUE, ORANGE, VERMILION, GREEN, GREY = "#0072B2", "#E69F00", "#D55E00", "#009E73", "#777777"
_FURNITURE = ["#d9c8ae", "#c5d3c1", "#cfc4d8", "#d8cfc0", "#bfcbd6", "#dcc3bd", "#c9c9b4", "#d0d0d0"]


def draw_plan(ax: Axes, plan: FloorPlan, storey: int = 0, furniture: bool = True) -> None:
    """Walls as lines, furniture shaded by label; axes in m, to scale."""
    if furniture and (plan.furniture[storey] >= 0).any():
        nx, ny = plan.furniture[storey].shape
        shade = np.ma.masked_less(plan.furniture[storey].T, 0) % len(_FURNITURE)
        x0, y0 = plan.origin
        ax.imshow(
            shade,
            origin="lower",
            cmap=ListedColormap(_FURNITURE),
            vmin=-0.5,
            vmax=len(_FURNITURE) - 0.5,
            extent=(x0, x0 + nx * plan.cell, y0, y0 + ny * plan.cell),
            interpolation="nearest",
            zorder=0,
        )
    segments = plan.walls[storey].reshape(-1, 2, 2)
    ax.add_collection(LineCollection(list(segments), colors="black", linewidths=0.9, zorder=3))
    points = segments.reshape(-1, 2)
    if len(points):
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        ax.set_xlim(x0 - 0.3, x1 + 0.3)
        ax.set_ylim(y0 - 0.3, y1 + 0.3)
    ax.set_aspect("equal")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")


def label_furniture(ax: Axes, plan: FloorPlan, storey: int = 0, least: float = 0.6) -> None:
    """Names on pieces of furniture that cover `least` m² or more."""
    from scipy import ndimage

    x_limits, y_limits = ax.get_xlim(), ax.get_ylim()
    for row in np.unique(plan.furniture[storey]):
        if row < 0:
            continue
        pieces, count = ndimage.label(plan.furniture[storey] == row)
        for piece in range(1, count + 1):
            i, j = np.nonzero(pieces == piece)
            x, y = plan.origin + plan.cell * (np.array([i.mean(), j.mean()]) + 0.5)
            shown = x_limits[0] <= x <= x_limits[1] and y_limits[0] <= y <= y_limits[1]
            if shown and len(i) * plan.cell**2 >= least:  # far from the picture, letters cannot be drawn
                ax.text(
                    x,
                    y,
                    plan.labels[row],
                    fontsize=6,
                    ha="center",
                    va="center",
                    color="#4a4033",
                    zorder=4,
                    gid=FURNITURE_NAME,
                )


def draw_map(
    ax: Axes,
    plan: FloorPlan,
    grid: Grid | None,
    points: np.ndarray,
    edges: np.ndarray,
    nodes: np.ndarray,
    storey: int = 0,
) -> None:
    """Plan, `points` (N, 3), those of one storey drawn, `edges` (E, 2) and `nodes` of the navigation graph,
    and, with a `grid`, the candidates that were pruned, by reason."""
    draw_plan(ax, plan, storey)
    label_furniture(ax, plan, storey)
    here = storeys_of(plan, points) == storey
    if grid is not None:
        level = storeys_of(plan, grid.candidates) == storey
        for status, marker, colour, name in (
            (OUTSIDE, "x", VERMILION, "pruned: outside (closed-ness)"),
            (TOO_CLOSE, "+", ORANGE, "pruned: too close to a surface"),
            (UNREACHABLE, "1", GREY, "pruned: inside something solid"),
            (NO_STANDING, "2", GREY, "pruned: no place to stand"),
        ):
            pruned = grid.candidates[level & (grid.status == status)]
            if len(pruned):
                ax.plot(
                    pruned[:, 0], pruned[:, 1], marker, color=colour, ms=4, ls="", label=name, zorder=5
                )
        assert KEPT == 0
    walk = edges[here[edges].all(axis=1)] if len(edges) else edges
    ax.add_collection(
        LineCollection(list(points[walk][:, :, :2]), colors=BLUE, linewidths=0.8, zorder=4)
    )
    is_node = np.zeros(len(points), bool)
    is_node[nodes] = True
    for mask, face, name in (
        (is_node, BLUE, "point, can be walked to"),
        (~is_node, "white", "point, no place to stand"),
    ):
        chosen = points[mask & here]
        if len(chosen):
            ax.plot(
                chosen[:, 0],
                chosen[:, 1],
                "o",
                ms=3.5,
                mfc=face,
                mec=BLUE,
                mew=0.8,
                ls="",
                label=name,
                zorder=6,
            )
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=2, fontsize=8, frameon=False)
