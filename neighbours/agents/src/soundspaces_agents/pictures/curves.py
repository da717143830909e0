"""Learning curves of a study's runs."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from soundspaces_agents.experiments import Variant

_COLOURS = (
    "#0072B2 #D55E00 #009E73 #CC79A7 #E69F00 #56B4E9 #882255 #999933 "
    "#000000 #7F3C8D #A0A0A0 #6B4C2A #F2B6C6"
).split()  # one for each variant of a preset


Runs = Iterable[tuple[Variant, int, list[dict[str, float]]]]  # arm, seed, learning curve


def draw_curves(runs: Runs, path: Path) -> bool:
    """Mean SPL over the seeds of each arm against steps, and between its worst and best seed, the arms by what they
    end with; False, and no file, if there is no run."""
    arms = [
        (variant, *_over_seeds([rows for _, _, rows in own]))
        for variant, own in groupby(runs, lambda run: run[0])
    ]
    if not arms:
        return False
    figure = Figure(figsize=(8.5, 4.5), layout="constrained")
    axes = figure.add_subplot()
    colours = [_COLOURS[k % len(_COLOURS)] for k in range(len(arms))]
    order = sorted(range(len(arms)), key=lambda k: -arms[k][2][:, -1].mean())
    for k in order:
        variant, steps, spl = arms[k]
        style = "--" if variant.method == "dagger" else "-"
        axes.plot(steps, spl.mean(axis=0), style, color=colours[k], lw=1.5, label=variant.name)
        axes.fill_between(steps, spl.min(axis=0), spl.max(axis=0), color=colours[k], alpha=0.2, lw=0.0)
    figure.legend(loc="outside right center", frameon=False, fontsize=8)
    axes.set_xlabel("steps (millions)")
    axes.set_ylabel("SPL while training, last 400 episodes")
    axes.set_ylim(0.0, 1.0)
    figure.savefig(path, dpi=90)
    return True


def _over_seeds(runs: list[list[dict[str, float]]]) -> tuple[np.ndarray, np.ndarray]:
    """(n,) millions of steps up to which all runs have come, and (runs, n) SPL there."""
    columns = [(np.array([r["steps"] / 1e6 for r in rows]), [r["spl"] for r in rows]) for rows in runs]
    steps = min((steps for steps, _ in columns), key=lambda s: float(s[-1]))
    return steps, np.array([np.interp(steps, own, spl) for own, spl in columns])
