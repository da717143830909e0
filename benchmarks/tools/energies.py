"""Energies of 10 ms in our bands from what programs give, and how much they differ from run to run."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

import soundspaces_sim as ss

RATE, BIN_S, LENGTH_S = 44100, 0.01, 0.8
BINS = round(LENGTH_S / BIN_S)
EDGES = ss.SimulationConfig().bands
BANDS = len(EDGES) - 1
WINDOWS_S = ((0.0, 0.05), (0.05, 0.1), (0.1, 0.2), (0.2, 0.35))


@dataclass(frozen=True)
class Result:
    """What a program says of some pairs, run after run."""

    program: str
    setting: str
    seconds: float  # of the processor per ordered pair
    energy: np.ndarray  # (runs, pairs, bins of 10 ms, bands)
    waveforms: bool  # the energies are those of noise

    def variance(self, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(windows, bands) mean relative variance of some pairs, less waveform noise; its standard error."""
        out, error = np.empty((2, len(WINDOWS_S), self.energy.shape[3]))
        width = np.diff(np.minimum(EDGES, 0.5 * RATE))
        runs = len(self.energy)
        for w, window in enumerate(WINDOWS_S):
            bins = of_window(self.energy[:, pairs], window)
            total = bins.sum(axis=2)
            mean = total.mean(axis=0)
            own = total.var(axis=0, ddof=1) / mean**2
            if self.waveforms:
                # Squared values of single runs are too large by their own noise: E[x²] = m² (1 + 1 / (B t)).
                noise = (bins**2).mean(axis=0).sum(axis=1) / (1.0 + 1.0 / (width * BIN_S))
                own = own - noise / (width * BIN_S) / mean**2
            out[w] = own.mean(axis=0)
            error[w] = own.std(axis=0, ddof=1) / np.sqrt(own.shape[0]) + out[w] * np.sqrt(
                2.0 / (runs - 1) / own.shape[0]
            )
        return out, error


def of_window(energy: np.ndarray, window: tuple[float, float]) -> np.ndarray:
    """The bins (third axis) of (runs, pairs, bins, bands) energies that lie in a window."""
    low, high = window
    return energy[:, :, round(low / BIN_S) : round(high / BIN_S)]


def of_echograms(echoes: ss.Echograms) -> np.ndarray:
    """(pairs, bins, bands) energies in steps of 10 ms."""
    out = np.zeros((len(echoes), BINS, BANDS))
    rows = np.minimum((echoes.time_edges[:-1] / BIN_S + 1e-9).astype(int), BINS - 1)
    energy = echoes.energy[..., 0, :].reshape(len(echoes), len(rows), -1)
    np.add.at(np.moveaxis(out, 1, 0), rows, np.moveaxis(energy, 1, 0))
    at = np.minimum((echoes.direct_length / echoes.speed_of_sound / BIN_S).astype(int), BINS - 1)
    np.add.at(out, (np.arange(len(echoes)), at.ravel()), echoes.direct_energy.reshape(len(echoes), -1))
    pair = np.repeat(np.arange(len(echoes)), np.diff(echoes.early_start))
    at = np.minimum((echoes.early.delay / BIN_S).astype(int), BINS - 1)
    np.add.at(out, (pair, at), echoes.early.energy)
    return out


def of_waveforms(responses: list[np.ndarray]) -> np.ndarray:
    """The same of responses at `RATE`, cut or continued with zeros to `LENGTH_S`."""
    samples = round(LENGTH_S * RATE)
    irs = np.array([np.pad(ir[:samples], (0, max(samples - len(ir), 0))) for ir in responses])
    out = np.empty((len(irs), BINS, BANDS))
    for b, (low, high) in enumerate(itertools.pairwise(EDGES)):
        sos = butter(4, [max(low, 20.0), min(high, 0.49 * RATE)], "bandpass", fs=RATE, output="sos")
        band = sosfiltfilt(sos, irs, axis=1)[:, :samples] ** 2
        out[:, :, b] = np.add.reduceat(band, np.arange(BINS) * round(BIN_S * RATE), axis=1)
    return out


def of_octaves(energy: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """(pairs, bins, bands) sums over octaves, by where their centres lie, of (pairs, octaves, bins) energies."""
    at = np.searchsorted(EDGES, centres, side="right") - 1
    out = np.zeros((energy.shape[0], energy.shape[2], BANDS))
    for octave, band in enumerate(at):
        out[:, :, band] += energy[:, octave]
    return out
