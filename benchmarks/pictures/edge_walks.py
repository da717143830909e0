"""Levels along walks past edges: now, as version 0.2.0 had them, and by boundary elements.

    python -m benchmarks.pictures.edge_walks [file.png]

The walks and their reference are those of `tests/transport/edge_walks.py`; what 0.2.0 gave is stored beside them.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib
import numpy as np

from tests.transport.edge_walks import BANDS, TABLE, WALKS
from tests.transport.test_edge_walks import levels_of, reference_of

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SHOWN = (
    "jamb of 12 cm",
    "jamb of 12 cm, along the wall",
    "pillar of 40 cm",
    "cupboard on a floor",
)
BEFORE = TABLE.with_name("edge_walks_0.2.0.json")
COLOURS = ("#0072B2", "#009E73", "#E69F00", "#D55E00")


def draw(file: Path) -> None:
    """One panel for each walk, the four bands in it."""
    before = json.loads(BEFORE.read_text())
    figure, axes = plt.subplots(2, 2, figsize=(11.0, 7.0), layout="constrained")
    for ax, name in zip(axes.flat, SHOWN, strict=True):
        walk = WALKS[name]
        places = walk.places()
        along = places[:, np.ptp(places, axis=0).argmax()]
        ours, exact, old = levels_of(walk), reference_of(name), np.array(before[name])
        for b, colour in enumerate(COLOURS):
            low = BANDS[b] or 0.5 * BANDS[1]
            ax.plot(along, exact[:, b], color=colour, lw=4.0, alpha=0.3)
            ax.plot(along, ours[:, b], color=colour, lw=1.2, label=f"{low:.0f} to {BANDS[b + 1]:.0f} Hz")
            ax.plot(along, old[:, b], color=colour, lw=0.8, ls=":")
        ax.set(title=name, xlabel="height or place along the walk (m)", ylabel="level (dB)")
    axes[0, 0].legend(title="wide: boundary elements\nline: now, dots: 0.2.0", fontsize=8)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    draw(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/figures/edge_walks.png"))
