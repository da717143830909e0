"""Filters from ambisonics, or from single directions, to two ears: equalisation and design.

Designed once per HRTF set, resampled to the response's rate, and kept. Ear 0 is left.
"""

from __future__ import annotations

from functools import lru_cache
from math import gcd
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import scipy

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.axes import spherical_harmonics
from soundspaces_sim.echogram.filters import minimum_phase
from soundspaces_sim.rendering.hrtf import Hrtf, load_hrtf, onset_delays

Method = Literal["aligned", "magls"]
Equalisation = Literal["diffuse-field", "none"]

_NFFT = 2048
_TAPS = 512  # at the HRTF's own rate; 256 lose 1.5 dB between 100 and 200 Hz
_ALIGN = (2000.0, 3000.0)  # Hz, over which the responses are brought into line
_LOW = (150.0, 250.0)  # Hz, below which measured sets are unreliable and a rigid ITD is synthesised
_ITD_FIT = (250.0, 600.0)  # Hz
_COMMON = (2000.0, 4000.0)  # Hz, over which phase that all share is left again
_FLAT = (250.0, 1000.0)  # Hz, where the level of a set that keeps its colour is taken


def equalised_spectra(hrtf: Hrtf, equalisation: Equalisation = "diffuse-field") -> np.ndarray:
    """(P, 2, bins) spectra, low end rigid, mean delay and common phase removed; both ears equalised in common
    to a flat diffuse field, or, with ``none``, brought to its level from 250 Hz to 1 kHz. Raises
    `ConfigError`."""
    frequency = np.fft.rfftfreq(_NFFT, 1.0 / hrtf.rate)
    spectra = np.fft.rfft(hrtf.ir, _NFFT, axis=2)
    power = np.einsum("p,pef->f", hrtf.weights, np.abs(spectra) ** 2) / 2.0
    smooth = _third_octave_mean(power, frequency)
    inside = np.clip(frequency, _LOW[1], 0.9 * 0.5 * hrtf.rate)
    gain = 1.0 / np.sqrt(np.interp(inside, frequency, smooth))
    if equalisation == "none":
        flat = (frequency >= _FLAT[0]) & (frequency <= _FLAT[1])
        gain = np.full(len(frequency), 1.0 / np.sqrt(power[flat].mean()))
    elif equalisation != "diffuse-field":
        raise ConfigError(
            f"equalisation: expected {' or '.join(get_args(Equalisation))}, got {equalisation!r}"
        )
    spectra = spectra * gain * np.exp(1j * minimum_phase(np.log(gain)).imag)

    delay = _low_delays(spectra, frequency)
    common = float((hrtf.weights @ delay).mean())
    # Full range first: undo the common delay: the ears' mean low delay becomes zero.
    spectra = spectra * np.exp(2j * np.pi * frequency * common)
    rigid = np.exp(-2j * np.pi * frequency * (delay - common)[:, :, None])
    # Cross-fade level and phase apart: a sum of the two would cancel where their phases differ.
    blend = np.clip((frequency - _LOW[0]) / (_LOW[1] - _LOW[0]), 0.0, 1.0)
    turn = np.angle(spectra * rigid.conj())
    out = np.abs(spectra) ** blend * rigid * np.exp(1j * blend * turn)
    return np.asarray(out * np.exp(-1j * _common_phase(hrtf, out * rigid.conj(), frequency)))


def _common_phase(hrtf: Hrtf, aligned: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """(bins,) rad below `_COMMON`: phase that all directions and both ears share, of loudspeaker, microphone and
    equalisation. No cue is in it, and without it responses ring a millisecond before their onset at most, not
    four."""
    mean = np.einsum("p,pef->f", hrtf.weights, aligned)
    fade = np.clip((_COMMON[1] - frequency) / (_COMMON[1] - _COMMON[0]), 0.0, 1.0)
    return np.asarray(fade * np.unwrap(np.angle(mean)))


def _third_octave_mean(power: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    cumulative = np.concatenate([[0.0], np.cumsum(power)])
    low = np.searchsorted(frequency, frequency * 2.0 ** (-1 / 6), "left")
    high = np.maximum(np.searchsorted(frequency, frequency * 2.0 ** (1 / 6), "right"), low + 1)
    return np.asarray((cumulative[high] - cumulative[low]) / (high - low))


def _low_delays(spectra: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """(P, 2) s: slope of the unwrapped phase over `_ITD_FIT`, through the origin modulo 2 pi."""
    use = (frequency >= _ITD_FIT[0]) & (frequency <= _ITD_FIT[1])
    phase = np.unwrap(np.angle(spectra), axis=2)[:, :, use]
    # Unwrapping starts at 0 Hz where the measurement is weak: centre the fit instead.
    x = 2.0 * np.pi * frequency[use]
    x0 = x - x.mean()
    return np.asarray(-(phase @ x0) / (x0 @ x0))


def design_decoder(
    hrtf: Hrtf, method: Method = "aligned", equalisation: Equalisation = "diffuse-field"
) -> np.ndarray:
    """(2, 9, taps) filters at the HRTF's rate, delayed by half their length; `equalisation` as in
    `equalised_spectra`.

    ``aligned``: time alignment above the cut-off (Zaunschirm et al. 2018). ``magls``: magnitudes alone
    above it (Schoerkhuber, Zaunschirm & Hoeldrich 2018). Both keep the diffuse-field covariance.
    """
    frequency = np.fft.rfftfreq(_NFFT, 1.0 / hrtf.rate)
    target = equalised_spectra(hrtf, equalisation)
    harmonics = spherical_harmonics(hrtf.directions)
    weighted = hrtf.weights[:, None] * harmonics
    inverse = weighted @ np.linalg.inv(harmonics.T @ weighted)  # (P, 9): least squares
    if method == "aligned":
        tau = onset_delays(hrtf)
        tau = tau - (hrtf.weights @ tau).mean()
        # exp(j w tau) whole, not exp(j (w - w_c) tau): the phases w_c tau that would be left differ
        # between directions and cost 1 dB of interaural level. The transition at w_c is a cross-fade instead.
        blend = np.clip((frequency - _ALIGN[0]) / (_ALIGN[1] - _ALIGN[0]), 0.0, 1.0)
        aligned = target * np.exp(2j * np.pi * frequency * blend * tau[:, :, None])
        decoder = np.einsum("pef,pc->fec", aligned, inverse)
    elif method == "magls":
        decoder = np.einsum("pef,pc->fec", target, inverse)
        for i in range(int(np.searchsorted(frequency, _ALIGN[0])), len(frequency)):
            phase = np.angle(harmonics @ decoder[i - 1].T)  # (P, 2), as the bin below left it
            decoder[i] = (np.abs(target[:, :, i]) * np.exp(1j * phase)).T @ inverse
    else:
        raise ConfigError(f"decoder: expected one of {', '.join(get_args(Method))}, got {method!r}")
    decoder = _match_covariance(decoder, target, harmonics, hrtf.weights)

    return _as_filters(decoder.transpose(1, 2, 0))


def _as_filters(spectra: np.ndarray) -> np.ndarray:
    """(…, taps) filters of spectra (…, bins), delayed by half their length."""
    filters = np.roll(np.fft.irfft(spectra, _NFFT, axis=-1), _TAPS // 2, axis=-1)[..., :_TAPS]
    fade = np.ones(_TAPS)
    edge = np.sin(0.5 * np.pi * (np.arange(32) + 0.5) / 32) ** 2
    fade[:32], fade[-32:] = edge, edge[::-1]
    return np.asarray(filters * fade)


def _match_covariance(
    decoder: np.ndarray, target: np.ndarray, harmonics: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Mix the two ears so that a diffuse field has the covariance of the measured set.

    R = L L^H is the measured covariance, K K^H the decoded one; M = L V U^H K^-1 with U S V^H the
    singular values of K^H L is the mixing closest to the identity (Vilkamo et al. 2013).
    """
    wanted = np.einsum("pef,p,pgf->feg", target, weights, target.conj())
    decoded = np.einsum("fec,pc->fep", decoder, harmonics)
    have = np.einsum("fep,p,fgp->feg", decoded, weights, decoded.conj())
    regular = 1e-12 * np.trace(wanted, axis1=1, axis2=2).real[:, None, None] * np.eye(2)
    lower, k = np.linalg.cholesky(wanted + regular), np.linalg.cholesky(have + regular)
    u, _, vh = np.linalg.svd(k.conj().transpose(0, 2, 1) @ lower)
    mix = lower @ vh.conj().transpose(0, 2, 1) @ u.conj().transpose(0, 2, 1) @ np.linalg.inv(k)
    return np.asarray(mix @ decoder)


@lru_cache(maxsize=8)
def decoder_filters(
    rate: int,
    hrtf_path: str | Path | None = None,
    method: Method = "aligned",
    equalisation: Equalisation = "diffuse-field",
) -> tuple[np.ndarray, int]:
    """((2, 9, taps) float32 filters at `rate`, their delay in samples)."""
    hrtf = load_hrtf(hrtf_path)
    return _at_rate(design_decoder(hrtf, method, equalisation), round(hrtf.rate), rate)


@lru_cache(maxsize=4)
def direction_filters(rate: int, hrtf_path: str | Path | None = None) -> tuple[np.ndarray, int]:
    """((P, 2, taps) float32 filters at `rate` of the directions of a set, equalised to a flat diffuse field;
    their delay in samples)."""
    hrtf = load_hrtf(hrtf_path)
    return _at_rate(_as_filters(equalised_spectra(hrtf)), round(hrtf.rate), rate)


def _at_rate(filters: np.ndarray, native: int, rate: int) -> tuple[np.ndarray, int]:
    """(float32 filters (…, taps) at `rate`, their delay in samples)."""
    if rate != native:
        common = gcd(rate, native)
        up, down = rate // common, native // common
        # A filter is a density in time: keep its gain when the samples get closer or wider.
        filters = scipy.signal.resample_poly(filters, up, down, axis=-1) * (down / up)
    filters = np.ascontiguousarray(filters, np.float32)
    filters.setflags(write=False)
    return filters, round(_TAPS // 2 * rate / native)
