"""Maps of any room-acoustic parameter: its value at the points of a storey, for one source."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.dataset.room_parameters.of_echograms import room_parameters
from soundspaces_sim.dataset.room_parameters.registry import PARAMETERS, check_parameters
from soundspaces_sim.dataset.room_parameters.table import ParameterTable
from soundspaces_sim.viz.field import interpolate
from soundspaces_sim.viz.plan import draw_plan
from soundspaces_sim.viz.plot_data import PlotData, on_storey

_OFF = 2.0**0.5  # ratio of an octave's centre to the band asked for, at most


def parameter_page(data: PlotData, source: int, _listeners: tuple[int, ...]) -> Figure:
    """`data.parameter` in the octave of `data.band_hz`, or its one value per pair, on the source's storey."""
    (name,) = check_parameters(data.parameter)
    place = data.points[source]
    storey, level = on_storey(data, source)
    level = level[level != source]
    tables = [
        room_parameters(e, name, towards=place - data.points[l])
        for e, l in zip(data.echograms(source, level), level, strict=True)
    ]
    values, label = _values(tables, name, data.band_hz)
    image, extent = interpolate(data.plan, storey, data.points[level], values, 1.5 * data.spacing)
    width, depth = extent[1] - extent[0], extent[3] - extent[2]
    figure, ax = plt.subplots(
        figsize=(9.0, float(np.clip(9.0 * depth / width + 0.9, 3.5, 12.0))), layout="constrained"
    )
    shown = ax.imshow(image, origin="lower", extent=extent, cmap="viridis", zorder=1)
    draw_plan(ax, data.plan, storey, furniture=False)
    ax.plot(*place[:2], "*", color="white", mec="black", ms=13, zorder=7)
    figure.colorbar(shown, ax=ax, label=label, fraction=0.03, pad=0.02)
    ax.set_title(f"{data.name}: {PARAMETERS[name].about}, of the source (star)")
    return figure


def _values(tables: list[ParameterTable], name: str, band_hz: float) -> tuple[np.ndarray, str]:
    """((n,), what they are)."""
    parameter = PARAMETERS[name]
    unit = "" if parameter.unit == "1" else f" ({parameter.unit})"
    if not tables:
        raise ConfigError("a map needs another point on the storey of the source")
    if parameter.takes == "index":
        return np.array([t[name][0, 0] for t in tables]), f"{name}{unit}"
    centres = np.array(tables[0].bands.centre)
    band = int(np.abs(np.log(centres / band_hz)).argmin()) if band_hz > 0.0 else 0
    if not 1.0 / _OFF <= centres[band] / max(band_hz, 1e-9) <= _OFF:
        raise ConfigError(
            f"band: expected one of {', '.join(f'{f:g}' for f in centres)} Hz, got {band_hz:g} Hz"
        )
    return np.array([t[name][0, band] for t in tables]), f"{name}, {centres[band]:g} Hz{unit}"
