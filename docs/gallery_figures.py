"""Figures of gallery.md: `python docs/gallery_figures.py [NAME …]` in the clone. Takes a minute of processor time.

Each public function draws one: the first line of its docstring is its heading, the rest its caption. The site shows
picture and code (`site_hooks.py`); functions whose names begin with an underscore are what several share.
"""

from __future__ import annotations

import inspect
import sys
from functools import cache
from pathlib import Path
from types import FunctionType

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import soundspaces_parameters
import soundspaces_pictures
from matplotlib.figure import Figure
from soundspaces_pictures.pages import draw_page
from soundspaces_pictures.plot_data import PlotData, load_plot_data

import soundspaces_sim as ss

OUT = Path(__file__).parent / "figures" / "gallery"
#: Figures as wide as a page; all others are as wide as a column.
WIDE = ("directions",)
BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#777777"


@cache
def _demo() -> PlotData:
    return load_plot_data("demo", 1.0)


@cache
def _lecture_room() -> ss.Echograms:
    """A lecture room of 9 x 7 x 3 m; a source, and listeners from 1 to 7 m away."""
    materials = {
        "floor": 0.06,
        "ceiling": 0.45,
        "west": 0.15,
        "east": 0.15,
        "south": 0.15,
        "north": 0.15,
    }
    room = ss.shoebox((9.0, 7.0, 3.0), materials, 0.3)
    listeners = [[1.0 + d, 3.1, 1.2] for d in np.linspace(1.0, 7.0, 13)]
    config = ss.SimulationConfig(bands=tuple(88.4 * 2.0 ** np.arange(8)), walks=1500)
    return ss.simulate(room, [[1.0, 3.0, 1.5]], listeners, config)


def decay() -> Figure:
    """Decay curves of a pair

    Backward-integrated energy in the simulated bands; dashed: the line whose slope is T30; shaded: two standard
    errors of the late energy.
    """
    data = _demo()
    (echogram,) = data.echograms(18, np.array([2]), 1000)
    figure, ax = plt.subplots(figsize=(5.0, 3.6), layout="constrained")
    soundspaces_pictures.draw_decay(ax, echogram)
    return figure


def parameters() -> Figure:
    """Reverberation by octaves, with error bars

    T30 and EDT of one pair; bars are two standard errors, which come with the simulation.
    """
    table = soundspaces_parameters.room_parameters(_lecture_room()[0, 6], ["t30", "edt"], "octaves")
    octave = np.array(table.bands.centre)
    figure, ax = plt.subplots(figsize=(5.0, 3.4), layout="constrained")
    for name, colour, shift in (("t30", BLUE, 0.97), ("edt", ORANGE, 1.03)):
        value, error = table.values[name][0, :-1, 0], table.values[name][0, :-1, 1]
        ax.errorbar(
            octave * shift, value, 2.0 * error, fmt="o", color=colour, label=name.upper(), capsize=2
        )
    ax.set_xscale("log", base=2)
    ax.set_xticks(octave, [f"{f:g}" for f in octave])
    ax.minorticks_off()
    ax.set(xlabel="octave (Hz)", ylabel="time (s)", ylim=(0.0, 0.8))
    ax.legend(frameon=False)
    return figure


def distance() -> Figure:
    """Strength against distance, and a theory

    Circles: G at 1 kHz, bars of two standard errors; line: Barron and Lee (1988), from the room's volume and the
    mean of T30; dotted: the direct sound alone.
    """
    echoes = _lecture_room()
    table = soundspaces_parameters.room_parameters(echoes, ["g", "t30"], "octaves")
    k = int(np.argmin(np.abs(np.array(table.bands.centre) - 1000.0)))
    away = np.linalg.norm(echoes.listeners - echoes.sources[0], axis=1)
    figure, ax = plt.subplots(figsize=(5.0, 3.4), layout="constrained")
    value, error = table.values["g"][:, k, 0], table.values["g"][:, k, 1]
    ax.errorbar(away, value, 2.0 * error, fmt="o", color=BLUE, mfc="white", capsize=2, label="simulated")
    r, t30, volume = np.linspace(0.9, 7.2, 60), float(table["t30"][:, k].mean()), 9.0 * 7.0 * 3.0
    direct = 100.0 / r**2
    late = 31200.0 * t30 / volume * np.exp(-0.04 * r / t30)
    ax.plot(r, 10.0 * np.log10(direct + late), color=ORANGE, label="Barron and Lee")
    ax.plot(r, 10.0 * np.log10(direct), ":", color=GREY, label="direct sound")
    ax.set(xlabel="distance (m)", ylabel="G, 1000 Hz (dB)")
    ax.legend(frameon=False)
    return figure


def reflections() -> Figure:
    """Direct sound, reflections and the rest

    Lines: direct sound and mirror reflections at 1 kHz; grey: all else, in bins of 5 ms.
    """
    echogram = _lecture_room()[0, 6]
    band = int(np.searchsorted(echogram.bands, 1000.0)) - 1
    figure, ax = plt.subplots(figsize=(5.0, 3.4), layout="constrained")
    edges, energy = np.asarray(echogram.time_edges), np.asarray(echogram.energy[:, 0, band], float)
    grid = np.arange(0.0, 0.15, 0.005)
    summed = np.diff(np.interp(np.append(grid, 0.15), edges, np.append(0.0, energy.cumsum())))
    reference = 1.0 / (4.0 * np.pi)  # of the direct sound at 1 m
    late = 10.0 * np.log10(np.maximum(summed, 1e-9) / reference)
    ax.bar(1e3 * grid, late + 60.0, 5.0, -60.0, align="edge", color="#cccccc", label="all else")
    for i, arrival in enumerate(echogram.arrivals):
        level = 10.0 * np.log10(arrival.energy[band] / reference)
        colour, name = (ORANGE, "direct") if i == 0 else (BLUE, "mirrored")
        ax.plot(
            [1e3 * arrival.delay] * 2,
            [-60.0, level],
            color=colour,
            lw=1.5,
            label=name if i < 2 else None,
        )
    ax.set(
        xlabel="time (ms)",
        ylabel="level, 1000 Hz (dB re 1 m)",
        xlim=(0, 150),
        ylim=(-60, 20),
        yticks=range(-60, 1, 20),
    )
    ax.legend(frameon=False)
    return figure


def level() -> Figure:
    """The level of a source everywhere

    `soundspaces-sim plot demo --what field --print column`; nothing is interpolated through walls.
    """
    return draw_page(_demo(), "field", 18)


def directions() -> Figure:
    """Where sound comes from

    `soundspaces-sim plot demo --what lobes --print page`: L1 is in the room of the source, L2 sees it
    through an opening.
    """
    return draw_page(_demo(), "lobes", 18)


def _figures() -> dict[str, FunctionType]:
    return {
        name: value
        for name, value in globals().items()
        if inspect.isfunction(value)
        and value.__module__ == __name__
        and not name.startswith("_")
        and name != "main"
    }


def main(names: list[str]) -> None:
    """Draw figures, or all of them."""
    OUT.mkdir(parents=True, exist_ok=True)
    for name in names or _figures():
        figure = _figures()[name]()
        soundspaces_pictures.save_printed(
            figure, OUT / f"{name}.svg", "page" if name in WIDE else "column"
        )
        plt.close(figure)


if __name__ == "__main__":
    main(sys.argv[1:])
