"""Maps of modes: the level of a source at one frequency, of sound that was simulated as waves."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.limits import require_within
from soundspaces_sim.echogram.low_response import LowResponse
from soundspaces_sim.layout.records import FloorPlan
from soundspaces_sim.viz.field import interpolate
from soundspaces_sim.viz.plan import draw_plan
from soundspaces_sim.viz.plot_data import PlotData, on_storey

_RANGE_DB = 40.0  # of colours
_LOWEST = 20.0  # Hz


def modes_page(data: PlotData, source: int, _listeners: tuple[int, ...]) -> Figure:
    """Level at `data.frequency_hz` on the source's storey; None: where it is highest in the mean."""
    place = data.points[source]
    storey, level = on_storey(data, source)
    level = level[level != source]
    if not len(level):
        raise ConfigError("a map needs another point on the storey of the source")
    waves = data.waves(source, level)
    frequency = data.frequency_hz or strongest(waves)
    require_within("frequency", frequency, _LOWEST, waves[0].edge, "Hz")
    pressure = np.array([w.at(np.array([frequency]))[0, 0] for w in waves])
    figure, ax = plt.subplots(figsize=(9.0, 6.5), layout="constrained")
    draw_mode(ax, data.plan, data.points[level], pressure, data.spacing, storey)
    ax.plot(*place[:2], "*", color="white", mec="black", ms=13, zorder=7)
    ax.set_title(f"{data.name}: how loud {frequency:.1f} Hz from the source (star) is at every place")
    return figure


def strongest(waves: Sequence[LowResponse]) -> float:
    """Hz: the frequency of the highest mean square pressure, from 20 Hz on."""
    frequency = waves[0].transfer()[0]
    power = np.sum([np.abs(w.transfer()[1][0]) ** 2 for w in waves], axis=0)
    return float(frequency[np.where(frequency >= _LOWEST, power, 0.0).argmax()])


def draw_mode(
    ax: Axes, plan: FloorPlan, points: np.ndarray, pressure: np.ndarray, spacing: float, storey: int = 0
) -> None:
    """Level of complex pressures (N,) at points (N, 3) of one storey, re the direct sound at 1 m."""
    square = 4.0 * np.pi * np.abs(pressure) ** 2
    values = 10.0 * np.log10(np.maximum(square, 1e-30))
    image, extent = interpolate(plan, storey, points, values, 1.5 * spacing)
    top = float(values.max())
    shown = ax.imshow(
        image, origin="lower", extent=extent, cmap="magma", vmin=top - _RANGE_DB, vmax=top, zorder=1
    )
    draw_plan(ax, plan, storey, furniture=False)
    label = "level (dB re the source's direct sound at 1 m)"
    ax.figure.colorbar(shown, ax=ax, label=label, fraction=0.03, pad=0.02)
