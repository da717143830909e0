"""Figure of waves.md: `python neighbours/waves/figures.py` in the clone. Takes a minute of processor time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import soundspaces_waves as sw
from matplotlib.figure import Figure

import soundspaces_sim as ss

OUT = Path(__file__).parent / "figures"
STEP = 0.25  # m, between listeners


def main() -> None:
    """Draw the demo's levels at single frequencies, and their course over frequency at two seats."""
    scene = ss.load_scene("demo")
    listeners = ss.make_grid(scene, STEP).points
    source = listeners[len(listeners) // 3]
    waves = sw.simulate_low(scene, source, listeners, 0.8)
    figure = Figure(figsize=(10.0, 3.3), layout="constrained")
    axes = figure.subplots(1, 3)
    every = [waves.transfer(0, l) for l in range(len(listeners))]
    frequency = every[0][0]
    level = 20.0 * np.log10(np.abs(np.array([h[0] for _, h in every])) + 1e-9)
    strength = (10.0 ** (level / 10.0)).sum(axis=0)
    for ax, span in zip(axes[:2], ((25.0, 55.0), (60.0, 110.0)), strict=True):
        band = np.flatnonzero((frequency > span[0]) & (frequency < span[1]))
        k = band[strength[band].argmax()]
        picture = ax.scatter(
            *listeners[:, :2].T,
            c=level[:, k],
            s=14,
            marker="s",
            cmap="magma",
            vmin=level[:, k].max() - 40.0,
        )
        ax.plot(source[0], source[1], "o", color="white", ms=4)
        ax.set(title=f"{frequency[k]:.1f} Hz", xlabel="x (m)", ylabel="y (m)", aspect="equal")
        figure.colorbar(picture, ax=ax, label="level (dB)", shrink=0.8)
    distance = np.linalg.norm(listeners - source, axis=1)
    for metres, name in ((1.0, "1 m away"), (3.0, "3 m away")):
        l = int(np.abs(distance - metres).argmin())
        axes[2].plot(frequency, level[l], lw=1.0, label=name)
    axes[2].set(xlabel="frequency (Hz)", ylabel="level (dB)", xlim=(10.0, waves.edge))
    axes[2].legend()
    figure.savefig(OUT / "waves_modes.png", dpi=110)


if __name__ == "__main__":
    main()
