"""Where sound comes from: horizontal energy patterns at listeners, drawn on the map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from soundspaces_pictures.plan import BLUE, VERMILION, draw_plan
from soundspaces_sim import Echogram
from soundspaces_sim.parts import FloorPlan, spherical_harmonics

_LABEL = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
_ORDER = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2])
# max-rE weights of order 2 (Daniel 2000; Zotter & Frank 2019): a pattern without strong side lobes
_MAX_RE = np.array([1.0, 0.775, 0.4])


def moments(echogram: Echogram, direct_only: bool) -> np.ndarray:
    """(9,) energy-weighted spherical harmonics (ACN, SN3D) of the direct sound, or of all of the response."""
    out = np.zeros(9) if direct_only else echogram.energy.sum(axis=(0, 2), dtype=float)
    for arrival in [a for a in (echogram.direct,) if a] if direct_only else echogram.arrivals:
        out = out + spherical_harmonics(arrival.direction) * arrival.energy.sum()
    return np.asarray(out)


def lobe(moments_: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Energy pattern at azimuths (n,) in rad, relative to its largest value: the sum of
    (2 n + 1) g_n S_nm Y_nm with max-rE weights g_n."""
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)
    weights = (2 * _ORDER + 1) * _MAX_RE[_ORDER]
    pattern = np.maximum(spherical_harmonics(directions) @ (weights * moments_), 0.0)
    return np.asarray(pattern / pattern.max()) if pattern.max() > 0.0 else np.zeros_like(azimuth)


def draw_lobes(
    ax: Axes,
    plan: FloorPlan,
    source: np.ndarray,
    listeners: np.ndarray,
    echograms: Sequence[Echogram],
    storey: int = 0,
    size: float = 1.0,
) -> None:
    """Patterns of the direct sound and of the whole response at listeners (n, 3), `size` m long.

    The radius is proportional to energy; rings mark the strongest direction (0 dB) and half of its energy.
    """
    draw_plan(ax, plan, storey)
    azimuth = np.linspace(0.0, 2.0 * np.pi, 361)
    for k, (place, echogram) in enumerate(zip(listeners, echograms, strict=True)):
        for direct, colour, name in ((False, BLUE, "whole response"), (True, VERMILION, "direct sound")):
            radius = size * lobe(moments(echogram, direct), azimuth)
            if not radius.any():
                continue
            x, y = place[0] + radius * np.cos(azimuth), place[1] + radius * np.sin(azimuth)
            ax.fill(x, y, color=colour, alpha=0.35, zorder=5)
            ax.plot(x, y, color=colour, lw=1.4, zorder=6, label=name if k == 0 or not direct else None)
        for ring, level in ((1.0, "0 dB"), (0.5, "−3 dB")):
            x, y = place[0] + ring * size * np.cos(azimuth), place[1] + ring * size * np.sin(azimuth)
            ax.plot(x, y, color="black", lw=0.6, ls=":", zorder=4)
            top = (place[0], place[1] + ring * size)
            ax.annotate(level, top, ha="center", va="center", fontsize=6.5, zorder=8, bbox=_LABEL)
        ax.plot(*place[:2], "o", color="black", ms=4, zorder=7)
        ax.annotate(f"L{k + 1}", place[:2], (5, 5), textcoords="offset points", fontsize=9, zorder=8)
    ax.plot(*source[:2], "*", color="black", mec="white", ms=13, ls="", zorder=7, label="source")
    handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
    ax.legend(
        handles.values(),
        handles.keys(),
        loc="upper center",
        bbox_to_anchor=(0.5, -0.09),
        ncols=3,
        frameon=False,
    )
