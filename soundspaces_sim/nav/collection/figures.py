"""Pictures of a collection: distributions over its buildings, and some of the buildings from above and within."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from soundspaces_sim.dataset.format.floorplan import read_floorplan
from soundspaces_sim.dataset.format.manifest import read_manifest
from soundspaces_sim.layout.records import storeys_of
from soundspaces_sim.nav.collection.records import Record, edges_of
from soundspaces_sim.nav.collection.rooms import histogram, times_by_use
from soundspaces_sim.nav.depth import depth_views
from soundspaces_sim.nav.navigation_graph import HEADINGS
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.viz.axonometric import above_picture, inside_picture, write_small
from soundspaces_sim.viz.plan import BLUE, VERMILION, draw_plan

DISTRIBUTIONS, BUILDINGS = "collection_distributions.png", "collection_buildings.png"
_MOST = 6  # buildings on the page


def write_figures(
    out: Path, folder: Path, records: Mapping[str, Record], bands: Sequence[float]
) -> list[Path]:
    """Both pictures into a folder; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    write_small(distributions(records, bands), folder / DISTRIBUTIONS, 80)
    names = list(records)
    chosen = [
        names[k] for k in np.unique(np.linspace(0, len(names) - 1, min(_MOST, len(names))).astype(int))
    ]
    write_small(buildings(out, chosen), folder / BUILDINGS, 80)
    return [folder / DISTRIBUTIONS, folder / BUILDINGS]


def distributions(records: Mapping[str, Record], bands: Sequence[float]) -> Figure:
    """T30 by room beside what was published; C50, DRR and T30 of pairs by band; sizes and error bars."""
    rows, kind = list(records.values()), next(iter(records)).rpartition("-")[0]
    figure = Figure(figsize=(10.5, 5.6), layout="constrained")
    axes = figure.subplots(2, 3)
    histogram(axes[0, 0], kind, times_by_use((room for r in rows for room in r.rooms), bands))
    for ax, name, label in (
        (axes[0, 1], "t30", "T30 of pairs, s"),
        (axes[0, 2], "c50", "C50 of pairs, dB"),
        (axes[1, 0], "drr", "direct-to-reverberant ratio of pairs, dB"),
    ):
        _pairs_histogram(ax, rows, name, label, bands)
    axes[1, 1].scatter([r.area for r in rows], [r.points for r in rows], s=12, color=BLUE)
    axes[1, 1].set(xlabel="floor area, m²", ylabel="points")
    errors = [[100.0 * (v or np.nan) for v in r.late_error] for r in rows]
    axes[1, 2].plot(np.arange(len(bands) - 1), np.array(errors).T, "o", color=VERMILION, ms=3)
    axes[1, 2].set_xticks(
        np.arange(len(bands) - 1), [f"{a:g}–{b:g}" for a, b in pairwise(bands)], fontsize=7
    )
    axes[1, 2].set(xlabel="band, Hz", ylabel="median error of late energy, %", ylim=(0, None))
    return figure


def _pairs_histogram(
    ax: Axes, rows: Sequence[Record], name: str, label: str, bands: Sequence[float]
) -> None:
    edges = edges_of(name)
    for b, (low, high) in enumerate(pairwise(bands)):
        counts = np.sum([r.measures[name].counts[b] for r in rows], axis=0)
        ax.stairs(counts / max(counts.sum(), 1), edges, label=f"{low:g}–{high:g} Hz", lw=1.2)
    total = np.sum([r.measures[name].counts for r in rows], axis=(0, 1))
    seen = np.flatnonzero(total > 1e-3 * total.max())
    if len(seen):
        ax.set_xlim(edges[seen[0]], edges[seen[-1] + 1])
    ax.set(xlabel=label, ylabel="share of pairs")
    ax.legend(fontsize=7)


def buildings(out: Path, names: Sequence[str]) -> Figure:
    """Each from above, its plan with the points, and from within where one sees farthest."""
    figure = Figure(figsize=(10.5, 2.9 * len(names)), layout="constrained")
    for row, name in zip(figure.subplots(len(names), 3, squeeze=False), names, strict=True):
        scene, folder = load_scene(name), out / name
        manifest = read_manifest(folder)
        points = np.array(manifest.points)
        row[0].imshow(above_picture(scene))
        row[0].set_title(f"{name}: {len(points)} points", fontsize=9)
        plan = read_floorplan(folder)
        draw_plan(row[1], plan)
        lowest = storeys_of(plan, points) == 0
        row[1].plot(*points[lowest, :2].T, ".", color=BLUE, ms=4)
        row[1].set_title("lowest storey", fontsize=9)
        far = np.median(depth_views(scene, points, np.array(HEADINGS), 16), axis=(2, 3))
        k, heading = np.unravel_index(far.argmax(), far.shape)
        row[2].imshow(inside_picture(scene, points[k], float(HEADINGS[heading])))
        for ax in (row[0], row[2]):
            ax.axis("off")
    return figure
