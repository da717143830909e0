"""WAV files: float32 with the plain 44-byte header that every reader takes."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.base.files import publish
from soundspaces_sim.reading.dataset import RirDataset

_IEEE_FLOAT = 3
Progress = Callable[[int, int], None]


def wav_bytes(signal: np.ndarray, rate: int) -> bytes:
    """A float32 WAV file of (channels, n)."""
    channels = signal.shape[0]
    data = np.ascontiguousarray(signal.T, "<f4").tobytes()
    form = struct.pack("<HHIIHH", _IEEE_FLOAT, channels, rate, rate * channels * 4, channels * 4, 32)
    head = (
        b"RIFF" + struct.pack("<I", 36 + len(data)) + b"WAVEfmt " + struct.pack("<I", len(form)) + form
    )
    return head + b"data" + struct.pack("<I", len(data)) + data


def make_folder(path: Path) -> Path:
    """A folder, made if need be. Raises `ConfigError`."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{path}: cannot make this folder ({error.strerror})") from error
    return path


def export_wav(
    ds: RirDataset,
    out: str | Path,
    headings: tuple[float, ...] = (0.0,),
    ambisonics: bool = False,
    progress: Progress | None = None,
) -> int:
    """Write `out`/<scene>/<source>_<listener>_<heading>.wav of every pair, and <source>_<listener>_sn3d.wav
    with nine channels if `ambisonics`; the number of files. True delays and levels."""
    folder = make_folder(Path(out) / ds.scene)
    turns = [(heading, 0.0, 0.0) for heading in headings]
    for done, (s, l) in enumerate(ds):
        for heading, response in zip(headings, ds.binaurals(s, l, turns), strict=True):
            publish(folder / f"{s}_{l}_{heading:g}.wav", wav_bytes(response, ds.rate))
        if ambisonics:
            publish(folder / f"{s}_{l}_sn3d.wav", wav_bytes(ds.ambisonic(s, l), ds.rate))
        if progress is not None:
            progress(done + 1, len(ds))
    return len(ds) * (len(headings) + ambisonics)
