"""One page on a receiver: parameters in octaves, decay curves, the echogram with its reflections, and a list of
them. One HTML file that loads nothing and runs no script."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from soundspaces_sim.core.errors import PairIndexError
from soundspaces_sim.core.version import __version__
from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.dataset.room_parameters.registry import PARAMETERS
from soundspaces_sim.dataset.room_parameters.table import ParameterTable
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.in_bands import in_bands
from soundspaces_sim.echogram.parameters.speech import Speech
from soundspaces_sim.viz.decay import draw_decay
from soundspaces_sim.viz.html_page import write_page
from soundspaces_sim.viz.reflections import Reflection, edges_told, planes_told, reflections
from soundspaces_sim.viz.report import png

_BIN_S = 0.002
_SHOWN_S = 0.2  # of the echogram, after the first sound
_LABELLED = 12
_APART_S = 0.003  # of numbers that do not overlap
_BLUE, _VERMILION = "#0072B2", "#D55E00"  # told apart by the colour-blind


def write_receiver_report(
    ds: RirDataset, source: int, listener: int, out: str | Path, speech: Speech | None = None
) -> None:
    """Write the page on what `listener` hears of `source` to the file `out`. Raises `PairIndexError`,
    `DatasetError`."""
    if source == listener:
        raise PairIndexError(f"source {source}: expected another point than the receiver's")
    table = ds.parameters(pairs=[(source, listener)], speech=speech)
    octaves = in_bands(ds.echogram(source, listener), table.bands.edges)
    band = int(np.abs(np.log(np.array(table.bands.centre) / 1000.0)).argmin())
    found = _reflections(ds, octaves, source, listener, band)
    s, l = ds.points[source], ds.points[listener]
    context = {
        "scene": ds.scene,
        "source": source,
        "listener": listener,
        "places": [
            (name, "({:.2f}, {:.2f}, {:.2f}) m".format(*p))
            for name, p in (("source", s), ("receiver", l))
        ],
        "distance": f"{np.linalg.norm(s - l):.2f} m",
        "visible": octaves.visible,
        "bands": [f"{f:g}" for f in table.bands.centre],
        "rows": _rows(table),
        "speech": _conditions(speech or Speech()),
        "decay": png(_decay(octaves)),
        "echogram": png(_echogram(octaves, found, band)),
        "band": f"{table.bands.centre[band]:g} Hz",
        "reflections": [_line(r, found) for r in found],
        "version": __version__,
    }
    write_page(Path(__file__).with_name("receiver.html"), context, out)


def _reflections(
    ds: RirDataset, octaves: Echogram, source: int, listener: int, band: int
) -> list[Reflection]:
    """By name; planes and edges that this pair does not tell of are looked for at other receivers of the source."""
    c = ds.manifest.config.simulation.c
    s, l = ds.points[source], ds.points[listener]
    planes, bends = planes_told([(octaves, s, l)], c), edges_told([(octaves, s, l)], c)
    wanted = {p for a in octaves.early for p in a.planes}
    bent = {e for a in octaves.early for e in a.edges}
    for other in range(len(ds.points)):
        if wanted <= planes.keys() and bent <= bends.keys():
            break
        if other not in (source, listener):
            there = [(ds.echogram(source, other), s, ds.points[other])]
            planes, bends = planes_told(there, c) | planes, edges_told(there, c) | bends
    return reflections(octaves, s, l, planes, bends, band, c)


def _conditions(speech: Speech) -> str:
    levels = " ".join(f"{x:.0f}" for x in speech.at_1_m)
    noise = "no noise"
    if speech.noise_db is not None:
        noise = f"noise {' '.join(f'{x:.0f}' for x in speech.noise_db)} dB"
    return f"Speech at 1 m {levels} dB, {noise}, octaves from 125 Hz to 8 kHz."


def _rows(table: ParameterTable) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """(name, what it is, cells of octaves and of the single number: (value, errors))."""
    out = []
    for name, found in table.values.items():
        unit = PARAMETERS[name].unit
        scale = 1000.0 if name == "ts" else 1.0
        cells = [_cell(scale * row) for row in found[0]]
        label = f"{name} ({'ms' if name == 'ts' else unit})" if unit != "1" else name
        out.append((label, PARAMETERS[name].about, cells))
    return out


def _cell(values: np.ndarray) -> tuple[str, str]:
    value, error, interpolation = (float(x) for x in values)
    if not np.isfinite(value):
        return "–", ""
    digits = 2 if abs(value) < 10.0 else 1
    shown = _signed(value, digits)
    if not np.isfinite(error):
        return shown, "standard error not known"
    whole = float(np.hypot(error, np.nan_to_num(interpolation)))
    text = f"standard error {error:.2g}, course within simulated bands {interpolation:.2g}"
    return f"{shown} ± {whole:.{digits}f}", text


def _line(r: Reflection, found: list[Reflection]) -> tuple[str, ...]:
    first, direct = found[0], found[0].level if found[0].number == 0 else None
    turned = round(abs(r.azimuth))
    side = "left" if r.azimuth > 0.0 else "right"
    return (
        str(r.number),
        f"{1e3 * r.delay:.1f}",
        f"{1e3 * (r.delay - first.delay):.1f}",
        _signed(r.level, 1),
        "–" if direct is None else _signed(r.level - direct, 1),
        {0: "ahead", 180: "behind"}.get(turned, f"{turned}° {side}"),
        f"{_signed(r.elevation, 0)}°",
        r.surfaces,
    )


def _signed(value: float, digits: int) -> str:
    """Without a sign before nothing."""
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")


def _decay(octaves: Echogram) -> Figure:
    figure, ax = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    draw_decay(ax, octaves)
    return figure


def _echogram(octaves: Echogram, found: list[Reflection], band: int) -> Figure:
    """Level of the reverberation in short bins, and discrete arrivals as numbered lines."""
    figure, ax = plt.subplots(figsize=(9.0, 3.8), layout="constrained")
    reference = 4.0 * np.pi * 100.0
    edges = octaves.time_edges
    sums = np.concatenate([[0.0], np.cumsum(octaves.energy[:, 0, band].astype(float))])
    first = found[0].delay if found else float(edges[int(np.argmax(sums[1:] > 0.0))])
    times = np.arange(0.0, first + _SHOWN_S, _BIN_S)
    energy = np.diff(np.interp(times, edges, sums)) * reference
    top = max([r.level for r in found] + [10.0 * np.log10(max(energy.max(initial=0.0), 1e-30))]) + 3.0
    bottom = top - 60.0
    with np.errstate(divide="ignore"):
        level = np.maximum(10.0 * np.log10(energy), bottom)
    name = f"reverberation per {1e3 * _BIN_S:g} ms"
    ax.stairs(level, 1e3 * times, baseline=bottom, fill=True, color=_BLUE, alpha=0.45, label=name)
    shown = [r for r in found if r.level > bottom and r.delay <= first + _SHOWN_S]
    at, levels = [1e3 * r.delay for r in shown], [r.level for r in shown]
    ax.vlines(at, bottom, levels, color=_VERMILION, lw=1.3, label="discrete arrivals")
    written: list[float] = []
    for r in sorted(shown, key=lambda r: -r.level):
        if len(written) == _LABELLED or any(abs(r.delay - t) < _APART_S for t in written):
            continue
        written.append(r.delay)
        ax.annotate(str(r.number), (1e3 * r.delay, r.level), fontsize=8, ha="center", va="bottom")
    ax.set_ylim(bottom, top + 3.0)
    ax.set_xlim(max(1e3 * first - 5.0, 0.0), 1e3 * (first + _SHOWN_S))
    ax.set_xlabel("time since emission (ms)")
    ax.set_ylabel("level (dB re direct sound at 10 m)")
    ax.legend(fontsize=8, frameon=False)
    return figure
