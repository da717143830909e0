"""Medians of measures over pairs as a report has them; those of waves below the first band's edge."""

from __future__ import annotations

from typing import Any

import numpy as np

from soundspaces_sim.core.numerics.bands import nominal
from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.echogram.low_measures import has_octave, octaves_below

_PAIRS = 60
_MEASURES = {"t30": ("T30 (s)", 2), "edt": ("EDT (s)", 2), "c50": ("C50 (dB)", 1)}


def median_text(values: np.ndarray, digits: int) -> str:
    """Median, and where 10 to 90 % lie, of finite values (n,)."""
    if len(values) == 0:
        return "–"
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})".replace("-", "−")


def low_medians(ds: RirDataset, table: np.ndarray) -> dict[str, Any]:
    """Names of octaves below the edge of waves, and medians of measures of waves over up to 60 of the pairs of
    `table`. Nothing without waves, or if no octave lies below their edge."""
    low = ds.manifest.config.simulation.low
    edge = ds.manifest.config.simulation.bands[1] if low.edge is None else low.edge
    usable = table[table["status"] == 0]
    stored = any(e.form == "echogram" for e in ds.manifest.shards)
    if low.method != "waves" or not has_octave(edge) or not len(usable) or not stored:
        return {}
    rows = usable[np.linspace(0, len(usable) - 1, min(len(usable), _PAIRS)).astype(int)]
    pairs = np.stack([rows["source"], rows["listener"]], axis=1)
    found = ds.parameters(tuple(_MEASURES), octaves_below(edge), pairs, waves=True)
    medians = []
    for name, (label, digits) in _MEASURES.items():
        columns = found[name].T
        medians.append((label, [median_text(x[np.isfinite(x)], digits) for x in columns]))
    return {"bands": [f"{nominal(f):g} Hz" for f in found.bands.centre], "medians": medians}
