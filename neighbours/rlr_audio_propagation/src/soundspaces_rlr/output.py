"""Responses as arrays and files."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import soundfile

from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.records import Config, band_edges
from soundspaces_sim import Scene
from soundspaces_sim.parts import band_windows, center_frequencies

_STEP_S = 0.005
_FLOOR = 1e-20  # of energy: -200 dB


def stack(pairs: list[np.ndarray]) -> np.ndarray:
    """(k, C, n) of k responses (C, …), padded with zeros. Raises `RlrError` if channels differ."""
    counts = sorted({len(pair) for pair in pairs})
    if len(counts) != 1:
        raise RlrError(
            f"responses have {' and '.join(map(str, counts))} channels and do not fit in one array; use "
            "get_listener_audio or get_listener_source_audio"
        )
    out = np.zeros((len(pairs), counts[0], max(pair.shape[1] for pair in pairs)))
    for row, pair in zip(out, pairs, strict=True):
        row[:, : pair.shape[1]] = pair
    return out


def write_wave(pair: np.ndarray, rate: int, path: Path) -> None:
    """Write (C, n) as a float32 WAV file."""
    try:
        soundfile.write(path, pair.T.astype(np.float32), rate, subtype="FLOAT", format="WAV")
    except (OSError, soundfile.SoundFileError) as error:
        raise RlrError(f"{path}: cannot write this file ({error})") from error


def write_metrics(pair: np.ndarray, config: Config, path: str) -> None:
    """Write the energy of each band in steps of 5 ms, in dB, one text file per channel."""
    rate = round(config.sample_rate)
    bands = band_edges(config.frequency_bands)
    centers = center_frequencies(bands)
    step = max(round(_STEP_S * rate), 1)
    size = -(-pair.shape[1] // step) * step
    windows = band_windows(bands, np.fft.rfftfreq(2 * size, 1.0 / rate), rate)
    for channel, signal in enumerate(pair):
        spectrum = np.fft.rfft(signal, 2 * size)
        energy = [np.fft.irfft(spectrum * np.sqrt(w))[:size].reshape(-1, step) ** 2 for w in windows]
        levels = 10.0 * np.log10(np.maximum([e.sum(axis=1) for e in energy], _FLOOR))
        rows = ["\t".join(["Bands", *(f"{c:.6f}" for c in centers[: len(windows)])])]
        for k, level in enumerate(levels.T):
            rows.append("\t".join(f"{v:.6f}" for v in ((k + 0.5) * step / rate, *level)))
        _write_text(Path(f"{path} ch{channel} etc.txt"), rows)


def write_scene(scene: Scene | None, path: Path) -> None:
    """Write a scene as OBJ; faces of one material category make a group."""
    rows = ["# soundspaces_sim, metres"]
    if scene is not None:
        rows += ["v {:.9g} {:.9g} {:.9g}".format(*v) for v in scene.vertices]
        order = np.argsort(scene.face_label, kind="stable")
        cuts = np.flatnonzero(np.diff(scene.face_label[order], prepend=-1))
        for first, last in pairwise([*cuts, len(order)]):
            name = scene.labels[scene.face_label[order[first]]].replace(" ", "_")
            rows += [f"g {name}", f"usemtl {name}"]
            rows += ["f {} {} {}".format(*(scene.faces[i] + 1)) for i in order[first:last]]
    _write_text(path, rows)


def _write_text(path: Path, rows: list[str]) -> None:
    try:
        path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    except OSError as error:
        raise RlrError(f"{path}: cannot write this file ({error.strerror})") from error
