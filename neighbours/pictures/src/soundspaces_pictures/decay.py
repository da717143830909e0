"""Energy decay curves per band, their T30, and how sure they are."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from soundspaces_sim import Echogram
from soundspaces_sim.echogram import room_measures
from soundspaces_sim.parts import decay_curve

_BIN_S = 0.001
BAND_COLOURS = ["#0072B2", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#D55E00", "#777777", "#000000"]


def draw_decay(ax: Axes, echogram: Echogram, lowest_db: float = -60.0) -> None:
    """Schroeder curves with the T30 line (dashed) and a band of two standard errors of the late energy."""
    energy = echogram.histogram(_BIN_S)
    curves = decay_curve(energy)
    t30 = room_measures(echogram).t30
    time = np.arange(energy.shape[1]) * _BIN_S
    for b, (low, high) in enumerate(zip(echogram.bands[:-1], echogram.bands[1:], strict=True)):
        colour = BAND_COLOURS[b % len(BAND_COLOURS)]
        name = f"{low:.0f}–{high:.0f} Hz" + (f", T30 {t30[b]:.2f} s" if np.isfinite(t30[b]) else "")
        shown = curves[b] >= lowest_db
        ax.plot(time[shown], curves[b][shown], color=colour, lw=1.6, label=name)
        share = min(2.0 * float(echogram.relative_error[1, b]), 1e3)  # not known: all that is drawn
        with np.errstate(divide="ignore"):
            band = 10.0 * np.log10([max(1.0 - share, 1e-3), 1.0 + share])
        ax.fill_between(
            time[shown], curves[b][shown] + band[0], curves[b][shown] + band[1], color=colour, alpha=0.15
        )
        if np.isfinite(t30[b]):
            fitted = (curves[b] <= -5.0) & (curves[b] >= -35.0)
            line = np.mean(curves[b][fitted]) - 60.0 / t30[b] * (time - np.mean(time[fitted]))
            use = (line <= 0.0) & (line >= max(lowest_db, -45.0))
            ax.plot(time[use], line[use], color=colour, ls="--", lw=1.0)
    ax.set_ylim(lowest_db, 2.0)
    ax.set_xlim(left=0.0)
    ax.set_xlabel("time (s)")
    ax.set_ylabel("energy decay (dB)")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8, frameon=False)
