"""What the errors in the PTB studio are due to: three experiments on our own side.

Question: How much of the studio's errors are noise, inputs, and the measured response being one draw?

Method: Noise: the same figure from other seeds. Input: every absorption coefficient of the table times a factor
of its own, log-normal with a standard deviation of 20 %. Floor: our own echograms as pressure responses, whose
phases are chance, measured as a microphone's are, against the measures of the echograms themselves: the error
in JND that a perfect prediction of energies would show against one measured response.

Amortised: Nothing is timed.

Takes: 20 minutes. Arguments: subpaths per point (1000), draws (8). Needs ../shared/reference/ptb_studio.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from benchmarks.accuracy import ptb_studio
from benchmarks.accuracy.ptb_studio import PARAMETERS, jnd
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import require
from soundspaces_sim.echogram.measures import room_measures, waveform_measures

STATES = ("open", "closed")
_NAMES = {"T30": "t30", "EDT": "edt", "C": "c80", "D": "d50"}


def figure(walks: int, seed: int = 0, scale: np.random.Generator | None = None) -> dict[str, float]:
    """Mean error in JND over both states, per parameter; `scale` draws factors on the absorption."""
    found = []
    for state in STATES:
        scene, _ = ptb_studio.load_studio(state)
        if scale is not None:
            table = scene.materials
            factor = np.exp(scale.normal(0.0, 0.2, table.absorption.shape))
            room = 1.0 - table.transmission
            table = replace(table, absorption=np.minimum(table.absorption * factor, 0.999 * room))
            scene = replace(scene, materials=table)
        found.append(ptb_studio.differences_of(scene, state, walks, seed))
    return {p: float(np.mean([f[p].mean() for f in found])) for p in PARAMETERS}


def floor(walks: int, responses: int = 4) -> dict[str, np.ndarray]:
    """(octaves,) mean error in JND of measures of single pressure responses against those of the echograms."""
    off: dict[str, list[np.ndarray]] = {p: [] for p in PARAMETERS}
    for state in STATES:
        scene, room = ptb_studio.load_studio(state)
        config = ptb_studio.config_of(room, walks)
        echoes = ss.simulate(
            scene, list(room["sources_m"].values()), list(room["receivers_m"].values()), config, 0
        )
        for i in range(echoes.shape[0]):
            for j in range(echoes.shape[1]):
                want = room_measures(echoes[i, j])
                for seed in range(responses):
                    ir = ss.ambisonic_rir(echoes[i, j], 16000, seed)[0]
                    got = waveform_measures(ir, 16000.0, config.bands)
                    for p, name in _NAMES.items():
                        off[p].append(jnd(p, getattr(got, name), getattr(want, name)))
    return {p: np.nanmean(v, axis=0) for p, v in off.items()}


def runs(walks: int, draws: int) -> dict[str, dict[str, np.ndarray]]:
    """(draws,) figures per parameter: of other seeds, and of other absorption."""
    rng = np.random.default_rng(0)
    found = {
        "seeds": [figure(walks, seed) for seed in range(draws)],
        "absorption": [figure(walks, 0, rng) for _ in range(draws)],
    }
    return {
        name: {p: np.array([r[p] for r in rows]) for p in PARAMETERS} for name, rows in found.items()
    }


def run(walks: str = "1000", draws: str = "8") -> list[Table]:
    """Seeds and absorption, and the floor by octave."""
    require(ptb_studio.FOLDER)
    rows = [
        (name, p, x.mean(), x.std(ddof=1), x.min(), x.max())
        for name, by_parameter in runs(int(walks), int(draws)).items()
        for p, x in by_parameter.items()
    ]
    heads = ["drawn anew", "", *((n, "JND") for n in ("mean", "standard deviation", "least", "largest"))]
    octaves = ptb_studio.load_studio("open")[1]["frequency_hz"]
    floors = [(p, x.mean(), *x) for p, x in floor(int(walks)).items()]
    return [
        table(f"The studio's figure, {int(walks):,} subpaths per point, {draws} draws", heads, rows),
        table("The floor", ["", ("mean", "JND"), *((f"{f:g} Hz", "JND") for f in octaves)], floors),
    ]
