"""Calibration of a real room: the studio of Round Robin III (PTB), fitted to one source, tested on the other.

Question: How much nearer to measurements is a simulation with fitted materials, at pairs that the fit has not seen?

Method: `cal.calibrate` of T30, EDT, C80 and D50 as measured of the three pairs of one source, in six octaves, about
the round robin's table, with everything by default: standard errors of half a just-noticeable difference (5 % for
T30 and EDT, 1 dB, 5 percentage points), of interference in single responses, and of the simulation. Errors of the
pairs of the other source, in just-noticeable differences, before and after, each from a simulation with that table;
both ways. Of exact energies: the mean error that interference leaves if energies were known (theory, T68).

Amortised: Nothing is timed.

Takes: 5 minutes. Arguments: subpaths per point (1500), states of the curtains. Needs
../shared/reference/ptb_studio.
"""

from __future__ import annotations

import numpy as np
import soundspaces_calibration as cal

from benchmarks.accuracy.ptb_studio import (
    FOLDER,
    PARAMETERS,
    config_of,
    load_studio,
    measured_pairs,
)
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import require

_MEASURES = ("T30", "EDT", "C80", "D50")


def measured_room(state: str, room: dict) -> cal.MeasuredRoom:
    """What was measured with curtains 'open' or 'closed'."""
    ends = room["sources_m"], room["receivers_m"]
    found = measured_pairs(state)
    shape = len(ends[0]), len(ends[1]), -1
    values = np.stack([found[p].reshape(shape) for p in PARAMETERS], axis=2)
    return cal.MeasuredRoom(
        tuple(ends[0]),
        tuple(ends[1]),
        np.array(list(ends[0].values()), float),
        np.array(list(ends[1].values()), float),
        tuple(map(float, room["frequency_hz"])),
        values,
        np.full(values.shape, np.nan),
    )


def run(walks: str = "1500", *states: str) -> list[Table]:
    """Errors at pairs that were held out, and the fitted materials."""
    require(FOLDER)
    rows: list[tuple[object, ...]] = []
    fitted: list[tuple[object, ...]] = []
    ratios = []
    octaves: tuple[float, ...] = ()
    for state in states or ("open", "closed"):
        scene, room = load_studio(state)
        measured = measured_room(state, room)
        octaves = measured.octaves
        for held in measured.source_names:
            found = cal.calibrate(scene, measured, config_of(room, int(walks)), hold_out=[held])
            what = f"curtains {state}, tested on {held}"
            before, after = (found.errors(v, found.held_out) for v in (found.before, found.after))
            rows += [
                (what, "table", *before),
                (what, f"fitted, {len(found.turns)} simulations", *after),
                (what, "of exact energies", *found.least(found.held_out)),
            ]
            ratios.append(after / before)
            for m, name in enumerate(found.fit.names):
                each = zip(
                    found.fit.absorption[m], found.fit.spread[m], found.undetermined[m], strict=True
                )
                fitted.append(
                    (what, name, *("table" if u else f"{a:.2f} ± {d:.2f}" for a, d, u in each))
                )
    rows.append(("geometric mean of after / before", "", *np.exp(np.mean(np.log(ratios), axis=0))))
    heads = ["pairs that were held out", "materials", *((n, "JND") for n in _MEASURES)]
    bands = [f"{f:g} Hz" for f in octaves]
    return [
        table(
            "Held-out errors before and after calibration", heads, rows, f"{walks} subpaths per point."
        ),
        table("Fitted absorption; `table` where nothing was told", ["fit", "material", *bands], fitted),
    ]
