"""What echograms say of themselves: a line or two, and a small picture of the decay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.core.svg import CYCLE, Curve, html, svg

if TYPE_CHECKING:
    from soundspaces_sim.echogram.echogram import Arrival, Echogram, Echograms

_RANGE_DB = 60.0


def arrival(a: Arrival) -> str:
    """Delay, level and direction."""
    planes = f", planes {a.planes}" if a.planes else ""
    planes += f", edges {a.edges}" if a.edges else ""
    direction = ", ".join(f"{x:.2f}" for x in a.direction)
    energy = ", ".join(f"{e:.2e}" for e in np.atleast_1d(a.energy))
    return f"Arrival({1e3 * a.delay:.1f} ms from ({direction}), energy [{energy}] J/m²{planes})"


def echogram(e: Echogram) -> str:
    """Length, bands, arrivals and error bars."""
    direct = (
        f"direct sound at {1e3 * e.direct.delay:.1f} ms" if e.direct is not None else "no direct sound"
    )
    edges = ", ".join(f"{b:g}" for b in e.bands)
    early, late = (100.0 * float(np.max(x)) for x in e.relative_error)
    return (
        f"Echogram: {e.time_edges[-1]:g} s in {len(e.energy)} bins, bands at {edges} Hz\n"
        f"  {direct}, {len(e.early)} early reflections, in sight: {'yes' if e.visible else 'no'}; "
        f"standard error up to {early:.1f} % early, {late:.1f} % late"
    )


def echograms(e: Echograms) -> str:
    """How many, how long, how large."""
    s, l = e.shape
    return (
        f"Echograms: {s} sources × {l} listeners, {e.time_edges[-1]:g} s in {len(e.time_edges) - 1} bins, "
        f"{len(e.bands) - 1} bands, {e.energy.nbytes / 1e6:.1f} MB"
    )


def echogram_picture(e: Echogram) -> str:
    """HTML: the text above the energy per 10 ms in each band, over 60 dB."""
    bin_s = 0.01
    energy = e.histogram(bin_s)
    with np.errstate(divide="ignore"):
        level = 10.0 * np.log10(energy / max(float(energy.max()), 1e-300))
    level[level < -_RANGE_DB] = np.nan
    time = (np.arange(energy.shape[1]) + 0.5) * bin_s
    curves = [Curve(np.stack([time, row], axis=1), CYCLE[b % len(CYCLE)]) for b, row in enumerate(level)]
    return html(echogram(e), svg(curves, 360, 160, same_scale=False))
