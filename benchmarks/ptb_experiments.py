"""What the errors in the PTB studio are due to: three experiments on our own side.

    .venv/bin/python -m benchmarks.ptb_experiments [walks]

- Noise: the same figure from other seeds.
- Input: every absorption coefficient of the table times a factor of its own, log-normal with a standard deviation
  of 20 %: how far the figure moves when nothing but that is drawn anew.
- Floor: our own echograms as pressure responses, whose phases are chance, measured as a microphone's are, against
  the measures of the echograms themselves: the error in JND that a perfect prediction of energies would show
  against one measured response.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from benchmarks import ptb_studio
from benchmarks.ptb_studio import PARAMETERS, jnd
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


def main(walks: int = 1000, draws: int = 8) -> None:
    if not ptb_studio.FOLDER.is_dir():
        print(f"{ptb_studio.FOLDER} is absent: nothing to experiment on")
        return
    for name, by_parameter in runs(walks, draws).items():
        for p, x in by_parameter.items():
            print(f"{name}, {p}: {x.mean():.2f} ± {x.std(ddof=1):.2f}, {x.min():.2f} to {x.max():.2f}")
    for p, x in floor(walks).items():
        print(f"floor, {p}: mean {x.mean():.2f}, by octave {np.round(x, 2)}")


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:]))
