"""The table of pairs: one row per source and listener, flat columns, so that pandas takes it as it is."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.base.extras import install_hint
from soundspaces_sim.base.files import publish
from soundspaces_sim.storage.echogram_shard import EchogramShard
from soundspaces_sim.storage.shard import Shard

if TYPE_CHECKING:
    import pandas

_MEASURES = ("t30", "edt", "c50", "drr")
_ERRORS = ("early_error", "late_error")


def pair_dtype(bands: int) -> np.dtype:
    """Columns; those per band end in the band's number: ``t30_0`` to ``t30_3``.

    source, listener: rows of the points. distance, geodesic: m. visible: nothing stands between.
    status: 0 ok, 1 silent, 2 failed. t30, edt: s. c50, drr: dB. early_error, late_error: relative
    standard errors of the energy up to 80 ms after the direct sound's time, and later.
    """
    columns: list[tuple[str, str]] = [("source", "i4"), ("listener", "i4")]
    columns += [(f"{end}_{axis}", "f8") for end in ("source", "listener") for axis in "xyz"]
    columns += [("distance", "f4"), ("geodesic", "f4"), ("visible", "?"), ("status", "u1")]
    columns += [(f"{name}_{b}", "f4") for name in (*_MEASURES, *_ERRORS) for b in range(bands)]
    return np.dtype(columns)


def shard_table(shard: Shard) -> np.ndarray:
    """(S * L,) rows of one shard. Version 1 has no measures: they are taken from its echograms."""
    s, l = len(shard.sources), len(shard.listeners)
    bands = len(shard.bands) - 1
    out = np.zeros((s, l), pair_dtype(bands))
    out["source"] = shard.read("source_index")[:, None]
    out["listener"] = shard.read("listener_index")[None, :]
    for i, axis in enumerate("xyz"):
        out[f"source_{axis}"] = shard.sources[:, None, i]
        out[f"listener_{axis}"] = shard.listeners[None, :, i]
    out["distance"] = np.linalg.norm(shard.sources[:, None] - shard.listeners[None], axis=2)
    out["geodesic"] = shard.pairs.get("geodesic", np.float32(np.nan))
    out["visible"] = shard.pairs["walls"] == 0
    out["status"] = shard.pairs["status"]
    for b in range(bands):
        for k, name in enumerate(_ERRORS):
            out[f"{name}_{b}"] = shard.pairs["relative_error"][:, :, k, b]
        for name in _MEASURES:
            if name in shard.pairs:
                out[f"{name}_{b}"] = shard.pairs[name][:, :, b]
    if "t30" not in shard.pairs and isinstance(shard, EchogramShard):
        from soundspaces_sim.echo.measures import room_measures  # SciPy, which newer files do without

        for i in range(s):
            for j in range(l):
                measures = room_measures(shard.echogram(i, j))
                for name in _MEASURES:
                    for b in range(bands):
                        out[f"{name}_{b}"][i, j] = getattr(measures, name)[b]
    return out.ravel()


def as_frame(table: np.ndarray) -> pandas.DataFrame:
    """A table as a pandas data frame. Raises `ConfigError` if pandas is not installed."""
    try:
        import pandas
    except ImportError:
        raise ConfigError(
            f"a data frame needs pandas: {install_hint('pandas')}; without it, the columns of the "
            "structured array have the same names"
        ) from None
    return pandas.DataFrame({name: table[name] for name in table.dtype.names or ()})


def write_table(table: np.ndarray, path: str | Path) -> None:
    """Write a table as CSV, or as Parquet (needs pyarrow) if `path` ends in .parquet."""
    path = Path(path)
    if path.suffix == ".parquet":
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError:
            raise ConfigError(
                f"{path}: Parquet needs pyarrow; `pip install pyarrow`, or write .csv"
            ) from None
        sink = io.BytesIO()
        columns = {name: np.ascontiguousarray(table[name]) for name in table.dtype.names or ()}
        pyarrow.parquet.write_table(pyarrow.table(columns), sink)
        publish(path, sink.getvalue())
        return
    if path.suffix != ".csv":
        raise ConfigError(f"{path}: expected a name that ends in .csv or .parquet")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.dtype.names or ())
    writer.writerows([x.item() if isinstance(x, np.generic) else x for x in row] for row in table)
    publish(path, text.getvalue().encode())
