"""One page on a calibration: errors before and after per measure and octave, fitted absorption, all pairs. One HTML
file that loads nothing and runs no script."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from soundspaces_pictures.html_page import write_page
from soundspaces_pictures.report import png

from soundspaces_calibration.measured.calibration import Calibration
from soundspaces_calibration.measured.room import MEASURED
from soundspaces_sim import __version__
from soundspaces_sim.parts import publish_file as publish

_GREY, _BLUE, _VERMILION = "#777777", "#0072B2", "#D55E00"  # told apart by the colour-blind
_LABELS = {"t30": "T30 (s)", "edt": "EDT (s)", "c80": "C80 (dB)", "d50": "D50"}
_COLUMNS = 3  # of panels of materials


def write_calibration_report(found: Calibration, out: str | Path) -> None:
    """Write the page on a calibration to the file `out`. Raises `DatasetError` if it cannot be written."""
    groups = [(name, pairs) for name, pairs in _groups(found) if pairs.any()]
    context = {
        "scene": found.scene,
        "settled": found.settled,
        "turns": [
            (str(k + 1), f"{turn.misfit:.2f}", f"{turn.change:.2f}", "yes" if turn.within else "no")
            for k, turn in enumerate(found.turns)
        ],
        "widened": f"{found.widened:.2f}" if found.widened > 1.0 else "",
        "errors": [row for name, pairs in groups for row in _error_rows(found, name, pairs)],
        "measures": [name.upper() for name in MEASURED],
        "octaves": [f"{f:g}" for f in found.measured.octaves],
        "materials": _material_rows(found),
        "by_octave": png(_by_octave(found, groups)),
        "values": png(_values(found, groups)),
        "absorption": png(_absorption(found)),
        "sources": list(zip(found.measured.source_names, _places(found.measured.sources), strict=True)),
        "receivers": list(
            zip(found.measured.receiver_names, _places(found.measured.receivers), strict=True)
        ),
        "version": __version__,
    }
    write_page(Path(__file__).with_name("report.html"), context, out)


def write_calibration_pairs(found: Calibration, out: str | Path) -> None:
    """Write a row per pair and octave to the CSV file `out`: what was measured, and simulated before and after.
    Raises `DatasetError`."""
    kinds = ("measured", "before", "after")
    head = ["source", "receiver", "held_out", "octave_hz"]
    lines = [[*head, *(f"{name}_{kind}" for name in MEASURED for kind in kinds)]]
    room = found.measured
    for s, r, k in np.ndindex(*found.held_out.shape, len(room.octaves)):
        values = np.stack([v[s, r, :, k] for v in (room.values, found.before, found.after)], axis=1)
        names = [_cell(n) for n in (room.source_names[s], room.receiver_names[r])]
        cells = [f"{v:.5g}" if np.isfinite(v) else "" for v in values.ravel()]
        lines.append([*names, str(int(found.held_out[s, r])), f"{room.octaves[k]:g}", *cells])
    publish(Path(out), "".join(",".join(line) + "\n" for line in lines).encode())


def _cell(text: str) -> str:
    """A name as a cell of a table. A spreadsheet calculates what begins like a formula; an apostrophe makes it a
    text."""
    formula = text.startswith(("=", "+", "-", "@", "\t", "\r"))
    return '"{}{}"'.format("'" if formula else "", text.replace('"', '""'))


def _groups(found: Calibration) -> tuple[tuple[str, np.ndarray], ...]:
    return ("fitted", ~found.held_out), ("held out", found.held_out)


def _places(points: np.ndarray) -> list[str]:
    return ["({:.2f}, {:.2f}, {:.2f}) m".format(*point) for point in points]


def _error_rows(found: Calibration, name: str, pairs: np.ndarray) -> list[tuple[str, str, list[str]]]:
    parts = (
        ("before", found.errors(found.before, pairs)),
        ("after", found.errors(found.after, pairs)),
        ("of exact energies", found.least(pairs)),
    )
    return [
        (f"{name} pairs", what, [f"{v:.2f}" if np.isfinite(v) else "–" for v in values])
        for what, values in parts
    ]


def _material_rows(found: Calibration) -> list[tuple[str, list[tuple[str, str]]]]:
    """(name, (value, table's value) of each octave)."""
    fit, out = found.fit, []
    for m, name in enumerate(fit.names):
        cells = []
        for k, value in enumerate(fit.absorption[m]):
            spread = f"{value:.2f} ± {fit.spread[m, k]:.2f}"
            told = f"{value:.2f}, undetermined" if found.undetermined[m, k] else spread
            cells.append((told, f"table: {found.table[m, k]:.2f}"))
        out.append((name, cells))
    return out


def _octave_axis(ax: Axes, found: Calibration) -> np.ndarray:
    """Positions of octaves on an axis that names them."""
    at = np.arange(len(found.measured.octaves))
    ax.set_xticks(at, [f"{f:g}" for f in found.measured.octaves], fontsize=8)
    ax.set_xlim(-0.5, len(at) - 0.5)
    return at


def _mean(values: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """(measures, K) over `pairs`, NaN where there is none."""
    chosen = values[pairs]
    known = np.isfinite(chosen)
    total, count = np.where(known, chosen, 0.0).sum(axis=0), known.sum(axis=0)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _by_octave(found: Calibration, groups: list[tuple[str, np.ndarray]]) -> Figure:
    """Mean errors in JND."""
    figure, axes = plt.subplots(
        len(groups),
        len(MEASURED),
        figsize=(11.0, 2.7 * len(groups)),
        layout="constrained",
        squeeze=False,
    )
    before, after = found.differences(found.before), found.differences(found.after)
    least = np.sqrt(2.0 / np.pi) * found.interference / found.measured.jnd
    for row, (name, pairs) in zip(axes, groups, strict=True):
        for m, ax in enumerate(row):
            at = _octave_axis(ax, found)
            ax.fill_between(
                at,
                0.0,
                _mean(least, pairs)[m],
                color=_GREY,
                alpha=0.25,
                lw=0.0,
                label="of exact energies",
            )
            ax.plot(at, _mean(before, pairs)[m], "s--", color=_VERMILION, ms=4, label="before")
            ax.plot(at, _mean(after, pairs)[m], "o-", color=_BLUE, ms=4, label="after")
            ax.set_ylim(bottom=0.0)
            ax.set_title(f"{MEASURED[m].upper()}, {name} pairs", fontsize=9)
        row[0].set_ylabel("mean error (JND)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, fontsize=8, frameon=False)
    for ax in axes[-1]:
        ax.set_xlabel("octave (Hz)", fontsize=8)
    return figure


def _values(found: Calibration, groups: list[tuple[str, np.ndarray]]) -> Figure:
    """Means over pairs, as measured, before and after."""
    figure, axes = plt.subplots(
        len(groups),
        len(MEASURED),
        figsize=(11.0, 2.7 * len(groups)),
        layout="constrained",
        squeeze=False,
    )
    kinds = (
        (found.measured.values, "^", "measured"),
        (found.before, "s--", "before"),
        (found.after, "o-", "after"),
    )
    for row, (name, pairs) in zip(axes, groups, strict=True):
        for m, ax in enumerate(row):
            at = _octave_axis(ax, found)
            for (values, style, label), colour in zip(kinds, ("k", _VERMILION, _BLUE), strict=True):
                ax.plot(at, _mean(values, pairs)[m], style, color=colour, ms=4, label=label)
            ax.set_title(f"{_LABELS[MEASURED[m]]}, {name} pairs", fontsize=9)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, fontsize=8, frameon=False)
    for ax in axes[-1]:
        ax.set_xlabel("octave (Hz)", fontsize=8)
    return figure


def _absorption(found: Calibration) -> Figure:
    """Every material: the table with the spread of its kind, and what was fitted."""
    fit = found.fit
    rows = -(-len(fit.names) // _COLUMNS)
    figure, axes = plt.subplots(
        rows, _COLUMNS, figsize=(11.0, 2.6 * rows), layout="constrained", squeeze=False, sharey=True
    )
    for ax in axes.flat[len(fit.names) :]:
        ax.set_axis_off()
    for m, (name, ax) in enumerate(zip(fit.names, axes.flat, strict=False)):
        at = _octave_axis(ax, found)
        table, told = found.table[m], ~found.undetermined[m]
        ax.fill_between(
            at, np.clip(table - fit.prior_spread[m], 0, 1), np.clip(table + fit.prior_spread[m], 0, 1),
            color=_GREY, alpha=0.25, lw=0.0, label="table, and the spread of its kind",
        )  # fmt: skip
        ax.plot(at, table, "--", color=_GREY)
        ax.errorbar(
            at[told],
            fit.absorption[m, told],
            fit.spread[m, told],
            fmt="o",
            color=_BLUE,
            ms=4,
            label="fitted",
        )
        ax.plot(
            at[~told],
            fit.absorption[m, ~told],
            "o",
            mfc="white",
            color=_BLUE,
            ms=4,
            label="undetermined",
        )
        ax.set_title(name, fontsize=9)
        ax.set_ylim(0.0, 1.0)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, fontsize=8, frameon=False)
    for row in axes:
        row[0].set_ylabel("absorption")
    return figure
