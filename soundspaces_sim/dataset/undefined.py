"""Reverberation times of a dataset that are not defined: of how many pairs, why, and what to set."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.echogram.measures import why_undefined


def undefined_times(ds: RirDataset, table: np.ndarray) -> list[str]:
    """A sentence for each time and band that pairs of a `table` without collocated ones lack."""
    out = []
    usable = table[table["status"] == 0]
    for name in ("t30", "edt"):
        for b, (low, high) in enumerate(pairwise(ds.manifest.config.simulation.bands)):
            lost = usable[np.isnan(usable[f"{name}_{b}"])]
            if not len(lost):
                continue
            why = ""
            if ds.manifest.config.dataset.store != "waveform":
                first = ds.echogram(int(lost["source"][0]), int(lost["listener"][0]))
                why = f"; of the first of these, {why_undefined(first, name, b)}"
            count = f"{len(lost):,} of {len(usable):,} pairs"
            out.append(f"{name.upper()} of {low:g}–{high:g} Hz is not defined in {count}{why}")
    return out
