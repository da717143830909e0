"""Dry sound through responses: convolution, mixtures, sources and heads that move, spectrograms.

Arrays in, arrays out; `dataset` looks the responses up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import scipy
import scipy.fft
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError

#: Of samples in whole numbers; those of 8 bits lie about 128 in WAV files.
_FULL_SCALE = {np.dtype(np.uint8): 2.0**7, np.dtype(np.int16): 2.0**15, np.dtype(np.int32): 2.0**31}
_N_FFT, _WINDOW, _BLOCK = 512, 400, 4


def as_mono(audio: ArrayLike) -> np.ndarray:
    """(n,) float32. Samples of 8, 16 or 32 bits, as files have them, become shares of full scale. Raises
    `ConfigError` for anything but a finite mono signal."""
    try:
        given = np.asarray(audio)
        if given.dtype in _FULL_SCALE:
            given = (given - 128.0 * (given.dtype == np.uint8)) / _FULL_SCALE[given.dtype]
        if given.dtype.kind not in "biufO":  # casts of others drop an imaginary part, or read text
            raise TypeError
        dry = np.asarray(given, np.float32)
    except (TypeError, ValueError, OverflowError):
        raise ConfigError(f"audio: expected a mono signal of numbers, got {audio!r:.80}") from None
    if dry.ndim != 1 or len(dry) == 0:
        raise ConfigError(f"audio: expected a mono signal of shape (n,), n >= 1, got {dry.shape}")
    bad = np.flatnonzero(~np.isfinite(dry))
    if len(bad):
        raise ConfigError(
            f"audio: expected finite samples, got {dry[bad[0]]} at sample {bad[0]} ({len(bad)} of {len(dry)})"
        )
    return dry


def convolve(dry: np.ndarray, rir: np.ndarray) -> np.ndarray:
    """(channels, m + n - 1) float32: a dry signal (m,) through a response (channels, n)."""
    return np.asarray(scipy.signal.oaconvolve(rir, dry[None], axes=1), np.float32)


def add_up(signals: Sequence[np.ndarray]) -> np.ndarray:
    """Sum of signals (channels, any length), as long as the longest."""
    out = np.zeros((signals[0].shape[0], max(s.shape[1] for s in signals)), np.float32)
    for signal in signals:
        out[:, : signal.shape[1]] += signal
    return out


def along_path(
    dry: np.ndarray, rirs: Sequence[np.ndarray], moving: Literal["source", "listener"]
) -> np.ndarray:
    """(channels, n): a sound while its source or its listener passes k places, at even times, in a line.

    What a moving source emits is cross-faded between places before it travels; what a moving listener
    hears is cross-faded after it has. The first place is that of the first sample, the last of the last.
    """
    if moving not in ("source", "listener"):
        raise ConfigError(f"moving: expected 'source' or 'listener', got {moving!r}")
    length = max(r.shape[1] for r in rirs) + len(dry) - 1
    out = np.zeros((rirs[0].shape[0], length), np.float32)
    time = np.linspace(0.0, len(rirs) - 1.0, len(dry))
    heard = np.interp(np.arange(length), np.arange(len(dry)), time)  # stays at the last place
    for k, rir in enumerate(rirs):
        if moving == "source":
            share = np.maximum(1.0 - np.abs(time - k), 0.0).astype(np.float32)
            part = convolve(dry * share, rir)
        else:
            share = np.maximum(1.0 - np.abs(heard - k), 0.0).astype(np.float32)
            part = convolve(dry, rir)
            part *= share[: part.shape[1]]
        out[:, : part.shape[1]] += part
    return out


def spectrogram(
    ears: np.ndarray,
    rate: int,
    layout: Literal["code", "paper"] = "code",
    pad_mode: Literal["constant", "reflect"] = "constant",
) -> np.ndarray:
    """(65, frames, 2) float32: what SoundSpaces shows its agents of ears (2, n).

    Magnitudes of a short-time Fourier transform (512 points, Hann window of 400, hop 160, centred),
    averaged over blocks of 4 × 4 (padded with zeros), log(1 + x): 26 frames for 1 s at 16 kHz and 69 at
    44.1 kHz, as its code does. ``paper``: a window of 512, and above 16 kHz a hop of 172, which gives the
    65 frames that the paper prints for 1 s at 44.1 kHz. `pad_mode`: librosa's, ``reflect`` before 0.10.
    """
    signal = np.asarray(ears, np.float32)
    if signal.ndim != 2 or signal.shape[0] != 2 or signal.shape[1] <= _N_FFT // 2:
        raise ConfigError(f"ears: expected shape (2, n), n > {_N_FFT // 2}, got {signal.shape}")
    if layout not in ("code", "paper"):
        raise ConfigError(f"layout: expected 'code' or 'paper', got {layout!r}")
    size = _WINDOW if layout == "code" else _N_FFT
    hop = 172 if layout == "paper" and rate > 16000 else 160
    window = np.zeros(_N_FFT, np.float32)
    first = (_N_FFT - size) // 2
    window[first : first + size] = scipy.signal.get_window("hann", size)
    padded = np.pad(signal, ((0, 0), (_N_FFT // 2, _N_FFT // 2)), mode=pad_mode)
    frames = np.lib.stride_tricks.sliding_window_view(padded, _N_FFT, axis=1)[:, ::hop]
    magnitude = np.abs(scipy.fft.rfft(frames * window, axis=2)).transpose(2, 1, 0)
    rows, columns = (-n % _BLOCK for n in magnitude.shape[:2])
    blocks = np.pad(magnitude, ((0, rows), (0, columns), (0, 0)))
    blocks = blocks.reshape(blocks.shape[0] // _BLOCK, _BLOCK, -1, _BLOCK, 2).mean(axis=(1, 3))
    return np.asarray(np.log1p(blocks), np.float32)
