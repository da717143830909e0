"""The lowest octave of a real room, by rays and by waves: the studio of Round Robin III (PTB) at 125 Hz.

Question: Are T30, EDT, C80 and D50 at 125 Hz nearer to what was measured if that octave is simulated as waves?

Method: Materials and positions are the round robin's; nothing is tuned. Rays: measures of echograms. Waves: those
of the pressure that `simulate_low` gives up to 220 Hz (8 cells per wavelength there, 14 at 125 Hz), cut to the
octave. The round robin has no 63 Hz, neither materials nor measurements.

Amortised: Nothing is timed.

Takes: A minute of processor time. Argument: subpaths per point (300). Needs ../shared/reference/ptb_studio.
"""

from __future__ import annotations

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
    ends = [list(room[name].values()) for name in ("sources_m", "receivers_m")]
    low = ss.simulate_low(scene, *ends, _DURATION, config, edge=_EDGE, cells_per_wavelength=_CELLS)
    echoes = ss.simulate(scene, *ends, config)
    waves, rays = [], []
    for i, j in np.ndindex(echoes.shape):
        of_waves = waveform_measures(low.pressure[i, j], low.rate, _OCTAVE)
        waves.append([getattr(of_waves, n)[1] for n in _NAMES.values()])
        rays.append([getattr(room_measures(echoes[i, j]), n)[0] for n in _NAMES.values()])
    return {"rays": np.array(rays), "waves": np.array(waves)}


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
    ]
