"""The genuine rlr_audio_propagation beside `soundspaces_sim.rlr` in a box and in the house.

Question: By how much do levels, EDT and T30 of the two engines differ, octave by octave?

Method: The same calls to both, at their defaults (5,000 rays, one thread): means over 24 pairs of ours less
theirs, with standard errors over the pairs, so of both engines' noise; three runs of each in the box, two in
aws_small_house. And the example of docs/rlr.md, run as it is printed there under either package.

Amortised: Nothing is timed.

Takes: 20 minutes. Needs ../shared and rlr-audio-propagation 0.0.1 (licensed for non-commercial use).
"""

from __future__ import annotations

import contextlib
import io
import sys
from types import ModuleType
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import ROOT, Table, table
from benchmarks.tools.rlr import (
    OCTAVES,
    box_of,
    context,
    genuine,
    octave_measures,
    populate,
    responses,
    simulations,
)
from benchmarks.tools.scenes import BOX, house, shuffled_points
from soundspaces_sim.rlr import api

MEASURES = ("core", "scene", "transport", "echogram", "rendering", "rlr")


def _compare(
    module: ModuleType, name: str, scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, runs: int,
    **settings: Any,
) -> Table:  # fmt: skip
    found = []
    for each in (api, module):
        made = context(each, scene, **settings)
        populate(each, made, sources, listeners)
        measured = [
            octave_measures(responses(made, len(sources), len(listeners)))
            for _ in simulations(made, runs)
        ]
        found.append({key: np.nanmean([m[key] for m in measured], axis=0) for key in measured[0]})
    ours, theirs = found
    pairs = len(sources) * len(listeners)
    rows: list[tuple[object, ...]] = []
    for key in ours:
        scale = 1.0 if key == "level" else 100.0 / np.nanmean(theirs[key], axis=0)
        off = (ours[key] - theirs[key]) * scale
        mean, error = np.nanmean(off, axis=0), np.nanstd(off, axis=0, ddof=1) / np.sqrt(pairs)
        unit = "dB" if key == "level" else "%"
        cells = [f"{m:+.1f} ± {e:.1f}" for m, e in zip(mean, error, strict=True)]
        rows.append((f"{key}, ours less theirs, {unit}", *cells))
        if key != "level":
            rows.append((f"{key}, ours, s", *np.nanmean(ours[key], axis=0)))
            rows.append((f"{key}, theirs, s", *np.nanmean(theirs[key], axis=0)))
    heads = ["", *((f"{f}", "Hz") for f in OCTAVES)]
    return table(name, heads, rows, f"{pairs} pairs, {runs} runs of each.")


def _example(module: ModuleType) -> Table:
    page = (ROOT / "docs" / "rlr.md").read_text("utf-8")
    code = next(
        block.partition("```")[0]
        for block in page.split("```python\n")[1:]
        if block.startswith("from rlr_audio_propagation import")
    )
    rows = []
    for who, each in (("ours", api), ("theirs", module)):
        said = io.StringIO()
        sys.modules["rlr_audio_propagation"] = each
        try:
            with contextlib.redirect_stdout(said):
                exec(code, {"__name__": "example"})
        finally:
            sys.modules["rlr_audio_propagation"] = module
        rows.append((who, said.getvalue().strip()))
    return table("The example of docs/rlr.md under both", ["", "what it prints"], rows)


def _diffuse(scene: ss.Scene) -> ss.Scene:
    """The scene with walls that scatter all they reflect."""
    old = scene.materials
    new = ss.MaterialTable(
        old.names, old.frequency_hz, old.absorption, np.ones_like(old.scattering), old.transmission
    )
    return ss.Scene(
        scene.vertices, scene.faces, scene.face_material, new, name=f"{scene.name}, scattering 1"
    )


def run() -> list[Table]:
    """Example, box, house."""
    module, scene = genuine(), house()
    points = shuffled_points(scene)
    places = np.random.default_rng(0).uniform(0.5, np.array(BOX) - 0.5, (10, 3))
    tables = [_example(module)]
    for scattering in (1.0, 0.3):
        name = f"Box 6 × 5 × 2.7 m, absorption .2, scattering {scattering}"
        tables.append(_compare(module, name, box_of(0.2, scattering), places[:4], places[4:], 3))
    ends, diffuse = (points[:4], points[4:10]), _diffuse(scene)
    tables += [
        _compare(module, f"{diffuse.name}, no transmission", diffuse, *ends, 2, transmission=0),
        _compare(module, diffuse.name, diffuse, *ends, 2),
        _compare(module, scene.name, scene, *ends, 2),
    ]
    return tables
