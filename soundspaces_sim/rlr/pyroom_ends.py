"""Sources and microphones of `pyroom`, and the checks of what makes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from soundspaces_sim.rlr.errors import RlrError

_KINDS = {"float32": "FLOAT", "float64": "DOUBLE", "int16": "PCM_16", "int32": "PCM_32"}


def places(values: Any, what: str) -> np.ndarray:
    """(3, m) finite places of (3,) or (3, m). Raises `RlrError`."""
    try:
        found = np.array(values, float)
    except (TypeError, ValueError):
        found = np.empty(0)
    found = found[:, None] if found.ndim == 1 else found
    if found.ndim != 2 or len(found) != 3 or not np.isfinite(found).all():
        raise RlrError(f"{what}: expected finite coordinates (3,) or (3, m), in m, got {values!r}")
    return found


@dataclass
class SoundSource:
    """`position` (3,) m; `signal` (n,) from `delay` s on, or None for a response only. Raises `RlrError`."""

    position: np.ndarray
    signal: np.ndarray | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        at = places(self.position, "SoundSource")
        if at.shape[1] != 1:
            raise RlrError(f"SoundSource: expected one place (3,), got {at.shape[1]}")
        self.position, self.delay = at[:, 0], float(self.delay)
        if not 0.0 <= self.delay < math.inf:
            raise RlrError(f"SoundSource: delay: expected s, 0 or more, got {self.delay!r}")
        if self.signal is not None:
            self.signal = np.asarray(self.signal, float).ravel()
            if not (len(self.signal) and np.isfinite(self.signal).all()):
                raise RlrError("SoundSource: signal: expected finite samples, one or more")


@dataclass
class MicrophoneArray:
    """`R` (3, m): places of omnidirectional microphones, m; `signals` (m, n) what they recorded."""

    R: np.ndarray
    fs: float
    signals: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.R = places(self.R, "MicrophoneArray")

    @property
    def M(self) -> int:  # noqa: N802
        """Number of microphones."""
        return self.R.shape[1]

    def __len__(self) -> int:
        return self.M

    def to_wav(
        self, filename: str | Path, mono: bool = False, norm: bool = False, bitdepth: Any = np.float32
    ) -> None:
        """Write what was recorded; `norm`: scaled to a peak of 1; `mono`: the first microphone alone. Raises
        `RlrError`, also for samples beyond 1 that integers cannot hold."""
        if self.signals is None:
            raise RlrError("to_wav: nothing has been recorded; call Room.simulate first")
        signals = self.signals[:1] if mono else self.signals
        peak = float(np.abs(signals).max(initial=0.0))
        if norm and peak > 0.0:
            signals, peak = signals / peak, 1.0
        name = np.dtype(bitdepth).name
        if name not in _KINDS:
            raise RlrError(f"to_wav: bitdepth: expected {', '.join(_KINDS)}, got {bitdepth!r}")
        if name.startswith("int") and not peak <= 1.0:
            raise RlrError(f"to_wav: {name} holds samples up to 1, got {peak:.3g}; set norm=True")
        try:
            soundfile.write(filename, signals.T, round(self.fs), subtype=_KINDS[name], format="WAV")
        except (OSError, soundfile.SoundFileError) as error:
            raise RlrError(f"{filename}: cannot write this file ({error})") from error
