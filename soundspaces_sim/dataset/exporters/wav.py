"""WAV files: float32 with the plain 44-byte header that every reader takes."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from soundspaces_sim.core.io.files import make_folder, publish
from soundspaces_sim.core.numerics.axes import CHANNELS
from soundspaces_sim.dataset.exporters.plan import (
    ExportPlan,
    Progress,
    check_headings,
    choose_pairs,
    samples_of,
)
from soundspaces_sim.dataset.reader import RirDataset

HEADER = 44  # bytes
_IEEE_FLOAT = 3


def wav_bytes(signal: np.ndarray, rate: int) -> bytes:
    """A float32 WAV file of (channels, n)."""
    channels = signal.shape[0]
    data = np.ascontiguousarray(signal.T, "<f4").tobytes()
    form = struct.pack("<HHIIHH", _IEEE_FLOAT, channels, rate, rate * channels * 4, channels * 4, 32)
    head = (
        b"RIFF" + struct.pack("<I", 36 + len(data)) + b"WAVEfmt " + struct.pack("<I", len(form)) + form
    )
    return head + b"data" + struct.pack("<I", len(data)) + data


def plan_wav(
    ds: RirDataset,
    out: str | Path,
    headings: tuple[float, ...] = (0.0,),
    ambisonics: bool = True,
    pairs: str | Path = "all",
) -> ExportPlan:
    """`out`/<scene>/<source>_<listener>_<heading>.wav of the chosen pairs (see `plan.choose_pairs`), and
    <source>_<listener>_sn3d.wav with nine channels if `ambisonics`. True delays and levels."""
    headings = check_headings(headings)
    rows = choose_pairs(ds, pairs)
    turns = [(heading, 0.0, 0.0) for heading in headings]
    files = len(rows) * (len(headings) + ambisonics)
    channels = 2 * len(headings) + CHANNELS * ambisonics

    folder = Path(out) / ds.scene

    def write(progress: Progress) -> None:
        make_folder(folder)
        for done, (s, l) in enumerate(rows.tolist()):
            if turns:
                for heading, response in zip(headings, ds.binaurals(s, l, turns), strict=True):
                    publish(
                        folder / f"{s}_{l}_{heading:g}.wav", wav_bytes(response, ds.rate), durable=False
                    )
            if ambisonics:
                publish(
                    folder / f"{s}_{l}_sn3d.wav", wav_bytes(ds.ambisonic(s, l), ds.rate), durable=False
                )
            progress(done + 1, len(rows))

    return ExportPlan(
        Path(out),
        files,
        HEADER * files + len(rows) * channels * 4 * samples_of(ds),
        write,
        [folder],
    )
