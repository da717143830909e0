"""Parameters of many pairs as a table, for people and programs: rows of pairs and bands, CSV, XLSX, Parquet,
pandas."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_parameters.evaluate import Bands, Pair
from soundspaces_parameters.registry import PARAMETERS, SUFFIXES
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import (
    ColumnMetadata as Metadata,
    as_data_frame as as_frame,
    core_count,
    install_hint,
    publish_file as publish,
    worker_pool,
    write_table,
)

if TYPE_CHECKING:
    import pandas

_KINDS = ("", "_error", "_interpolation")
_ABOUT = ("", "standard error of {}", "what {} may be off for the course within simulated bands")
_AT_ONCE = 16  # pairs that a worker makes one after the other
_MANY = 400  # pairs, from which on processes are worth their start
_MOST_ROWS = 2**20  # of a sheet of Excel


@dataclass(frozen=True)
class ParameterTable:
    """Parameters of P pairs in K bands.

    `pairs` (P, 2) source and listener; `bands`: edges and nominal midband frequencies, Hz; `values`: of each
    parameter (P, K + 1, 3): value, standard error, error of interpolation; the last row of a pair is the
    single-number value of ISO 3382-1, table A.1, or the one value that a pair has (STI). NaN: not defined, or not
    known.
    """

    pairs: np.ndarray
    bands: Bands
    values: dict[str, np.ndarray]

    def __repr__(self) -> str:
        centres = ", ".join(f"{f:g}" for f in self.bands.centre)
        return f"ParameterTable: {', '.join(self.values)} of {len(self.pairs)} pairs at {centres} Hz"

    def __getitem__(self, name: str) -> np.ndarray:
        """(P, K) values of a parameter in bands; of one that a pair has once, (P, 1)."""
        found = self.values[name][:, :, 0]
        return found[:, -1:] if PARAMETERS[name].takes == "index" else found[:, :-1]

    def single(self, name: str) -> np.ndarray:
        """(P, 3) single-number value of each pair, its standard error and its error of interpolation."""
        return self.values[name][:, -1]

    def rows(self) -> np.ndarray:
        """(P * (K + 1),) structured: ``source``, ``listener``, ``band_hz`` (0: single number), ``low_hz``,
        ``high_hz``, and for each parameter ``name``, ``name_error``, ``name_interpolation``."""
        count, per_pair = len(self.pairs), len(self.bands.centre) + 1
        fields = [
            ("source", "i4"),
            ("listener", "i4"),
            ("band_hz", "f8"),
            ("low_hz", "f8"),
            ("high_hz", "f8"),
        ]
        fields += [(name + kind, "f8") for name in self.values for kind in _KINDS]
        out = np.zeros((count, per_pair), fields)
        out["source"], out["listener"] = self.pairs[:, :1], self.pairs[:, 1:]
        edges = np.asarray(self.bands.edges)
        out["band_hz"] = (*self.bands.centre, 0.0)
        out["low_hz"], out["high_hz"] = (*edges[:-1], edges[0]), (*edges[1:], edges[-1])
        for name, found in self.values.items():
            for k, kind in enumerate(_KINDS):
                out[name + kind] = found[:, :, k]
        return out.ravel()

    def columns(self) -> Metadata:
        """Of each column of `rows`: ``unit`` and ``description``."""
        out: Metadata = {
            "source": {"unit": "", "description": "row of the dataset's points"},
            "listener": {"unit": "", "description": "row of the dataset's points"},
            "band_hz": {
                "unit": "Hz",
                "description": "nominal midband frequency; 0: single-number value",
            },
            "low_hz": {"unit": "Hz", "description": "lower edge of the band"},
            "high_hz": {"unit": "Hz", "description": "upper edge of the band"},
        }
        for name in self.values:
            unit, about = PARAMETERS[name].unit, PARAMETERS[name].about
            for kind, text in zip(_KINDS, _ABOUT, strict=True):
                out[name + kind] = {"unit": unit, "description": text.format(name) or about}
        return out

    def pandas(self) -> pandas.DataFrame:
        """`rows` as a data frame (extra ``pandas``), with `columns` in its ``attrs``."""
        return as_frame(self.rows(), self.columns())

    def write(self, path: str | Path) -> list[Path]:
        """Write `rows` to a .csv, .xlsx (extra ``xlsx``) or .parquet file; the files written. Raises
        `ConfigError`."""
        path = Path(path)
        if path.suffix not in SUFFIXES:
            raise ConfigError(f"{path}: expected a name that ends in {', '.join(SUFFIXES)}")
        if path.suffix == ".xlsx":
            publish(path, _sheet(self.rows(), self.columns(), path))
            return [path]
        return write_table(self.rows(), path, self.columns(), key=("source", "listener", "band_hz"))


Progress = Callable[[int, int], None]  # pairs done, of how many
PairOf = Callable[[int, int], Pair]


def evaluate(
    pairs: np.ndarray,
    names: Sequence[str],
    bands: Bands,
    pair_of: PairOf,
    opened: Callable[[], PairOf] | None = None,
    progress: Progress | None = None,
) -> ParameterTable:
    """The table of pairs (P, 2); `pair_of(source, listener)` reads one. Of many pairs it is made in processes,
    where `opened`, which can be pickled, makes `pair_of`; else in threads."""
    if len(pairs) == 0:
        raise ConfigError("pairs: expected at least one pair")
    parts = [pairs[first : first + _AT_ONCE] for first in range(0, len(pairs), _AT_ONCE)]
    workers = min(core_count(), len(parts))
    reader: Callable[[], PairOf] = partial(_same, pair_of)
    at_work: Callable[[], AbstractContextManager[Executor]] = partial(ThreadPoolExecutor, workers)
    if opened is not None and len(pairs) >= _MANY and workers > 1:
        reader, at_work = opened, partial(worker_pool, workers)
    found: list[list[np.ndarray]] = []
    with at_work() as pool:
        for values in pool.map(partial(_of_part, reader, tuple(names)), parts):
            found.append(values)
            if progress is not None:
                progress(min(len(found) * _AT_ONCE, len(pairs)), len(pairs))
    columns = (np.concatenate(column) for column in zip(*found, strict=True))
    return ParameterTable(pairs, bands, dict(zip(names, columns, strict=True)))


def _same(pair_of: PairOf) -> PairOf:
    return pair_of


def _of_part(
    reader: Callable[[], PairOf], names: tuple[str, ...], pairs: np.ndarray
) -> list[np.ndarray]:
    """Of each parameter (n, K + 1, 3)."""
    pair_of = reader()
    rows = []
    for s, l in pairs.tolist():
        pair = pair_of(s, l)
        rows.append([_column(pair, name) for name in names])
    return [np.stack(column) for column in zip(*rows, strict=True)]


def _column(pair: Pair, name: str) -> np.ndarray:
    """(K + 1, 3)."""
    found = pair.values(name)
    single = np.stack(pair.single_number(name, found), axis=1)
    if PARAMETERS[name].takes == "index":
        return np.concatenate([np.full((len(pair.bands.centre), 3), np.nan), single])
    return np.concatenate([np.stack(found, axis=1), single])


def _sheet(rows: np.ndarray, columns: Metadata, path: Path) -> bytes:
    """A workbook: a sheet of rows, and one of what columns mean."""
    try:
        from openpyxl import Workbook
    except ImportError:
        raise ConfigError(
            f"{path}: XLSX needs openpyxl: {install_hint('xlsx')}; or write .csv"
        ) from None
    if len(rows) >= _MOST_ROWS:
        raise ConfigError(
            f"{path}: {len(rows):,} rows are more than a sheet holds; write .csv or .parquet"
        )
    book = Workbook(write_only=True)
    sheet = book.create_sheet("parameters")
    sheet.append(list(rows.dtype.names or ()))
    for row in rows.tolist():
        sheet.append([None if isinstance(x, float) and not np.isfinite(x) else x for x in row])
    about = book.create_sheet("columns")
    about.append(["column", "unit", "description"])
    for name, entry in columns.items():
        about.append([name, entry["unit"], entry["description"]])
    data = io.BytesIO()
    book.save(data)
    return data.getvalue()
