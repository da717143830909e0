"""One page on a receiver: parameters in octaves, decay curves, the echogram with its reflections, and a list of
them. One HTML file that loads nothing and runs no script."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from soundspaces_parameters import Speech, in_bands
from soundspaces_parameters.registry import PARAMETERS
from soundspaces_parameters.table import ParameterTable
from soundspaces_pictures import draw_decay
from soundspaces_pictures.html_page import write_page
from soundspaces_pictures.report import png

from soundspaces_sim import Arrival, Echogram, PairIndexError, RirDataset, __version__
from soundspaces_sim.parts import ARRIVAL_KINDS as KINDS, KIND_EDGE as EDGE, KIND_MIRRORS as MIRRORS

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


# Discrete arrivals of a pair with names: when, how loud, from where, and by way of which surfaces.
#
# Of a path with one corner, length L and direction of arrival d from the receiver, the corner lies at the
# distance
#
#     a = (L² - |w|²) / (2 (L - d · w)),   w from the receiver to the source,
#
# and the surface's normal halves the angle between its legs. So first-order reflections tell where the planes are
# whose numbers the dataset stores, and reflections by two of them are named by what others tell. No scene is
# needed.

_AT_10_M = 1.0 / (4.0 * np.pi * 100.0)
_LEVEL = 0.95  # least component of a normal that names an axis
_NAMES = ("x", "y", "z")


class Plane(NamedTuple):
    """A mirror that reflections tell of: unit normal towards the room, and a point on it, m."""

    normal: np.ndarray
    point: np.ndarray

    def __str__(self) -> str:
        axis = int(np.abs(self.normal).argmax())
        if abs(self.normal[axis]) < _LEVEL:
            azimuth = np.degrees(np.arctan2(self.normal[1], self.normal[0]))
            elevation = np.degrees(np.arcsin(np.clip(self.normal[2], -1.0, 1.0)))
            facing, tilted = round(azimuth) % 360, round(elevation)
            return f"surface facing {facing}°, tilted {tilted}°, at {_place(self.point)}"
        towards = ("-" if self.normal[axis] < 0.0 else "+") + _NAMES[axis]
        facing = {"+z": "up", "-z": "down"}.get(towards, towards)
        return f"surface facing {facing} at {_NAMES[axis]} = {_metres(self.point[axis])} m"


class Reflection(NamedTuple):
    """An arrival, numbered through. `delay` s since emission; `level` dB re the direct sound at 10 m in the open,
    in one band; `azimuth` (positive: left of the source), `elevation`, degrees; `surfaces` from the source on."""

    number: int
    delay: float
    level: float
    azimuth: float
    elevation: float
    surfaces: str


def _metres(x: float) -> str:
    return f"{round(float(x), 2) + 0.0:.2f}"  # no minus before nothing


def _place(point: np.ndarray) -> str:
    return f"({', '.join(_metres(x) for x in point)}) m"


def corner(
    arrival: Arrival, source: np.ndarray, listener: np.ndarray, speed_of_sound: float
) -> np.ndarray:
    """(3,) where a path with one corner turns, m."""
    w, length = source - listener, arrival.delay * speed_of_sound
    away = (length**2 - w @ w) / (2.0 * (length - arrival.direction @ w))
    return np.asarray(listener + away * arrival.direction)


def planes_told(
    echograms: Iterable[tuple[Echogram, np.ndarray, np.ndarray]], speed_of_sound: float
) -> dict[int, Plane]:
    """Planes by their numbers, from first-order reflections of (echogram, source, listener)."""
    found: dict[int, Plane] = {}
    for echogram, source, listener in echograms:
        for arrival in echogram.early:
            if arrival.kind != KINDS[MIRRORS] or len(arrival.planes) != 1 or arrival.planes[0] in found:
                continue
            point = corner(arrival, source, listener, speed_of_sound)
            legs = [
                (end - point) / max(float(np.linalg.norm(end - point)), 1e-9)
                for end in (source, listener)
            ]
            normal = legs[0] + legs[1]
            if np.linalg.norm(normal) > 1e-6:  # grazing: nothing is told
                found[arrival.planes[0]] = Plane(normal / np.linalg.norm(normal), point)
    return found


def edges_told(
    echograms: Iterable[tuple[Echogram, np.ndarray, np.ndarray]], speed_of_sound: float
) -> dict[int, np.ndarray]:
    """A point on edges by their numbers, m, from sound that bent round one of them alone."""
    found: dict[int, np.ndarray] = {}
    for echogram, source, listener in echograms:
        for arrival in echogram.early:
            if arrival.kind == KINDS[EDGE] and arrival.edges[0] not in found:
                found[arrival.edges[0]] = corner(arrival, source, listener, speed_of_sound)
    return found


def _surfaces(
    arrival: Arrival,
    source: np.ndarray,
    listener: np.ndarray,
    planes: Mapping[int, Plane],
    bends: Mapping[int, np.ndarray],
    speed_of_sound: float,
) -> str:
    if arrival.kind == KINDS[EDGE]:
        return f"edge at {_place(corner(arrival, source, listener, speed_of_sound))}"
    mirrors = [str(planes.get(p, "a surface that no other path tells of")) for p in arrival.planes]
    edges = [
        f"edge through {_place(bends[e])}" if e in bends else "an edge that no other path tells of"
        for e in arrival.edges
    ]
    both = [*edges, *mirrors] if arrival.kind.startswith("edge") else [*mirrors, *edges]
    return ", then ".join(both)


def reflections(
    echogram: Echogram,
    source: np.ndarray,
    listener: np.ndarray,
    planes: Mapping[int, Plane],
    bends: Mapping[int, np.ndarray],
    band: int,
    speed_of_sound: float,
) -> list[Reflection]:
    """All discrete arrivals with energy in a band, by time; the direct sound, if any, is number 0."""
    towards = source - listener
    facing = np.arctan2(towards[1], towards[0])
    out = []
    heard = [a for a in sorted(echogram.early, key=lambda a: a.delay) if float(a.energy[band]) > 0.0]
    named = [
        (k, a, _surfaces(a, source, listener, planes, bends, speed_of_sound))
        for k, a in enumerate(heard, 1)
    ]
    if echogram.direct is not None and float(echogram.direct.energy[band]) > 0.0:
        named.insert(0, (0, echogram.direct, "direct sound"))
    for number, arrival, surfaces in named:
        energy = float(arrival.energy[band])
        x, y, z = arrival.direction
        azimuth = np.degrees((np.arctan2(y, x) - facing + np.pi) % (2.0 * np.pi) - np.pi)
        level = 10.0 * np.log10(energy / _AT_10_M)
        elevation = np.degrees(np.arcsin(np.clip(z, -1.0, 1.0)))
        out.append(
            Reflection(number, arrival.delay, float(level), float(azimuth), float(elevation), surfaces)
        )
    return out
