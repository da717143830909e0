"""Export for programs that evaluate measured rooms: impulse responses and the parameters of ISO 3382-1.

Each pair is a WAV file of one channel, 32-bit PCM, which measuring programs load as an impulse response (REW:
Import Impulse Response). `parameters.tsv` has a row a pair and octave, the names and units of ISO 3382-1, and
standard errors. No public description of a file was found by which REW or I-Simpa take parameters, so that these
are a table for spreadsheets. A file has a peak of one half; what it was multiplied by is in the table.
"""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import soundfile

from soundspaces_parameters.registry import PARAMETERS, check_parameters
from soundspaces_sim import ConfigError, RirDataset
from soundspaces_sim.parts import (
    ExportPlan,
    ExportProgress as Progress,
    choose_pairs,
    make_folder,
    publish_file as publish,
    response_samples_of as samples_of,
)

_NAMES = ("edt", "t20", "t30", "c50", "c80", "d50", "ts", "g", "lf", "lfc")
#: As ISO 3382-1:2009 writes them.
_SYMBOLS = {
    "edt": "EDT", "t20": "T20", "t30": "T30", "c50": "C50", "c80": "C80", "d50": "D50", "ts": "TS", "g": "G",
    "lf": "JLF", "lfc": "JLFC",
}  # fmt: skip
_PEAK, _HEADER, _ROW = 0.5, 44, 200
_OCTAVES = 7  # rows of a pair in the table, about


def plan_iso3382(
    ds: RirDataset,
    out: str | Path,
    pairs: str | Path = "all",
    parameters: tuple[str, ...] = _NAMES,
) -> ExportPlan:
    """`out`/<scene>/<source>_<listener>.wav of the chosen pairs of two points (see `plan.choose_pairs`), and
    `out`/<scene>/parameters.tsv. Raises `ConfigError`."""
    names = check_parameters(parameters)
    rows = choose_pairs(ds, pairs)
    rows = rows[rows[:, 0] != rows[:, 1]]
    if not len(rows):
        raise ConfigError("pairs: expected pairs of two points")

    folder = Path(out) / ds.scene

    def write(progress: Progress) -> None:
        make_folder(folder)
        scale = np.empty(len(rows))
        for done, (s, l) in enumerate(rows.tolist()):
            response = ds.monaural(s, l)[0]
            peak = float(np.abs(response).max(initial=0.0))
            scale[done] = _PEAK / peak if peak > 0.0 else 1.0
            publish(folder / f"{s}_{l}.wav", _pcm(scale[done] * response, ds.rate), durable=False)
            progress(done + 1, len(rows))
        publish(folder / "parameters.tsv", _table(ds, rows, names, scale), durable=False)

    size = len(rows) * (_HEADER + 4 * samples_of(ds) + _OCTAVES * _ROW)
    return ExportPlan(Path(out), len(rows) + 1, size, write, [folder])


def _pcm(samples: np.ndarray, rate: int) -> bytes:
    """A WAV file of (n,) samples up to 1."""
    file = io.BytesIO()
    soundfile.write(file, samples.astype(float), rate, subtype="PCM_32", format="WAV")
    return file.getvalue()


def _table(ds: RirDataset, rows: np.ndarray, names: tuple[str, ...], scale: np.ndarray) -> bytes:
    """The pairs' parameters in octaves: empty where there is none."""
    found = ds.parameters(names, pairs=rows)
    head = ["source", "listener", "file", "gain_dB", "octave_Hz"]
    for name in names:
        title = f"{_SYMBOLS.get(name, name)}/{PARAMETERS[name].unit}"
        head += [title, f"u({title})"]
    lines = ["\t".join(head)]
    for (s, l), row, gain in zip(rows.tolist(), range(len(rows)), scale, strict=True):
        for k, octave in enumerate(found.bands.centre):
            cells = [str(s), str(l), f"{s}_{l}.wav", f"{20.0 * math.log10(gain):.4f}", f"{octave:g}"]
            for name in names:
                cells += [_cell(v) for v in found.values[name][row, k, :2]]
            lines.append("\t".join(cells))
    return ("\n".join(lines) + "\n").encode()


def _cell(value: float) -> str:
    return f"{value:.5g}" if math.isfinite(value) else ""
