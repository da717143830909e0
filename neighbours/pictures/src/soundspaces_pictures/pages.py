"""Whole pictures of a dataset or a scene; `registry` has their names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from soundspaces_parameters import room_parameters
from soundspaces_parameters.registry import PARAMETERS, check_parameters
from soundspaces_parameters.table import ParameterTable

from soundspaces_pictures.field import interpolate
from soundspaces_pictures.plan import draw_plan
from soundspaces_pictures.plot_data import PlotData, on_storey
from soundspaces_sim import ConfigError, Echogram, ambisonic_rir, binaural_rir
from soundspaces_sim.parts import FloorPlan, LowResponse, require_within

matplotlib.use("Agg")  # pictures are files here

from matplotlib.animation import FuncAnimation, PillowWriter

from soundspaces_pictures.decay import draw_decay
from soundspaces_pictures.field import (
    Field,
    band_field,
    draw_error,
    draw_field,
    field_levels,
    level_limits,
)
from soundspaces_pictures.lobes import draw_lobes
from soundspaces_pictures.plan import draw_map
from soundspaces_pictures.plot_data import WALKS, default_listeners, default_source, storeys_in
from soundspaces_pictures.registry import PAGES
from soundspaces_pictures.response import draw_spectrogram, draw_waveform
from soundspaces_sim.parts import find_entry as find

_RATE = 44100
_MOST_FRAMES = 24
Points = tuple[int, ...]


def draw_page(data: PlotData, what: str, source: int | None = None, listeners: Points = ()) -> Figure:
    """One picture. `what`: a name of `PAGES`; `source`: a point, by default the one nearest to a quarter of
    the plan; `listeners`: points for lobes, decay and rir, by default chosen near and far. Raises
    `ConfigError`."""
    draw = find("what", PAGES, what)
    source = default_source(data) if source is None else source
    for point in (source, *listeners):
        if not 0 <= point < len(data.points):
            raise ConfigError(
                f"point {point} is out of range: there are points 0 to {len(data.points) - 1}"
            )
    figure: Figure = draw(data, source, listeners)
    return figure


def map_page(data: PlotData, _source: int, _listeners: Points) -> Figure:
    """Points and navigation graph of every storey."""
    storeys = range(len(data.plan.walls))
    sizes = [_size(data.plan, storey) for storey in storeys]
    figure, axes = plt.subplots(
        len(storeys),
        1,
        squeeze=False,
        layout="constrained",
        figsize=(max(w for w, _ in sizes), sum(h for _, h in sizes)),
    )
    for ax, storey in zip(axes[:, 0], storeys, strict=True):
        draw_map(ax, data.plan, data.grid, data.points, data.edges, data.nodes, storey)
        if len(storeys) > 1:
            ax.set_title(_storey_title(data, storey), fontsize=10)
    figure.suptitle(
        f"{data.name}: where sources and listeners stand, and how one can walk ({data.spacing:g} m grid)",
        fontsize=12,
    )
    return figure


def _storey_title(data: PlotData, storey: int) -> str:
    heights = data.points[storeys_in(data) == storey, 2]
    title = f"{len(heights)} points"
    if len(heights):
        low, high = f"{heights.min():.2f}", f"{heights.max():.2f}"
        title += f" at {low} m" if low == high else f" at {low} to {high} m"
    storeys = data.grid.storeys if data.grid is not None else None
    if storeys is not None and not storeys.walked[storey]:
        title += ", on a storey that cannot be walked onto from the others"
    return title


def lobes_page(data: PlotData, source: int, listeners: Points) -> Figure:
    """Where the sound of a source comes from at some listeners."""
    figure, ax, storey = _plan_axes(data, source)
    chosen = listeners or tuple(default_listeners(data, source))
    echograms = data.echograms(source, np.array(chosen))
    draw_lobes(ax, data.plan, data.points[source], data.points[list(chosen)], echograms, storey)
    ax.set_title(f"{data.name}: from where the sound of the source (star) reaches a listener")
    return figure


def field_page(data: PlotData, source: int, _listeners: Points) -> Figure:
    """Level of a source on its storey."""
    figure, ax, storey = _plan_axes(data, source)
    level = on_storey(data, source)[1]
    draw_field(ax, data.plan, _field(data, source, level), data.spacing, storey)
    ax.set_title(f"{data.name}: how loud the source (star) is at every place")
    return figure


def overview_page(data: PlotData, source: int, listeners: Points) -> Figure:
    """The field of a source, and what both ears of a listener get."""
    listener = listeners[0] if listeners else default_listeners(data, source)[1]
    storey, level = on_storey(data, source)
    figure = plt.figure(figsize=(13.0, 5.6), layout="constrained")
    plan, *ears = figure.subplot_mosaic(
        [["plan", "left"], ["plan", "right"]], width_ratios=[1.45, 1.0]
    ).values()
    draw_field(plan, data.plan, _field(data, source, level), data.spacing, storey)
    draw_listener(plan, data.points[listener])
    plan.set_title(f"{data.name}: the level of a source (star) everywhere, and a listener")
    draw_ears(ears, data.echograms(source, np.array([listener]), WALKS)[0])
    return figure


def error_page(data: PlotData, source: int, _listeners: Points) -> Figure:
    """The largest error of any band, of a source on its storey."""
    figure, ax, storey = _plan_axes(data, source)
    level = on_storey(data, source)[1]
    error = np.array([float(e.relative_error[1].max()) for e in data.echograms(source, level, WALKS)])
    place = data.points[source]
    draw_error(ax, data.plan, data.points[level], place, error, data.spacing, storey)
    ax.set_title(f"{data.name}: uncertainty of what is heard of the source (star), worst band")
    return figure


def decay_page(data: PlotData, source: int, listeners: Points) -> Figure:
    """Decay curves of a pair."""
    echogram, title = _pair(data, source, listeners)
    figure, ax = plt.subplots(figsize=(7.0, 4.6), layout="constrained")
    draw_decay(ax, echogram)
    ax.set_title(title)
    return figure


def rir_page(data: PlotData, source: int, listeners: Points) -> Figure:
    """A pair's response at both ears: waveform and spectrograms."""
    echogram, title = _pair(data, source, listeners)
    figure, axes = plt.subplots(3, 1, figsize=(7.5, 7.5), layout="constrained")
    ears = binaural_rir(ambisonic_rir(echogram, _RATE), _RATE)
    draw_waveform(axes[0], ears, _RATE)
    for ax, ear, name in zip(axes[1:], ears, ("left", "right"), strict=True):
        draw_spectrogram(ax, ear, _RATE)
        ax.set_title(f"{name} ear", fontsize=10)
    axes[0].set_title(f"{title}, facing +x")
    return figure


def animate_field(data: PlotData, path: str | Path) -> int:
    """Write a GIF of the field over sources that walk through the scene; the number of frames."""
    first = default_source(data)
    storey, level = on_storey(data, first)
    order = level[np.lexsort((data.points[level, 1], data.points[level, 0]))]
    sources = order[np.linspace(0, len(order) - 1, min(_MOST_FRAMES, len(order))).astype(int)]
    fields = [_field(data, int(s), level) for s in sources]
    limits = level_limits([field_levels(data.plan, storey, f, 1.5 * data.spacing)[0] for f in fields])
    figure = plt.figure(figsize=_size(data.plan, storey), layout="constrained")

    def frame(k: int) -> list[object]:
        figure.clear()
        ax = figure.add_subplot()
        draw_field(ax, data.plan, fields[k], data.spacing, storey, limits)
        ax.set_title(f"{data.name}: how loud the source (star) is at every place")
        return []

    animation = FuncAnimation(figure, frame, frames=len(sources))  # type: ignore[arg-type]
    animation.save(path, PillowWriter(fps=4), dpi=70)
    plt.close(figure)
    return len(sources)


def _pair(data: PlotData, source: int, listeners: Points) -> tuple[Echogram, str]:
    """The echogram of a source and its first listener, and a title."""
    listener = listeners[0] if listeners else default_listeners(data, source)[0]
    distance = float(np.linalg.norm(data.points[source] - data.points[listener]))
    title = f"{data.name}: point {source} to {listener}, {distance:.1f} m"
    return data.echograms(source, np.array([listener]), WALKS)[0], title


def _field(data: PlotData, source: int, level: np.ndarray) -> Field:
    """The field of a source at points of its storey."""
    points = data.points[level]
    return band_field(data.points[source], points, data.echograms(source, level))


def _plan_axes(data: PlotData, source: int) -> tuple[Figure, Axes, int]:
    """A figure of the shape of the plan, and the source's storey."""
    storey, _ = on_storey(data, source)
    figure, ax = plt.subplots(figsize=_size(data.plan, storey), layout="constrained")
    return figure, ax, storey


def _size(plan: FloorPlan, storey: int) -> tuple[float, float]:
    points = plan.walls[storey].reshape(-1, 2)
    if not len(points):
        return 8.0, 6.0
    width, depth = np.ptp(points, axis=0)
    across = 9.0
    return across, float(np.clip(across * depth / max(width, 0.1) + 0.9, 3.5, 12.0))


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


_HEADING_DEG = 90.0  # up the page
_HEAD = 0.22  # m, radius as drawn: larger than life
_LEFT, _RIGHT = "#0072B2", "#D55E00"


def draw_listener(ax: Axes, place: Sequence[float], heading_deg: float = _HEADING_DEG) -> None:
    """A head from above at `place` (2 or 3,) m: nose to its heading, ears in the colours of their responses."""
    x, y = float(place[0]), float(place[1])
    turn = np.deg2rad(heading_deg)

    def at(angle: float, distance: float) -> tuple[float, float]:
        return (
            x + _HEAD * distance * float(np.cos(turn + angle)),
            y + _HEAD * distance * float(np.sin(turn + angle)),
        )

    ax.add_patch(Polygon([at(-0.3, 0.9), at(0.0, 1.45), at(0.3, 0.9)], fc="white", ec="black", zorder=8))
    ax.add_patch(Circle((x, y), _HEAD, fc="white", ec="black", zorder=8))
    for side, colour in ((0.5 * np.pi, _LEFT), (-0.5 * np.pi, _RIGHT)):
        ax.add_patch(Circle(at(side, 1.0), 0.45 * _HEAD, fc=colour, ec="black", zorder=9))


def draw_ears(ears: Sequence[Axes], echogram: Echogram) -> None:
    """Level of the pair's response at the left and the right ear, dB re the strongest sample, on two axes."""
    response = binaural_rir(ambisonic_rir(echogram, _RATE), _RATE, heading_deg=_HEADING_DEG)
    time = 1e3 * np.arange(response.shape[1]) / _RATE
    level = 20.0 * np.log10(np.maximum(np.abs(response), 1e-9) / np.abs(response).max())
    names = (("left ear", _LEFT), ("right ear", _RIGHT))
    for ax, row, (name, colour) in zip(ears, level, names, strict=True):
        ax.fill_between(time, -60.0, row, color=colour, lw=0.0)
        ax.set_xlim(0.0, time[-1])
        ax.set_ylim(-60.0, 3.0)
        ax.set_ylabel("level (dB)")
        ax.set_title(name, fontsize=10, color=colour)
    ears[-1].set_xlabel("time since emission (ms)")
