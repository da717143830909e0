"""Ambisonics to two ears.

The decoder of Zaunschirm, Schoerkhuber and Hoeldrich 2018: least squares below a cut-off, time-aligned
HRTFs above it (the ear is deaf to interaural phase there, and order 2 cannot carry it), then a filter
matrix that restores the interaural covariance of a diffuse field; MagLS stands beside it (`decoder`).

Conventions: heading counter-clockwise from +X seen from above, in degrees; 0 faces +X. Ear 0 is left.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike

from soundspaces_sim.core.config import check_rate
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.axes import (
    CHANNELS,
    check_degrees,
    check_head,
    head_matrix,
    rotation_matrix,
)
from soundspaces_sim.rendering.decoder import Equalisation, Method, decoder_filters
from soundspaces_sim.rendering.synthesis import decode


@lru_cache(maxsize=16)
def _decoder_spectra(
    rate: int, hrtf_path: str | Path | None, method: Method, equalisation: Equalisation, size: int
) -> tuple[np.ndarray, int]:
    filters, delay = decoder_filters(rate, hrtf_path, method, equalisation)
    spectra = scipy.fft.rfft(filters, size)
    spectra.setflags(write=False)
    return spectra, delay


def binaural_rir(
    rir: ArrayLike,
    rate: int | None = None,
    heading_deg: float = 0.0,
    hrtf: str | Path | None = None,
    *,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
    decoder: Method = "aligned",
) -> np.ndarray:
    """(2, n) float32 ear signals of a (9, n) ambisonic response (ACN/SN3D, world axes) at `rate` Hz, which has to
    be said: an array does not tell. Raises `ConfigError`.

    Angles as in `axes.head_matrix`. `hrtf`: path of a SOFA file; KEMAR by default. `decoder` as in
    `design_decoder`. The filters' delay is removed, so onsets stay where they are for a head centred at
    the listener.
    """
    turns = [check_head(heading_deg, pitch_deg, roll_deg)]
    return binaural_rirs(rir, _said(rate, "rir"), turns, hrtf, decoder=decoder)[0]


def binaural_rirs(
    rir: ArrayLike,
    rate: int,
    orientations_deg: ArrayLike,
    hrtf: str | Path | None = None,
    *,
    decoder: Method = "aligned",
    equalisation: Equalisation = "diffuse-field",
) -> np.ndarray:
    """(k, 2, n) float32: `binaural_rir` for k heads (k, 3) of heading, pitch and roll, at less cost.

    The response is transformed once for all heads. `equalisation` as in `equalised_spectra`.
    """
    rate = check_rate(rate)
    field, turns = _field(rir, "rir"), _orientations(orientations_deg)
    n = field.shape[1]
    size, spectra, delay = decoder_transform(n, rate, hrtf, decoder, equalisation)
    spectrum = scipy.fft.rfft(field.astype(np.float32, copy=False), size)
    both = np.empty((2, spectrum.shape[1]), np.complex64)
    ears = np.empty((len(turns), 2, n), np.float32)
    for k, turn in enumerate(turns):
        matrix = rotation_matrix(head_matrix(*turn)).astype(np.float32)
        decode(both, spectrum, matrix, spectra, np.empty(spectrum.shape[1], spectrum.dtype))
        ears[k] = scipy.fft.irfft(both, size)[:, delay : delay + n]
    return ears


def binaural_moving(
    signal: ArrayLike,
    orientations_deg: ArrayLike,
    rate: int | None = None,
    hrtf: str | Path | None = None,
    *,
    decoder: Method = "aligned",
    equalisation: Equalisation = "diffuse-field",
) -> np.ndarray:
    """(2, n) float32 ear signals of a (9, n) ambisonic signal at `rate` Hz, which has to be said, for a head that
    moves. Raises `ConfigError`.

    `orientations_deg` (k, 3): heading, pitch and roll at k instants spread evenly from the first sample
    to the last; between two of them the sound fields as turned by either are cross-faded.
    """
    rate = _said(rate, "signal")
    field, turns = _field(signal, "signal"), _orientations(orientations_deg)
    n = field.shape[1]
    position = np.linspace(0.0, len(turns) - 1.0, n)
    turned = np.zeros(field.shape, np.float32)
    for k, turn in enumerate(turns):
        low, high = np.searchsorted(position, (k - 1.0, k + 1.0), side="left")
        share = 1.0 - np.abs(position[low:high] - k)
        matrix = rotation_matrix(head_matrix(*turn))
        part = matrix @ (field[:, low:high] * share)
        turned[:, low:high] += part.astype(np.float32)
    return binaural_rirs(
        turned, rate, [(0.0, 0.0, 0.0)], hrtf, decoder=decoder, equalisation=equalisation
    )[0]


def _said(rate: int | None, what: str) -> int:
    if rate is None:
        raise ConfigError(
            f"rate: expected the sampling rate of `{what}` in Hz, got none; an array does not tell it: give that "
            "which it was made at, as in binaural_rir(ambisonic_rir(echogram, rate), rate)"
        )
    return check_rate(rate)


def _field(signal: ArrayLike, what: str) -> np.ndarray:
    field = np.asarray(signal)
    if field.ndim != 2 or field.shape[0] != CHANNELS:
        raise ConfigError(f"{what}: expected shape (9, n), got {field.shape}")
    return field


def _orientations(orientations_deg: ArrayLike) -> np.ndarray:
    turns = check_degrees(orientations_deg, "orientations_deg")
    if turns.ndim != 2 or turns.shape[1] != 3 or len(turns) < 1:
        raise ConfigError(f"orientations_deg: expected values of shape (k, 3), got {turns.shape}")
    return turns


def decoder_transform(
    n: int, rate: int, hrtf: str | Path | None, decoder: Method, equalisation: Equalisation
) -> tuple[int, np.ndarray, int]:
    """(samples of a transform with room for the filters, their spectra, their delay)."""
    taps = decoder_filters(int(rate), hrtf, decoder, equalisation)[0].shape[2]
    size = int(scipy.fft.next_fast_len(n + taps, real=True))
    return size, *_decoder_spectra(int(rate), hrtf, decoder, equalisation, size)
