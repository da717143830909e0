"""The picture of the README: the field of a source over the plan, and what the two ears of one listener get."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.rendering.ambisonics import ambisonic_rir
from soundspaces_sim.rendering.binaural import binaural_rir

_RATE = 44100
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
