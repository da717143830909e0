"""The one reader of sound files: WAV, FLAC and what else libsndfile knows, of strangers too."""

from __future__ import annotations

from math import gcd
from pathlib import Path

import numpy as np
import soundfile

from soundspaces_sim.core.errors import SoundSpacesSimError
from soundspaces_sim.core.io.untrusted import open_regular

MOST_SAMPLES = 100_000_000  # of all channels
_LOWEST, _HIGHEST = 1000, 768_000  # Hz


def read_sound(
    path: str | Path, error: type[SoundSpacesSimError], longest: float | None = None
) -> tuple[np.ndarray, int]:
    """(n, channels) float64 finite samples of a file, at least one, and their rate, Hz. Raises `error` for what is
    no regular file, no sound, longer than `longest` s, or of more than `MOST_SAMPLES` samples, and then reads
    nothing."""
    try:
        with open_regular(Path(path), error, "sound") as opened, soundfile.SoundFile(opened) as file:
            rate, channels, frames = int(file.samplerate), file.channels, file.frames
            if not _LOWEST <= rate <= _HIGHEST:
                raise error(f"{path}: expected a rate of 1 to 768 kHz, got {rate} Hz")
            if longest is not None and not frames <= longest * rate:
                raise error(
                    f"{path}: {frames / rate:.0f} s are too long a sound; at most {longest:.0f} s"
                )
            if not frames * channels <= MOST_SAMPLES:
                raise error(
                    f"{path}: {frames:,} samples of {channels} channels are too many; at most "
                    f"{MOST_SAMPLES:,} in all"
                )
            samples = file.read(dtype="float64", always_2d=True)
    except error:
        raise
    except (
        OSError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as problem:  # libsndfile's own is a RuntimeError
        raise error(f"{path}: cannot read this sound ({problem})") from problem
    if not len(samples):
        raise error(f"{path}: this sound is empty")
    if not np.isfinite(samples).all():
        raise error(f"{path}: this sound has samples that are not finite numbers")
    return samples, rate


def mono(samples: np.ndarray, own: int, rate: int) -> np.ndarray:
    """(n,) mean of the channels of (n, channels) samples at `own` Hz, at `rate` Hz."""
    from scipy.signal import resample_poly  # takes a second to load

    mean = samples.mean(axis=1)
    if own == rate:
        return np.asarray(mean)
    common = gcd(own, rate)
    return np.asarray(resample_poly(mean, rate // common, own // common))
