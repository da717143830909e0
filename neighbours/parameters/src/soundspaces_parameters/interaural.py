"""Interaural cross-correlation of a pair (ISO 3382-1, annex B), as expected over the phases of its arrivals.

Sounds that arrive by different ways count as incoherent, so that their cross-spectra add:

    Phi_lr(f) = sum over arrivals of E H_l(u, f) H_r*(u, f) + sum over (n, m) of (2 n + 1) S_nm K_nm(f),
    K_nm(f)   = mean over the sphere of Y_nm(u) H_l(u, f) H_r*(u, f),

with the moments S_nm of what is no discrete arrival, to order 2. The coefficient is the largest magnitude, for
delays up to 1 ms, of the cross-correlation over the band, relative to both ears' energies. The head faces the
source.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from soundspaces_parameters.response import EARLY_S, Response
from soundspaces_sim.parts import (
    BIN_S,
    HARMONIC_DEGREE as DEGREE,
    head_matrix,
    rotation_matrix,
    spherical_harmonics,
)
from soundspaces_sim.rendering import load_hrtf

_SAMPLES = 4096  # of a transform: 11 Hz
_LONGEST_S, _DELAYS = 0.001, 81  # delays looked at
_LATER = 1e6  # s


@dataclass(frozen=True, eq=False)
class EarSpectra:
    """Spectra of P directions at both ears, (P, 2, F), at (F,) Hz; directions (P, 3) in head axes, and their
    shares (P,) of the sphere."""

    spectra: np.ndarray
    frequency: np.ndarray
    directions: np.ndarray
    weights: np.ndarray


class _Bands(NamedTuple):
    """Over a band, or K' of them on a first axis: cross-correlation (…, D) at the delays looked at, and energies
    (…, 2) of both ears, of single directions (P) and of moments (9) of sound from everywhere."""

    cross: np.ndarray
    energy: np.ndarray
    cross_moments: np.ndarray
    energy_moments: np.ndarray


@lru_cache(maxsize=4)
def ear_spectra(hrtf: str | Path | None) -> EarSpectra:
    """Of a SOFA file, KEMAR by default. Raises `HrtfError`."""
    found = load_hrtf(hrtf)
    spectra = np.fft.rfft(found.ir, _SAMPLES, axis=2)
    frequency = np.fft.rfftfreq(_SAMPLES, 1.0 / found.rate)
    return EarSpectra(spectra, frequency, found.directions, found.weights)


@lru_cache(maxsize=128)
def _band(ears: EarSpectra, low: float, high: float) -> _Bands | None:
    """None if the ears' spectra do not reach the band."""
    inside = (ears.frequency >= low) & (ears.frequency < high)
    if high > 1.001 * ears.frequency[-1] or not inside.any():
        return None
    left, right = ears.spectra[:, 0, inside], ears.spectra[:, 1, inside]
    delays = np.linspace(-_LONGEST_S, _LONGEST_S, _DELAYS)
    phasors = np.exp(2j * np.pi * np.outer(ears.frequency[inside], delays))
    cross = ((left * right.conj()) @ phasors).real
    energy = np.stack([(np.abs(x) ** 2).sum(axis=1) for x in (left, right)], axis=1)
    harmonics = spherical_harmonics(ears.directions) * (2.0 * DEGREE + 1.0)
    weighted = (ears.weights[:, None] * harmonics).T  # (9, P)
    return _Bands(cross, energy, weighted @ cross, weighted @ energy)


@lru_cache(maxsize=8)
def _bands(ears: EarSpectra, edges: tuple[float, ...]) -> tuple[np.ndarray, _Bands]:
    """((K',) which bands between edges the ears' spectra reach, of those one after the other)."""
    found = {k: _band(ears, low, high) for k, (low, high) in enumerate(pairwise(edges))}
    reached = {k: band for k, band in found.items() if band is not None}
    if not reached:
        nothing = np.zeros((0, len(ears.directions), 0))
        return np.empty(0, int), _Bands(nothing, nothing, nothing[:, :9], nothing[:, :9])
    return np.array(list(reached)), _Bands(*map(np.stack, zip(*reached.values(), strict=True)))


class _Sums(NamedTuple):
    """Of a window of time, in the `bands` (K',) that ears reach: cross-correlations (K', R, D), energies (K', R, 2)
    of both ears."""

    bands: np.ndarray
    cross: np.ndarray
    energy: np.ndarray


Window = Callable[[Response], _Sums]


def _turn_to_source(response: Response) -> np.ndarray:
    assert response.towards is not None
    x, y = response.towards[:2].tolist()
    return head_matrix(float(np.degrees(np.arctan2(y, x))))


def _rotation(response: Response) -> np.ndarray:
    return rotation_matrix(response.once(_turn_to_source))


def _sums(response: Response, ears: EarSpectra, start_s: float, end_s: float) -> _Sums:
    which, bands = _bands(ears, tuple(response.echogram.bands))
    moments = response.window_moments(start_s, end_s) @ response.once(_rotation).T
    moments = moments[:, which].swapaxes(0, 1)  # (K', R, 9)
    at, directions, energy = response.arrivals
    inside = (at >= round(start_s / BIN_S)) & (at < round(min(end_s, _LATER) / BIN_S))
    nearest = (directions[inside] @ response.once(_turn_to_source) @ ears.directions.T).argmax(axis=1)
    arrived = energy[inside][:, which].T[:, None]  # (K', 1, A)
    return _Sums(
        which,
        moments @ bands.cross_moments + arrived @ bands.cross[:, nearest],
        moments @ bands.energy_moments + arrived @ bands.energy[:, nearest],
    )


@lru_cache(maxsize=8)
def windows_of(ears: EarSpectra) -> tuple[Window, Window]:
    """What makes the sums before and after 80 ms, for `Response.once`."""
    return (lambda r: _sums(r, ears, 0.0, EARLY_S)), (lambda r: _sums(r, ears, EARLY_S, _LATER))


def correlation(response: Response, *windows: Window) -> np.ndarray:
    """(R, K) interaural cross-correlation coefficients of windows together; NaN where nothing arrives, where the
    band lies above the ears' spectra, and where nobody knows where the source is."""
    count = response.estimate.shape[1]
    if response.towards is None or not np.any(response.towards[:2]):
        return np.full((1, count), np.nan)
    found = [response.once(window) for window in windows]
    cross, energy = (sum(columns) for columns in list(zip(*found, strict=True))[1:])
    out = np.full((cross.shape[1], count), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        out[:, found[0].bands] = (np.abs(cross).max(axis=2) / np.sqrt(energy.prod(axis=2))).T
    return out


def early(response: Response, hrtf: str | Path | None = None) -> np.ndarray:
    """IACC of the first 80 ms."""
    return correlation(response, windows_of(ear_spectra(hrtf))[0])


def late(response: Response, hrtf: str | Path | None = None) -> np.ndarray:
    """IACC from 80 ms on."""
    return correlation(response, windows_of(ear_spectra(hrtf))[1])


def whole(response: Response, hrtf: str | Path | None = None) -> np.ndarray:
    """IACC of all."""
    return correlation(response, *windows_of(ear_spectra(hrtf)))
