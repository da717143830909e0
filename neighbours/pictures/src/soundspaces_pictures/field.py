"""The field of a source: levels at listeners, spread over the free space around each; direct sound exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from soundspaces_pictures.plan import draw_plan
from soundspaces_sim import Echogram
from soundspaces_sim.parts import DEFAULT_BANDS, FloorPlan

_CELL = 0.1  # m
_NEAREST = 8
_REFERENCE_HZ = 1000.0


@dataclass(frozen=True)
class Field:
    """The sound of one source at N points, in one band: energies re the direct sound at 1 m in the open.

    `direct` (N,): the direct sound's, times the squared distance in m², 1 where nothing attenuates it.
    `rest` (N,): of all that arrives later. `visible` (N,): points in sight of the source. `band`: its name.
    """

    source: np.ndarray  # (3,)
    points: np.ndarray  # (N, 3)
    direct: np.ndarray
    rest: np.ndarray
    visible: np.ndarray
    band: str


def band_field(source: np.ndarray, points: np.ndarray, echograms: Sequence[Echogram]) -> Field:
    """The field of a source (3,) at points (N, 3) in the band of 1 kHz, or the one nearest to it.

    The source's own point is left out: its direct sound is that of a few centimetres, and of no other place.
    """
    away = np.linalg.norm(points - source, axis=1)
    other = away > 0.0
    chosen = [e for e, there in zip(echograms, other, strict=True) if there]
    edges = chosen[0].bands if chosen else DEFAULT_BANDS
    band = int(np.clip(np.searchsorted(edges, _REFERENCE_HZ, "right") - 1, 0, len(edges) - 2))
    direct = np.array([0.0 if e.direct is None else float(e.direct.energy[band]) for e in chosen])
    rest = np.array([float(e.energy[:, 0, band].sum() + e.early.energy[:, band].sum()) for e in chosen])
    return Field(
        np.asarray(source, float),
        points[other],
        4.0 * np.pi * direct * away[other] ** 2,
        4.0 * np.pi * rest,
        np.array([e.visible for e in chosen], bool),
        f"{edges[band]:g} to {edges[band + 1]:g} Hz",
    )


class _Raster:
    """Cells of a picture over points (N, 2 or 3) and `reach` m around them, and the walls between them."""

    def __init__(self, plan: FloorPlan, storey: int, points: np.ndarray, reach: float) -> None:
        self.low = np.minimum(points[:, :2].min(axis=0) - reach, plan.origin)
        high = points[:, :2].max(axis=0) + reach
        self.nx, self.ny = (np.ceil((high - self.low) / _CELL).astype(int) + 1).tolist()
        self.solid = _rasterise(plan.walls[storey], self.low, self.nx * 2, self.ny * 2, 0.5 * _CELL)
        x, y = (np.arange(n) * _CELL + _CELL / 2 for n in (self.nx, self.ny))
        self.cells = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2) + self.low
        self.reach = reach

    def image(self, values: np.ndarray) -> tuple[np.ndarray, tuple[float, float, float, float]]:
        """(ny, nx) picture of values of the cells, and its extent."""
        x0, y0 = self.low
        extent = (x0, x0 + self.nx * _CELL, y0, y0 + self.ny * _CELL)
        return values.reshape(self.nx, self.ny).T, extent

    def sees(self, place: np.ndarray) -> np.ndarray:
        """(cells,) whether no wall stands between a cell and a place (2,)."""
        return _in_sight(
            self.solid, self.low, 0.5 * _CELL, self.cells, np.broadcast_to(place, self.cells.shape)
        )

    def spread(self, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(cells,) mean of the nearest points within reach that no wall hides from a cell, weighted by the inverse
        square of distance: nothing is interpolated through a wall. NaN where no point is in sight.
        """
        if len(points) == 0:
            return np.full(len(self.cells), np.nan)
        offset = self.cells[:, None, :] - points[None, :, :2]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        near = np.argsort(distance, axis=1)[:, :_NEAREST]
        d = np.take_along_axis(distance, near, axis=1)
        seen = d <= self.reach
        for k in range(near.shape[1]):
            rows = np.flatnonzero(seen[:, k])
            ends = points[near[rows, k], :2]
            seen[rows, k] = _in_sight(self.solid, self.low, 0.5 * _CELL, self.cells[rows], ends)
        value = values[near]
        finite = np.isfinite(value)
        weight = np.where(seen & finite, 1.0 / (d**2 + 0.01), 0.0)
        total = weight.sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = (weight * np.where(finite, value, 0.0)).sum(axis=1) / total
        return np.where(total > 0.0, mean, np.nan)


def interpolate(
    plan: FloorPlan, storey: int, points: np.ndarray, values: np.ndarray, reach: float
) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """(ny, nx) image of values at points (N, 2 or 3), and its extent. NaN where no point is in sight.

    Each cell takes those of the nearest points within `reach` m that no wall hides from it.
    """
    raster = _Raster(plan, storey, points, reach)
    return raster.image(raster.spread(points, values))


def field_levels(
    plan: FloorPlan, storey: int, field: Field, reach: float
) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """(ny, nx) image of the level of a field in dB re the direct sound at 1 m, and its extent.

    The direct sound falls off as the inverse square of each cell's distance; only its attenuation (air, walls) is
    interpolated, among points in sight of the source for cells in sight of it, among the others elsewhere. What
    arrives later is interpolated as a level.
    """
    raster = _Raster(plan, storey, np.concatenate([field.points, field.source[None]]), reach)
    with np.errstate(divide="ignore"):
        later = raster.spread(field.points, 10.0 * np.log10(field.rest))
    lit = raster.sees(field.source[:2])
    near, hidden = (
        raster.spread(field.points[mask], field.direct[mask]) for mask in (field.visible, ~field.visible)
    )
    factor = np.where(lit, np.nan_to_num(near, nan=1.0), np.nan_to_num(hidden, nan=0.0))
    away = np.hypot(*(raster.cells - field.source[:2]).T)
    energy = factor / np.maximum(away, 0.5 * _CELL) ** 2 + np.nan_to_num(10.0 ** (later / 10.0), nan=0.0)
    shown = np.isfinite(later) | (lit & (away <= reach))
    with np.errstate(divide="ignore"):
        return raster.image(np.where(shown & (energy > 0.0), 10.0 * np.log10(energy), np.nan))


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
    ax: Axes,
    plan: FloorPlan,
    field: Field,
    spacing: float,
    storey: int = 0,
    limits: tuple[float, float] | None = None,
) -> None:
    """Level of a field in dB on one storey, the brighter the louder, cut at walls; a star is the source."""
    image, extent = field_levels(plan, storey, field, 1.5 * spacing)
    low, high = limits or level_limits([image])
    shown = ax.imshow(
        image, origin="lower", extent=extent, cmap="inferno", vmin=low, vmax=high, zorder=1
    )
    draw_plan(ax, plan, storey, furniture=False)
    ax.plot(*field.source[:2], "*", color="black", mec="white", ms=13, zorder=7)
    label = f"level, {field.band} (dB re the source's direct sound at 1 m)"
    ax.figure.colorbar(shown, ax=ax, label=label, fraction=0.03, pad=0.02)


def level_limits(images: Sequence[np.ndarray]) -> tuple[float, float]:
    """Least and greatest level of a scale of colours: percentiles 1 and 99 of all images."""
    values = np.concatenate([image[np.isfinite(image)] for image in images])
    low, high = np.percentile(values, (1, 99)) if len(values) else (-60.0, 0.0)
    return float(low), float(high)


def draw_error(
    ax: Axes,
    plan: FloorPlan,
    points: np.ndarray,
    source: np.ndarray,
    error: np.ndarray,
    spacing: float,
    storey: int = 0,
) -> None:
    """Relative standard error at points (N, 3) of one storey."""
    image, extent = interpolate(plan, storey, points, 100.0 * error, 1.5 * spacing)
    shown = ax.imshow(image, origin="lower", extent=extent, cmap="cividis", vmin=0.0, zorder=1)
    draw_plan(ax, plan, storey, furniture=False)
    ax.plot(*source[:2], "*", color="white", mec="black", ms=13, zorder=7)
    ax.figure.colorbar(
        shown, ax=ax, label="standard error of the late energy (%)", fraction=0.03, pad=0.02
    )
