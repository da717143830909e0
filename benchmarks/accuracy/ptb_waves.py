"""The lowest octave of a real room, by rays and by waves: the studio of Round Robin III (PTB) at 125 Hz.

Question: Are T30, EDT, C80 and D50 at 125 Hz nearer to what was measured if that octave is simulated as waves?

Method: Materials and positions are the round robin's; nothing is tuned. Rays: measures of echograms. Waves: those
of the pressure that `simulate_low` gives up to 220 Hz (8 cells per wavelength there, 14 at 125 Hz), cut to the
octave. The round robin has no 63 Hz, neither materials nor measurements. What calibration would say: the factor
on the absorption of all walls, or of curtains alone, with which the waves' mean T30 is as measured.

Amortised: Nothing is timed.

Takes: Two minutes of processor time. Argument: subpaths per point (300). Needs ../shared/reference/ptb_studio.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

import soundspaces_sim as ss
from benchmarks.accuracy.ptb_studio import FOLDER, config_of, jnd, load_studio, measured_pairs
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import require
from soundspaces_sim.echogram.measures import room_measures, waveform_measures

MEASURES = ("core", "scene", "transport", "echogram")
_EDGE, _CELLS, _DURATION = 220.0, 8.0, 1.6
_OCTAVE = (0.0, 125.0 / np.sqrt(2.0), 125.0 * np.sqrt(2.0))
_NAMES = {"T30": "t30", "EDT": "edt", "C": "c80", "D": "d50"}


def _found(state: str, walks: int) -> dict[str, np.ndarray]:
    """By model (pairs, parameters), sources outermost."""
    scene, room = load_studio(state)
    config = msgspec.structs.replace(config_of(room, walks), duration=_DURATION)
    echoes = ss.simulate(scene, *_ends(room), config=config)
    rays = [
        [getattr(room_measures(echoes[i, j]), n)[0] for n in _NAMES.values()]
        for i, j in np.ndindex(echoes.shape)
    ]
    return {"rays": np.array(rays), "waves": _of_waves(scene, room)}


def _ends(room: dict) -> tuple[np.ndarray, np.ndarray]:
    sources, receivers = (np.array(list(room[name].values())) for name in ("sources_m", "receivers_m"))
    return sources, receivers


def _of_waves(scene: ss.Scene, room: dict) -> np.ndarray:
    """(pairs, parameters)."""
    low = ss.simulate_low(
        scene, *_ends(room), _DURATION, config_of(room, 16), edge=_EDGE, cells_per_wavelength=_CELLS
    )
    return np.array([
        [getattr(waveform_measures(low.pressure[i, j], low.rate, _OCTAVE), n)[1] for n in _NAMES.values()]
        for i, j in np.ndindex(low.pressure.shape[:2])
    ])  # fmt: skip


def _scaled(scene: ss.Scene, factor: float, of: str) -> ss.Scene:
    """The studio with the absorption at 125 Hz of materials whose name has `of` in it times a factor."""
    table = scene.materials
    rows = [of in name for name in table.names]
    absorption = table.absorption.copy()
    absorption[rows, 0] *= factor
    transmission = table.transmission.copy()  # of a layer: what it does not absorb passes
    free = np.array(rows) & table.free_hanging
    transmission[free, 0] = 1.0 - absorption[free, 0]
    return replace(scene, materials=replace(table, absorption=absorption, transmission=transmission))


def _calibrated(state: str, of: str) -> tuple[object, ...]:
    """Which factor on absorption gives the mean T30 that was measured, 0 where none does: 1 / T30 is nearly linear
    in it."""
    scene, room = load_studio(state)
    wanted = np.stack([measured_pairs(state)[p][:, 0] for p in _NAMES], axis=1)
    factors = [1.0, 0.75]
    found: list[np.ndarray] = []
    for _ in range(3):
        found.append(_of_waves(_scaled(scene, factors[len(found)], of), room))
        if len(found) > 1:
            rate = [float(1.0 / x[:, 0].mean()) for x in found]
            slope = (rate[-1] - rate[-2]) / (factors[-1] - factors[-2])
            factors.append(max(factors[-1] + (1.0 / float(wanted[:, 0].mean()) - rate[-1]) / slope, 0.0))
    before, after = (
        [float(jnd(p, x[:, k], wanted[:, k]).mean()) for k, p in enumerate(_NAMES)]
        for x in (found[0], found[-1])
    )
    times = [float(x[:, 0].mean()) for x in (wanted, found[0], found[-1])]
    return (f"curtains {state}", of or "all", factors[2], *times, *before, *after)


def run(walks: str = "300") -> list[Table]:
    """Means, correlation over pairs, and pair by pair."""
    require(FOLDER)
    means: list[tuple[object, ...]] = []
    pairs: list[tuple[object, ...]] = []
    for state in ("open", "closed"):
        found, room = _found(state, int(walks)), load_studio(state)[1]
        measured = measured_pairs(state)
        wanted = np.stack([measured[p][:, 0] for p in _NAMES], axis=1)
        for model, values in found.items():
            off = [float(jnd(p, values[:, k], wanted[:, k]).mean()) for k, p in enumerate(_NAMES)]
            alike = [float(np.corrcoef(values[:, k], wanted[:, k])[0, 1]) for k in range(len(_NAMES))]
            means.append((f"curtains {state}", model, *off, *alike))
        names = [s + r for s in room["sources_m"] for r in room["receivers_m"]]
        for k, name in enumerate(names):
            three = zip(wanted[k], found["rays"][k], found["waves"][k], strict=True)
            pairs.append(
                (f"curtains {state}", name, *(f"{m:.2f} / {r:.2f} / {w:.2f}" for m, r, w in three))
            )
    heads = ["T30", "EDT", "C80", "D50"]
    calibrated = [_calibrated(state, of) for state in ("open", "closed") for of in ("", "curtain")]
    return [
        table(
            "Mean error at 125 Hz over 6 pairs, and correlation with what was measured over them",
            ["", "", *((h, "JND") for h in heads), *(f"{h}, r" for h in heads)],
            means,
        ),
        table(
            "Pair by pair, measured / rays / waves; T30 and EDT in s, C80 in dB",
            ["", "pair", *heads],
            pairs,
        ),
        table(
            "Waves with other absorption at 125 Hz: the factor with which the mean T30 is as measured",
            [
                "",
                "materials",
                "factor",
                ("T30, measured", "s"),
                ("waves, as given", "s"),
                ("with the factor", "s"),
                *((f"{h}, as given", "JND") for h in heads),
                *((f"{h}, with it", "JND") for h in heads),
            ],
            calibrated,
        ),
    ]
