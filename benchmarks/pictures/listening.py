"""Sounds before and after: a talker who turns away, a siren that passes, a clap in a bathroom.

    python -m benchmarks.pictures.listening [folder]

Writes <what>_before.wav and <what>_after.wav, at one gain each pair, and <what>.png with both spectrograms.
Before: sources radiate alike in all directions, jump from point to point, and bands of frequency have steps.
After: `source=ss.Talker(…)`, ways in metres, `renderer="smooth"`.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
import soundfile
from soundspaces_renderers import dry

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.rendering import auralise
from soundspaces_sim.rendering.renderers import find_renderer

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from soundspaces_pictures.response import draw_spectrogram

RATE = 44100
WALKS = 400
_TOP_KHZ = {"talker_turning_away": 6.0, "siren_passing": 3.0, "clap_in_a_bathroom": 12.0}


def _siren(seconds: float) -> np.ndarray:
    """Two tones with harmonics, half a second each, as an ambulance's."""
    n = round(seconds * RATE)
    base = np.where((np.arange(n) / RATE / 0.5).astype(int) % 2 == 0, 435.0, 580.0)
    phase = 2.0 * np.pi * np.cumsum(base) / RATE
    return np.asarray(sum(np.sin(k * phase) / k for k in range(1, 9)), np.float32)


def _hall(folder: Path) -> ss.RirDataset:
    """Points a metre apart along a street-like hall of 24 m, and a listener beside their line."""
    scene = ss.shoebox((24.0, 6.0, 5.0), 0.4, scattering=0.3)
    points = [[x, 2.0, 1.5] for x in np.arange(1.0, 23.5)] + [[12.0, 3.5, 1.5]]
    config = ss.JobConfig(simulation=ss.SimulationConfig(walks=WALKS), dataset=DatasetConfig(rate=RATE))
    return ss.open_dataset(ss.build_dataset(scene, folder, config, points=np.array(points)).folder)


def _bathroom() -> ss.Echogram:
    """Tiled, 2.2 by 1.7 by 2.4 m; towels and a curtain take high frequencies."""
    walls = dict.fromkeys(("west", "east", "south", "floor"), "ceramic-tile")
    scene = ss.shoebox((2.2, 1.7, 2.4), {**walls, "north": "curtain", "ceiling": "plaster"})
    return ss.simulate(scene, [[0.6, 0.5, 1.5]], [[1.6, 1.2, 1.5]], ss.SimulationConfig(walks=4000))[
        0, 0
    ]


def main(folder: Path) -> None:
    """Make them all."""
    folder.mkdir(parents=True, exist_ok=True)
    pairs: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    with tempfile.TemporaryDirectory() as scratch, _hall(Path(scratch)) as ds:
        speech = dry.syllables(RATE)
        speech = np.tile(speech, 2)
        away = [ss.Talker(heading_deg=90.0 + turn) for turn in np.linspace(0.0, 180.0, 19)]
        pairs["talker_turning_away"] = (
            ds.render(speech, 11, 23, -90.0),
            ds.render_path(speech, 11, 23, (-90.0, 0.0, 0.0), source=away),
        )
        siren = _siren(2.0)
        way = [[0.0, 1.0, 2.0, 1.5], [2.0, 23.0, 2.0, 1.5]]  # 11 m/s
        pairs["siren_passing"] = (
            ds.render_path(siren, list(range(23)), 23, (-90.0, 0.0, 0.0)),
            ds.render_path(siren, way, 23, (-90.0, 0.0, 0.0)),
        )
    echogram = _bathroom()
    clap = dry.hand_clap(RATE)
    rirs = (find_renderer(name)(echogram, RATE, 0) for name in ("default", "smooth"))
    before, after = (auralise.convolve(clap, ss.binaural_rir(rir, RATE)) for rir in rirs)
    pairs["clap_in_a_bathroom"] = before, after
    for name, both in pairs.items():
        gain = 0.7 / max(float(np.abs(x).max()) for x in both)
        figure, axes = plt.subplots(1, 2, figsize=(11.0, 3.2), layout="constrained", sharey=True)
        for ax, x, when in zip(axes, both, ("before", "after"), strict=True):
            soundfile.write(folder / f"{name}_{when}.wav", gain * x.T, RATE)
            draw_spectrogram(ax, gain * x[0], RATE)
            ax.set_ylim(0.0, _TOP_KHZ[name])
            ax.set_title(f"{name.replace('_', ' ')}, {when}: left ear", fontsize=9)
        figure.savefig(folder / f"{name}.png", dpi=80)
        plt.close(figure)
    print(f"Wrote {len(pairs)} pairs of sounds and their spectrograms to {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "listening_before_after"))
