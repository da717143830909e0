"""Energy decay curves of many pairs, and how far two of them are apart."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.echogram.echogram import Echograms


def decay_curves(echoes: Echograms, bin_s: float = 0.01) -> np.ndarray:
    """(S, L, bins, bands) backward-integrated energy, dB."""
    width = int(np.ceil(echoes.time_edges[-1] / bin_s - 1e-9))
    histogram = np.zeros((*echoes.shape, width, len(echoes.bands) - 1))
    rows = np.minimum((echoes.time_edges[:-1] / bin_s + 1e-9).astype(int), width - 1)
    for i, row in enumerate(rows):
        histogram[:, :, row] += echoes.energy[:, :, i, 0]
    s, l = np.indices(echoes.shape)
    at = np.minimum((echoes.direct_length / echoes.speed_of_sound / bin_s).astype(int), width - 1)
    np.add.at(histogram, (s, l, at), echoes.direct_energy)
    pair = np.repeat(np.arange(len(echoes)), np.diff(echoes.early_start))
    at = np.minimum((echoes.early.delay / bin_s).astype(int), width - 1)
    np.add.at(histogram, (pair // echoes.shape[1], pair % echoes.shape[1], at), echoes.early.energy)
    remaining = np.cumsum(histogram[:, :, ::-1], axis=2)[:, :, ::-1]
    return np.asarray(10.0 * np.log10(np.maximum(remaining, 1e-30)))


def edc_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean |difference| in dB down to -30 dB, over pairs of two different points."""
    use = (a - a[:, :, :1]) > -30.0
    use &= ~np.eye(len(a), dtype=bool)[:, :, None, None]
    return float(np.abs(a - b)[use].mean())
