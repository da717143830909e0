"""Binaural cues of both decoders against the measured head.

Question: How far are interaural time and level differences of decoded plane waves from those of the measured
head?

Method: Plane waves of second order from 72 horizontal azimuths through either decoder, beside the measured
responses of the KEMAR set: ITD from the cross-correlation below 1.5 kHz, ILD in three ranges of frequency;
absolute errors.

Amortised: Nothing is timed.

Takes: Half a minute.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from soundspaces_sim.core.numerics.axes import spherical_harmonics
from soundspaces_sim.rendering.decoder import Method
from soundspaces_sim.rendering.hrtf import load_hrtf

MEASURES = ("core", "rendering")
_TARGETS = {
    "ITD mean, µs": 65.0,
    "ITD largest, µs": 145.0,
    "ILD 200–1500 Hz, dB": 1.2,
    "ILD 1500–5000 Hz, dB": 2.0,
    "ILD 5000–16000 Hz, dB": 5.5,
}


def _itd_us(ears: np.ndarray, rate: float) -> float:
    sos = butter(4, 1500.0, fs=rate, output="sos")
    a, b = (np.fft.rfft(sosfiltfilt(sos, x), 4096) for x in ears)
    c = np.roll(np.fft.irfft(b * a.conj(), 65536), 32768)
    return float((c.argmax() - 32768) / 16 / rate * 1e6)


def cues(method: Method) -> list[float]:
    """Mean and largest ITD error, and mean ILD errors, over 72 horizontal azimuths."""
    hrtf = load_hrtf()
    rate = round(hrtf.rate)
    f = np.fft.rfftfreq(2048, 1.0 / rate)
    itd, ild = [], []
    for azimuth in np.deg2rad(np.arange(0, 360, 5)):
        i = int((hrtf.directions @ [np.cos(azimuth), np.sin(azimuth), 0.0]).argmax())
        field = np.zeros((9, 800), np.float32)
        field[:, 400] = spherical_harmonics(hrtf.directions[i])
        ears = ss.binaural_rir(field, rate, decoder=method)
        itd.append(abs(_itd_us(ears, rate) - _itd_us(hrtf.ir[i], rate)))
        row = []
        for low, high in ((200.0, 1500.0), (1500.0, 5000.0), (5000.0, 16000.0)):
            use = (f >= low) & (f < high)
            level = [
                10.0 * np.log10((np.abs(np.fft.rfft(x, 2048)[:, use]) ** 2).sum(axis=1))
                for x in (ears, hrtf.ir[i])
            ]
            row.append(abs((level[0][0] - level[0][1]) - (level[1][0] - level[1][1])))
        ild.append(row)
    return [float(np.mean(itd)), float(np.max(itd)), *np.mean(ild, axis=0)]


def run() -> list[Table]:
    """Errors and their targets."""
    aligned, magls = cues("aligned"), cues("magls")
    rows = list(zip(_TARGETS, _TARGETS.values(), aligned, magls, strict=True))
    return [table("Absolute errors, 72 horizontal azimuths", ["", "target", "aligned", "MagLS"], rows)]
