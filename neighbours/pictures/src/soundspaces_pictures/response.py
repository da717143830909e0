"""Waveforms and spectrograms of the ears."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from scipy.signal import ShortTimeFFT
from scipy.signal.windows import hann


def draw_waveform(ax: Axes, ears: np.ndarray, rate: int) -> None:
    """Two ears (2, n), the right one below the left."""
    time = np.arange(ears.shape[1]) / rate
    peak = float(np.abs(ears).max()) or 1.0
    for ear, (name, colour) in enumerate((("left", "#0072B2"), ("right", "#D55E00"))):
        ax.plot(time, ears[ear] / peak - 2.0 * ear, color=colour, lw=0.6, label=name)
    ax.set_yticks([0.0, -2.0], ["left", "right"])
    ax.set_xlim(0.0, time[-1])
    ax.set_xlabel("time (s)")


def draw_spectrogram(ax: Axes, signal: np.ndarray, rate: int, range_db: float = 70.0) -> None:
    """Level of a signal (n,) over time and frequency, dB below its maximum."""
    size = max(256, 1 << round(np.log2(0.012 * rate)))
    transform = ShortTimeFFT(hann(size, sym=False), hop=size // 4, fs=rate)
    power = transform.spectrogram(np.asarray(signal, float))
    level = 10.0 * np.log10(np.maximum(power, 1e-30) / max(power.max(), 1e-30))
    t0, t1, f0, f1 = transform.extent(len(signal))
    shown = ax.imshow(
        level,
        origin="lower",
        aspect="auto",
        extent=(t0, t1, f0 / 1e3, f1 / 1e3),
        cmap="magma",
        vmin=-range_db,
        vmax=0.0,
    )
    ax.set_xlim(0.0, len(signal) / rate)
    ax.set_xlabel("time (s)")
    ax.set_ylabel("frequency (kHz)")
    ax.figure.colorbar(shown, ax=ax, label="level (dB)")
