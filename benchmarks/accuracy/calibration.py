"""Calibration of a real room: the studio of Round Robin III (PTB), fitted to one source, tested on the other.

Question: How much nearer to measurements is a simulation with fitted materials, at pairs that the fit has not seen?

Method: T30, EDT, C80 and D50 as measured of the three pairs of one source, in six octaves, with a standard error of
one just-noticeable difference (5 % for T30 and EDT, 1 dB, 5 percentage points) and that of the simulation, fit the
absorption of the counted materials (`fit_materials`; layers that hang free stay) about the round robin's table,
with the spreads of kinds of products and of laboratories. Where counts do not reach so far it is simulated anew,
and fitted again, three times at most. Errors of the pairs of the other source, in just-noticeable differences,
before and after, each from a simulation with that table and another seed; both ways.

Amortised: Nothing is timed.

Takes: 20 minutes. Arguments: subpaths per point (1500), states of the curtains. Needs
../shared/reference/ptb_studio.
"""

from __future__ import annotations

import json
from dataclasses import replace

import msgspec
import numpy as np

import soundspaces_sim as ss
from benchmarks.accuracy.ptb_studio import (
    FOLDER,
    PARAMETERS,
    config_of,
    jnd,
    load_studio,
    measured_pairs,
)
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import require
from soundspaces_sim.echogram.fit_materials import MaterialFit, fit_materials
from soundspaces_sim.echogram.measure_names import MEASURES as NAMES
from soundspaces_sim.echogram.measures import room_measures

MEASURES = ("core", "scene", "transport", "echogram")
_NAMES = ("t30", "edt", "c80", "d50")
_ROUNDS = 3


def _with(scene: ss.Scene, names: tuple[str, ...], absorption: np.ndarray) -> ss.Scene:
    """The scene with other absorption (M, octaves) of some materials."""
    old = scene.materials
    values = old.absorption.copy()
    for name, row in zip(names, absorption, strict=True):
        values[old.index(name)] = row
    return replace(scene, materials=replace(old, absorption=values))


class _Room:
    """The studio in one state, and what was measured there."""

    def __init__(self, state: str, walks: int) -> None:
        self.scene, room = load_studio(state)
        self.config = msgspec.structs.replace(
            config_of(room, walks), materials=ss.MaterialsConfig(enabled=True)
        )
        self.sources, self.receivers = (list(room[end].values()) for end in ("sources_m", "receivers_m"))
        found = measured_pairs(state)
        shape = len(self.sources), len(self.receivers), -1
        self.measured = np.stack([found[p].reshape(shape) for p in PARAMETERS], axis=2)

    def simulate(self, scene: ss.Scene, seed: int) -> ss.Echograms:
        return ss.simulate(scene, self.sources, self.receivers, self.config, seed)

    def errors(self, scene: ss.Scene, source: int) -> list[float]:
        """Mean errors in JND of each parameter at the pairs of a source."""
        echoes = self.simulate(scene, 1)
        out = []
        for k, name in enumerate(_NAMES):
            found = [getattr(room_measures(echoes[source, j]), name) for j in range(len(self.receivers))]
            out.append(
                float(np.nanmean(jnd(PARAMETERS[k], np.array(found), self.measured[source, :, k])))
            )
        return out

    def fit(self, source: int) -> tuple[ss.Scene, MaterialFit, int]:
        """Fitted to the pairs of a source: the scene with it, the fit, and how often it was simulated."""
        scene, about = self.scene, None
        wanted = self.measured[source]
        one = np.array([0.05, 0.05, 1.0, 0.05])[:, None] * np.where(
            np.arange(4)[:, None] < 2, wanted, 1.0
        )
        turns = 0
        while True:
            turns += 1
            echoes = self.simulate(scene, 0)
            assert echoes.measure_error is not None and echoes.counts is not None
            pairs = [echoes[source, j] for j in range(len(self.receivers))]
            rows = [NAMES.index(name) for name in _NAMES]
            own = np.nan_to_num(echoes.measure_error[source][:, rows])
            if about is None:
                about = echoes.counts.groups.absorption
            values = np.array([[getattr(room_measures(p), n) for n in _NAMES] for p in pairs])
            known = np.where(np.isfinite(values), wanted, np.nan)
            fit = fit_materials(pairs, known, np.hypot(one, own), _NAMES, about=about)
            scene = _with(scene, fit.names, fit.absorption)
            if fit.within or turns == _ROUNDS:
                return scene, fit, turns


def run(walks: str = "1500", *states: str) -> list[Table]:
    """Errors at pairs that were held out, and the fitted materials."""
    require(FOLDER)
    rows: list[tuple[object, ...]] = []
    fitted: list[tuple[object, ...]] = []
    ratios = []
    octaves = json.loads((FOLDER / "room.json").read_text())["frequency_hz"]
    for state in states or ("open", "closed"):
        room = _Room(state, int(walks))
        for source in range(len(room.sources)):
            scene, fit, turns = room.fit(source)
            other = 1 - source
            before, after = room.errors(room.scene, other), room.errors(scene, other)
            what = f"curtains {state}, fitted to source {source + 1}"
            rows += [(what, "table", *before), (what, f"fitted, {turns} simulations", *after)]
            ratios.append(np.array(after) / np.array(before))
            for m, name in enumerate(fit.names):
                told = ["table" if u else f"{a:.2f} ± {d:.2f}" for a, d, u in zip(
                    fit.absorption[m], fit.spread[m], fit.undetermined[m], strict=True)]  # fmt: skip
                fitted.append((what, name, *told))
    rows.append(("geometric mean of after / before", "", *np.exp(np.mean(np.log(ratios), axis=0))))
    heads = [
        "pairs of the other source",
        "materials",
        *((n, "JND") for n in ("T30", "EDT", "C80", "D50")),
    ]
    bands = [f"{f:g} Hz" for f in octaves]
    return [
        table(
            "Held-out errors before and after calibration", heads, rows, f"{walks} subpaths per point."
        ),
        table("Fitted absorption; `table` where nothing was told", ["fit", "material", *bands], fitted),
    ]
