"""Text and HTML representations of echograms: a line or two, and a small plot of the decay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from soundspaces_sim.core.svg import CYCLE, Curve, html, svg

_RANGE_DB = 60.0


def arrival_text(
    delay: float, energy: np.ndarray, direction: np.ndarray, planes: Sequence[int], edges: Sequence[int]
) -> str:
    """Delay (s), direction (3,), energy (bands,), and the planes and edges that it met."""
    met = f", planes {tuple(planes)}" if planes else ""
    met += f", edges {tuple(edges)}" if edges else ""
    axes = ", ".join(f"{x:.2f}" for x in direction)
    values = ", ".join(f"{e:.2e}" for e in np.atleast_1d(energy))
    return f"Arrival({1e3 * delay:.1f} ms from ({axes}), energy [{values}] J/m²{met})"


def echogram_text(
    bands: Sequence[float],
    time_edges: np.ndarray,
    direct_delay: float | None,
    early: int,
    visible: bool,
    relative_error: np.ndarray,
) -> str:
    """Duration, bands (edges in Hz), arrivals and standard errors (2, bands)."""
    direct = (
        "no direct sound" if direct_delay is None else f"direct sound at {1e3 * direct_delay:.1f} ms"
    )
    edges = ", ".join(f"{b:g}" for b in bands)
    of_early, of_late = (100.0 * float(np.max(x)) for x in relative_error)
    return (
        f"Echogram: {time_edges[-1]:g} s in {len(time_edges) - 1} bins, bands at {edges} Hz\n"
        f"  {direct}, {early} early reflections, in sight: {'yes' if visible else 'no'}; "
        f"standard error up to {of_early:.1f} % early, {of_late:.1f} % late"
    )


def echograms_text(
    shape: tuple[int, int], bands: Sequence[float], time_edges: np.ndarray, nbytes: int
) -> str:
    """Numbers of sources and listeners (`shape`), duration and size."""
    return (
        f"Echograms: {shape[0]} sources × {shape[1]} listeners, {time_edges[-1]:g} s in "
        f"{len(time_edges) - 1} bins, {len(bands) - 1} bands, {nbytes / 1e6:.1f} MB"
    )


def decay_html(text: str, energy: np.ndarray, bin_s: float) -> str:
    """HTML: `text` above the levels of energies (bands, n) in bins of `bin_s` s, over 60 dB."""
    with np.errstate(divide="ignore"):
        level = 10.0 * np.log10(energy / max(float(energy.max()), 1e-300))
    level[level < -_RANGE_DB] = np.nan
    time = (np.arange(energy.shape[1]) + 0.5) * bin_s
    curves = [Curve(np.stack([time, row], axis=1), CYCLE[b % len(CYCLE)]) for b, row in enumerate(level)]
    return html(text, svg(curves, 360, 160, same_scale=False))
