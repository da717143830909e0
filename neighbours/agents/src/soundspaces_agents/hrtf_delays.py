"""Head-related transfer functions without their delays, to hear what interaural delays are worth.

A head-related transfer function is nearly its minimum-phase response, delayed (Kistler & Wightman 1992, A model of
head-related transfer functions based on principal components analysis and minimum-phase reconstruction, JASA 91
(3)). Without the delay both ears keep their spectra, so their levels.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from soundspaces_sim.parts import Hrtf, minimum_phase

_POINTS, _LEAST = 4096, 1e-6  # of the transform; of the largest magnitude


def without_delays(hrtf: Hrtf) -> Hrtf:
    """The minimum-phase responses (P, 2, n) of a set: its magnitudes, and no delays."""
    size = np.abs(np.fft.rfft(hrtf.ir, _POINTS, axis=2))
    size = np.maximum(size, _LEAST * size.max(axis=2, keepdims=True))
    spectra = np.array([[np.exp(minimum_phase(np.log(ear))) for ear in pair] for pair in size])
    return replace(hrtf, ir=np.fft.irfft(spectra, axis=2)[:, :, : hrtf.ir.shape[2]])


def write_hrtf(path: Path, hrtf: Hrtf) -> None:
    """Write what `load_hrtf` reads of a SOFA file."""
    position = np.concatenate([hrtf.directions, np.ones((len(hrtf.directions), 1))], axis=1)
    with h5py.File(path, "w") as sofa:
        sofa.attrs["Title"] = hrtf.citation
        sofa["Data.IR"], sofa["Data.SamplingRate"] = hrtf.ir, np.array([hrtf.rate])
        sofa["SourcePosition"] = hrtf.distance * position[:, :3]
        sofa["SourcePosition"].attrs["Type"] = "cartesian"
