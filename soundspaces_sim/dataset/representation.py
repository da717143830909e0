"""Text and HTML representation of a dataset."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.svg import BLUE, GREY, Dots, Layer, Lines, html, svg
from soundspaces_sim.dataset.format.floorplan import read_floorplan
from soundspaces_sim.layout.records import storeys_of

if TYPE_CHECKING:
    from soundspaces_sim.dataset.reader import RirDataset

_log = logging.getLogger(__name__)


def text(ds: RirDataset) -> str:
    """Points, pairs, lengths, what is stored, and how much it is."""
    found = ds.manifest
    forms = " and ".join(
        f"{f}s" for f in ("echogram", "waveform") if any(e.form == f for e in found.shards)
    )
    size = sum(e.bytes for e in found.shards)
    bands = len(found.config.simulation.bands) - 1
    return (
        f"RirDataset({str(ds.path)!r}): {len(ds):,} pairs of {len(ds.points):,} points in '{ds.scene}', "
        f"{found.duration:g} s each\n  {forms}, {bands} bands, rendered at {ds.rate:,} Hz, {size / 1e6:.1f} MB"
    )


def picture(ds: RirDataset) -> str:
    """HTML: the text above the floor plan of the lowest storey, its points and navigation graph."""
    try:
        plan = read_floorplan(ds.path)
        lowest = storeys_of(plan, ds.points) == 0
        walls: list[Layer] = [Lines(plan.walls[0], GREY, 1.2)]
    except DatasetError as error:  # datasets of old versions have none
        _log.debug("%s", error)
        lowest, walls = np.ones(len(ds.points), bool), []
    edges = np.array(ds.manifest.edges, int).reshape(-1, 2)
    edges = edges[lowest[edges].all(axis=1)]
    layers: list[Layer] = [
        *walls,
        Lines(ds.points[edges][:, :, :2].reshape(-1, 4), BLUE, 0.6),
        Dots(ds.points[lowest, :2], BLUE, 1.8),
    ]
    return html(text(ds), svg(layers))
