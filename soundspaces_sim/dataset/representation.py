"""Text and HTML representation of a dataset."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.svg import BLUE, GREY, Dots, Layer, Lines, html, svg
from soundspaces_sim.dataset.format.floorplan import read_floorplan

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
    lowest = np.isclose(ds.points[:, 2], ds.points[:, 2].min(), atol=0.1)
    edges = np.array(ds.manifest.edges, int).reshape(-1, 2)
    edges = edges[lowest[edges].all(axis=1)]
    layers: list[Layer] = [
        Lines(ds.points[edges][:, :, :2].reshape(-1, 4), BLUE, 0.6),
        Dots(ds.points[lowest, :2], BLUE, 1.8),
    ]
    try:
        layers.insert(0, Lines(read_floorplan(ds.path).walls[0], GREY, 1.2))
    except DatasetError as error:  # datasets of old versions have none
        _log.debug("%s", error)
    return html(text(ds), svg(layers))
