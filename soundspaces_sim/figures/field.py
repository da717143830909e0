"""The pressure field of a source: levels at listeners, spread over the free space around each."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from soundspaces_sim.figures.plan import draw_plan
from soundspaces_sim.places.records import FloorPlan

_CELL = 0.1  # m
_NEAREST = 8


def interpolate(
    plan: FloorPlan, storey: int, points: np.ndarray, values: np.ndarray, reach: float
) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """(ny, nx) image of values at points (N, 2 or 3), and its extent. NaN where no point is in sight.

    Each cell takes those of the nearest points within `reach` m that no wall hides from it, weighted by
    the inverse square of distance: nothing is interpolated through a wall.
    """
    walls = plan.walls[storey]
    low = np.minimum(points[:, :2].min(axis=0) - reach, plan.origin)
    high = points[:, :2].max(axis=0) + reach
    nx, ny = (np.ceil((high - low) / _CELL).astype(int) + 1).tolist()
    solid = _rasterise(walls, low, nx * 2, ny * 2, 0.5 * _CELL)
    x, y = (np.arange(n) * _CELL + _CELL / 2 for n in (nx, ny))
    cells = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2) + low
    offset = cells[:, None, :] - points[None, :, :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    near = np.argsort(distance, axis=1)[:, :_NEAREST]
    d = np.take_along_axis(distance, near, axis=1)
    seen = d <= reach
    for k in range(near.shape[1]):
        rows = np.flatnonzero(seen[:, k])
        seen[rows, k] = _in_sight(solid, low, 0.5 * _CELL, cells[rows], points[near[rows, k], :2])
    value = values[near]
    weight = np.where(seen & np.isfinite(value), 1.0 / (d**2 + 0.01), 0.0)
    total = weight.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        image = np.where(
            total > 0.0, (weight * np.where(np.isfinite(value), value, 0.0)).sum(axis=1) / total, np.nan
        )
    return image.reshape(nx, ny).T, (low[0], low[0] + nx * _CELL, low[1], low[1] + ny * _CELL)


def _rasterise(walls: np.ndarray, low: np.ndarray, nx: int, ny: int, cell: float) -> np.ndarray:
    solid = np.zeros((nx, ny), bool)
    size = np.array([nx, ny]) * cell
    for wall in walls:
        start, step = wall[:2] - low, wall[2:] - wall[:2]
        first, last = _within(start, step, size)  # a plan may reach far beyond the picture
        if first > last:
            continue
        t = np.linspace(first, last, int((last - first) * np.hypot(*step) / (0.4 * cell)) + 2)
        i, j = np.floor((start + t[:, None] * step) / cell).astype(int).T
        inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
        solid[i[inside], j[inside]] = True
    return solid


def _within(start: np.ndarray, step: np.ndarray, size: np.ndarray) -> tuple[float, float]:
    """Range of t in [0, 1] where start + t step (2,) lies in the box from 0 to `size` (2,); empty: first > last."""
    first, last = 0.0, 1.0
    for a, d, most in zip(start, step, size, strict=True):
        if abs(d) < 1e-12:
            if not 0.0 <= a <= most:
                return 1.0, 0.0
            continue
        ends = sorted((-a / d, (most - a) / d))
        first, last = max(first, ends[0]), min(last, ends[1])
    return first, last


def _in_sight(
    solid: np.ndarray, low: np.ndarray, cell: float, a: np.ndarray, b: np.ndarray
) -> np.ndarray:
    """(n,) whether no solid cell lies between places (n, 2), the first cell left out (it may be a wall's)."""
    steps = 2 + int(np.hypot(*(b - a).T).max(initial=0.0) / (0.7 * cell))
    free = np.ones(len(a), bool)
    for t in np.linspace(0.0, 1.0, steps):
        place = ((a + t * (b - a) - low) / cell).astype(int)
        i, j = np.clip(place[:, 0], 0, solid.shape[0] - 1), np.clip(place[:, 1], 0, solid.shape[1] - 1)
        free &= ~solid[i, j]
    return free


def draw_field(
    ax: Axes, plan: FloorPlan, points: np.ndarray, source: np.ndarray, levels: np.ndarray, spacing: float,
    storey: int = 0, limits: tuple[float, float] | None = None,
) -> None:  # fmt: skip
    """Level in dB at points (N, 3) of one storey, the brighter the louder, cut at walls; a star is the source."""
    image, extent = interpolate(plan, storey, points, levels, 1.5 * spacing)
    low, high = limits or (float(np.nanpercentile(image, 1)), float(np.nanpercentile(image, 99)))
    shown = ax.imshow(
        image, origin="lower", extent=extent, cmap="inferno", vmin=low, vmax=high, zorder=1
    )
    draw_plan(ax, plan, storey, furniture=False)
    ax.plot(*source[:2], "*", color="black", mec="white", ms=13, zorder=7)
    ax.figure.colorbar(
        shown, ax=ax, label="level (dB; 0: the source's direct sound at 1 m)", fraction=0.03, pad=0.02
    )


def draw_error(
    ax: Axes, plan: FloorPlan, points: np.ndarray, source: np.ndarray, error: np.ndarray, spacing: float,
    storey: int = 0,
) -> None:  # fmt: skip
    """Relative standard error at points (N, 3) of one storey."""
    image, extent = interpolate(plan, storey, points, 100.0 * error, 1.5 * spacing)
    shown = ax.imshow(image, origin="lower", extent=extent, cmap="cividis", vmin=0.0, zorder=1)
    draw_plan(ax, plan, storey, furniture=False)
    ax.plot(*source[:2], "*", color="white", mec="black", ms=13, zorder=7)
    ax.figure.colorbar(
        shown, ax=ax, label="standard error of the late energy (%)", fraction=0.03, pad=0.02
    )
