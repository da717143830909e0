"""Figures of theory.md, drawn by the code's own formulas: `python docs/theory_figures.py` in the clone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.transport.arrivals.field import (
    EdgePath,
    field_at,
    front_of,
    make_spectrum,
    terms_of,
)
from soundspaces_sim.transport.bsdf.finite_size import kept_in_beam
from soundspaces_sim.transport.bsdf.impedance import impedance

OUT = Path(__file__).parent / "figures"
C = 343.0  # m/s
BLUE, RED, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#777777"


@kernel
def _diffracted(source: float, there: float, leg: float, k: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` with the pressure behind a half-plane at wave numbers `k`; angles about the edge, legs in m."""
    end, plus = np.inf, there + source
    path = EdgePath(
        2.0, there - source, plus, 4.0 * np.pi - plus, leg, leg, 1.0, 0.5, 1.0, end, end, 1.0
    )
    front = front_of(path, terms_of(path))
    for i in range(len(k)):
        out[i] = field_at(path, front, k[i], (1.0, 1.0))


def surfaces() -> Figure:
    """Absorption by angle (T9), and what leaves the beam of a square panel (T14)."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    angle = np.linspace(0.0, 90.0, 181)
    for table, colour in ((0.8, RED), (0.4, GREEN), (0.1, BLUE)):
        z = impedance(np.array(table)) * np.cos(np.deg2rad(angle))
        left.plot(angle, 4.0 * z / (1.0 + z) ** 2, color=colour, label=f"table: {table}")
        left.axhline(table, color=colour, lw=0.6, ls=":")
    left.set(xlabel="angle of incidence (°)", ylabel="absorption", xlim=(0, 90), ylim=(0, 1))
    left.legend()
    edges = np.geomspace(63.0, 16000.0, 129)
    for side, colour in ((0.5, RED), (1.0, GREEN), (2.0, BLUE)):
        row = np.array([[0.5 * side] * 4 + [2.0]])
        parts = (edges[:65], edges[64:])  # at most 64 bands at a time
        lost = np.concatenate([1.0 - kept_in_beam(row, tuple(part), C)[0] for part in parts])
        right.semilogx(np.sqrt(edges[1:] * edges[:-1]), lost, color=colour, label=f"{side:g} m square")
    right.set(xlabel="frequency (Hz)", ylabel="share that leaves the beam", ylim=(0, 1))
    right.legend()
    return figure


def diffraction() -> Figure:
    """Direct and diffracted sound about a half-plane (T30, T32, T36), means over the four bands."""
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    ax = figure.subplots()
    source, leg = 0.5 * np.pi, 2.0
    bands, weight = make_spectrum(DEFAULT_BANDS, C)[:2]
    angle = np.deg2rad(np.concatenate([np.linspace(182.0, 269.9, 300), np.linspace(270.1, 350.0, 300)]))
    for band, (k, colour) in enumerate(zip(bands, (BLUE, GREEN, "#E69F00", RED), strict=True)):
        level = np.zeros(len(angle))
        for i, there in enumerate(angle):
            turn = there - source
            straight = 2.0 * leg * np.sin(0.5 * min(turn, 2.0 * np.pi - turn))
            field = np.empty(len(k), complex)
            _diffracted(source, float(there), leg, k, field)
            field *= np.exp(-1j * k * 2.0 * leg)
            if turn < np.pi:
                field += np.exp(-1j * k * straight) / straight
            level[i] = 10.0 * np.log10(weight @ np.abs(field) ** 2 * (2.0 * leg) ** 2)
        name = f"{DEFAULT_BANDS[band]:g}–{DEFAULT_BANDS[band + 1]:g} Hz"
        ax.plot(np.rad2deg(angle) - 270.0, level, color=colour, label=name)
    ax.axvline(0.0, color=GREY, lw=0.8, ls="--")
    ax.text(2.0, 3.2, "shadow", color=GREY)
    ax.text(-2.0, 3.2, "in sight", color=GREY, ha="right")
    ax.set(
        xlabel="angle past the shadow boundary (°)",
        ylabel="level re free field at 4 m (dB)",
        ylim=(-30, 6),
    )
    ax.legend(fontsize=8)
    return figure


def _room(ax: Axes, title: str) -> None:
    ax.plot([0, 6, 6, 0, 0], [0, 0, 4, 4, 0], color="black", lw=1.5)
    ax.plot([3.6, 3.6], [1.7, 4.0], color="black", lw=4)
    ax.set_xlim(-0.3, 6.3)
    ax.set_ylim(-0.3, 4.3)
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.set_title(title, fontsize=9)


def _points(ax: Axes) -> None:
    for (x, y), name, marker in ((P, "p", "*"), (Q, "q", "o")):
        ax.plot(x, y, marker=marker, color="black", ms=9, zorder=5)
        ax.text(x, y + 0.22, f"${name}$", ha="center", fontsize=10)


def _way(ax: Axes, *places: tuple[float, float], **style: object) -> None:
    x, y = zip(*places, strict=True)
    ax.plot(x, y, **{"lw": 1.3, **style})  # type: ignore[arg-type]


P, Q = (1.2, 2.7), (5.0, 2.7)


def techniques() -> Figure:
    """Who makes which path, in plan."""
    figure = Figure(figsize=(10.5, 2.9), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _room(left, "deterministic: image source, edge")
    _way(left, P, (3.1, 0.0), Q, color=BLUE)
    _way(left, P, (3.6, 1.7), Q, color=RED)
    left.text(2.1, 0.55, "specular", color=BLUE, fontsize=8, ha="right")
    left.text(3.75, 1.55, "diffracted", color=RED, fontsize=8)
    _room(middle, "bidirectional: subpaths, connections, receiver volume")
    middle.add_patch(Circle(Q, 0.45, color="#dddddd", zorder=0))
    a, b, x = (0.0, 1.6), (2.2, 0.0), (3.0, 0.0)
    y, z = (6.0, 1.4), (4.6, 0.0)
    _way(middle, P, a, b, color=BLUE, ls="--")
    _way(middle, Q, y, z, color=RED, ls="--")
    for from_, to in ((b, y), (a, z)):
        _way(middle, from_, to, color=GREEN, lw=1.0)
    _way(middle, P, x, (6.0, 3.6), color=BLUE, ls="--", lw=0.9)
    for place, colour in ((a, BLUE), (b, BLUE), (y, RED), (z, RED), (x, BLUE)):
        middle.plot(*place, "s", color=colour, ms=5, zorder=4)
    middle.text(0.4, 1.52, "connections", color=GREEN, fontsize=8)
    _room(right, "late: radiance transfer between patches")
    for k in range(8):
        right.add_patch(Rectangle((0.75 * k + 0.04, -0.12), 0.67, 0.12, color="#cccccc"))
    first, second, last = (1.1, 0.0), (0.0, 1.2), (4.9, 0.0)
    _way(right, P, first, color=BLUE, ls="--")
    _way(right, first, second, last, color=GREEN)
    _way(right, last, Q, color=RED, ls="--")
    right.text(1.25, 1.5, "$F_{p,a}$", color=BLUE, fontsize=9)
    right.text(2.3, 0.75, "$H_{a \\to c}$", color=GREEN, fontsize=9)
    right.text(5.05, 1.2, "$F_{q,c}$", color=RED, fontsize=9)
    for ax in (left, middle, right):
        _points(ax)
    return figure


def main() -> None:
    """Write the figures beside the pages."""
    for name, figure in (
        ("surfaces", surfaces()),
        ("diffraction", diffraction()),
        ("techniques", techniques()),
    ):
        figure.savefig(OUT / f"theory_{name}.png", dpi=110)


if __name__ == "__main__":
    main()
