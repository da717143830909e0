"""Measured rooms as tables: a row per pair and octave with parameters, or a row per pair with a WAV file.

Columns, in any order: ``source``, ``receiver`` (names), ``source_x`` to ``receiver_z`` (m), and either
``octave_hz`` with ``t30``, ``edt`` (s), ``c80`` (dB), ``d50`` (0 to 1), at least one of them, and if known their
standard errors ``t30_error`` …; or ``file``, relative to the table, and ``channel`` from 1 on where files have
several. Further columns are left alone; an empty cell is not measured.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from soundspaces_calibration.measured.collect import Collection
from soundspaces_calibration.measured.responses import add_response, read_wav
from soundspaces_calibration.measured.room import MEASURED, MeasuredRoom, octave_of
from soundspaces_sim import DatasetError
from soundspaces_sim.parts import read_text

_MOST = 64 * 2**20  # bytes
_ENDS = ("source", "receiver")
_PLACES = tuple(f"{end}_{axis}" for end in _ENDS for axis in "xyz")
_Row = dict[str, str]


def read_table(path: Path) -> MeasuredRoom:
    """The room of a .csv table. Raises `DatasetError`."""
    out = Collection(str(path))
    for where, row in _rows(path):
        position = np.array([_number(row, name, where) for name in _PLACES]).reshape(2, 3)
        names = [row[end].strip() for end in _ENDS]
        if not all(names):
            raise DatasetError(f"{where}: expected names of source and receiver, got {names}")
        pair = (
            out.sources.add(names[0], position[0], where),
            out.receivers.add(names[1], position[1], where),
        )
        if "file" in row:
            channel = _number(row, "channel", where)
            response, rate = read_wav(path.parent / row["file"], channel, where)
            add_response(out, pair, response, rate, where)
            continue
        octave = octave_of(_number(row, "octave_hz", where), where)
        values = np.array([_number(row, name, where) for name in MEASURED])
        error = np.array([_number(row, f"{name}_error", where) for name in MEASURED])
        out.add(pair, octave, values, error, where)
    return out.room()


def _rows(path: Path) -> Iterator[tuple[str, _Row]]:
    """(place, row) of each line. Raises `DatasetError`."""
    text = read_text(path, DatasetError, "table", _MOST).removeprefix("\ufeff")
    reader = csv.DictReader(text.splitlines(), strict=True)
    try:
        head = [name.strip() for name in reader.fieldnames or ()]
        missing = [name for name in (*_ENDS, *_PLACES) if name not in head]
        measures = "octave_hz" in head and any(name in head for name in MEASURED)
        if missing or not ("file" in head or measures):
            wanted = missing or ["octave_hz with t30, edt, c80 or d50; or file"]
            found = ", ".join(head)[:200] or "an empty file"
            raise DatasetError(f"{path}: expected columns {', '.join(wanted)}, with commas; got {found}")
        reader.fieldnames = head
        for row in reader:
            where = f"{path}, line {reader.line_num}"
            if None in row or None in row.values():
                raise DatasetError(f"{where}: expected {len(head)} cells, as in the first line")
            yield where, row
    except csv.Error as error:
        raise DatasetError(f"{path}, line {reader.line_num}: {error}") from error


def _number(row: _Row, name: str, where: str) -> float:
    """A cell's number; NaN of an empty cell, and without such a column."""
    text = row.get(name, "").strip()
    if not text:
        return math.nan
    try:
        return float(text)
    except ValueError:
        raise DatasetError(f"{where}: expected a number for {name}, got {text[:40]!r}") from None
