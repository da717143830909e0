"""The table of pairs: one row per source and listener, flat columns, so that pandas takes it as it is."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.extras import install_hint
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.dataset.format.schema import schema
from soundspaces_sim.dataset.format.shard import Shard
from soundspaces_sim.echogram.measure_names import MEASURES

if TYPE_CHECKING:
    import pandas

#: Of each column: ``unit``, ``description`` and, for those of one band, ``band_hz``, its lower and upper edge.
Metadata = dict[str, dict[str, Any]]


class _PerBand(NamedTuple):
    """A quantity that a pair has in every band: columns `name`_0, `name`_1, …

    `dataset`: that of the shards, whose schema has unit and description; `part`: its row, if it has several;
    `of`: the measure whose unit it has.
    """

    name: str
    dataset: str
    part: int | None = None
    description: str = ""
    of: str = ""

    def values(self, shard: Shard, changed: Mapping[str, np.ndarray]) -> np.ndarray:
        """(S, L, bands); of datasets in `changed` those."""
        found = changed[self.dataset] if self.dataset in changed else shard.pairs[self.dataset]
        return found if self.part is None else found[:, :, self.part]


#: Columns per band in their order. The error bar of a column is one more entry.
_PER_BAND = (
    *(_PerBand(name, name) for name in MEASURES),
    *(
        _PerBand(f"{name}_error", "measure_error", k, f"standard error of {name}; NaN: not known", name)
        for k, name in enumerate(MEASURES)
    ),
    _PerBand(
        "early_error",
        "relative_error",
        0,
        "relative standard error of the energy up to 80 ms after the direct sound's time",
    ),
    _PerBand("late_error", "relative_error", 1, "relative standard error of the energy after that"),
)
_PER_PAIR = {
    "source": ("i4", "", "row of the dataset's points"),
    "listener": ("i4", "", "row of the dataset's points"),
    **{f"{end}_{axis}": ("f8", "m", "position") for end in ("source", "listener") for axis in "xyz"},
    "distance": ("f4", "m", "straight line between the points"),
    "geodesic": ("f4", "m", schema("echogram")["datasets"]["geodesic"]["description"]),
    "visible": ("?", "", "nothing stands between the points"),
    "collocated": ("?", "", "source and listener are the same point; the direct sound is that of 5 cm"),
    "status": ("u1", "", schema("echogram")["datasets"]["status"]["description"]),
}


def pair_dtype(bands: int) -> np.dtype:
    """Columns; those per band end in the band's number: ``t30_0`` to ``t30_3``. See `column_metadata`."""
    columns = [(name, kind) for name, (kind, _, _) in _PER_PAIR.items()]
    columns += [(f"{quantity.name}_{b}", "f4") for quantity in _PER_BAND for b in range(bands)]
    return np.dtype(columns)


def column_metadata(bands: Sequence[float]) -> Metadata:
    """What each column means, for bands with these edges in Hz."""
    out: Metadata = {
        name: {"unit": unit, "description": text} for name, (_, unit, text) in _PER_PAIR.items()
    }
    for quantity in _PER_BAND:
        spec = schema("echogram")["datasets"][quantity.dataset]
        for b, edges in enumerate(pairwise(bands)):
            out[f"{quantity.name}_{b}"] = {
                "unit": schema("echogram")["datasets"][quantity.of or quantity.dataset].get("unit", "1"),
                "description": quantity.description or spec["description"],
                "band_hz": [float(f) for f in edges],
            }
    return out


def shard_table(shard: Shard, changed: Mapping[str, np.ndarray] | None = None) -> np.ndarray:
    """(S * L,) rows of one shard; `changed`: datasets that other materials have changed."""
    s, l = len(shard.sources), len(shard.listeners)
    bands = len(shard.bands) - 1
    out = np.zeros((s, l), pair_dtype(bands))
    out["source"] = shard.source_index[:, None]
    out["listener"] = shard.listener_index[None, :]
    for i, axis in enumerate("xyz"):
        out[f"source_{axis}"] = shard.sources[:, None, i]
        out[f"listener_{axis}"] = shard.listeners[None, :, i]
    out["distance"] = np.linalg.norm(shard.sources[:, None] - shard.listeners[None], axis=2)
    out["geodesic"] = shard.pairs.get("geodesic", np.float32(np.nan))
    out["visible"] = shard.pairs["walls"] == 0
    out["collocated"] = out["source"] == out["listener"]
    out["status"] = shard.pairs["status"]
    for quantity in _PER_BAND:
        values = quantity.values(shard, changed or {})
        for b in range(bands):
            out[f"{quantity.name}_{b}"] = values[:, :, b]
    return out.ravel()


def concatenate_tables(parts: Iterable[np.ndarray], collocated: bool) -> np.ndarray:
    """The rows of all shards by source and listener; without those of one point alone unless `collocated`."""
    rows = np.concatenate(list(parts))
    if not collocated:
        rows = rows[~rows["collocated"]]
    return rows[np.lexsort((rows["listener"], rows["source"]))]


def as_frame(table: np.ndarray, columns: Metadata) -> pandas.DataFrame:
    """A table as a pandas data frame, whose ``attrs`` have the metadata of columns under ``columns``. Raises
    `ConfigError` if pandas is not installed."""
    try:
        import pandas
    except ImportError:
        raise ConfigError(
            f"a data frame needs pandas: {install_hint('pandas')}; without it, the columns of the "
            "structured array have the same names"
        ) from None
    frame = pandas.DataFrame({name: table[name] for name in table.dtype.names or ()})
    frame.attrs["columns"] = columns
    return frame


def write_table(
    table: np.ndarray, path: str | Path, columns: Metadata, key: Sequence[str] = ("source", "listener")
) -> list[Path]:
    """Write a table, and what its columns mean; the files written.

    A Parquet file (`path` ends in .parquet, needs pyarrow) has the metadata of columns in its fields. A CSV file
    has room for names only: the metadata go to `path`-metadata.json beside it, in the form of the W3C's Metadata
    Vocabulary for Tabular Data. `key`: columns that tell rows apart.
    """
    path = Path(path)
    if path.suffix == ".parquet":
        publish(path, _parquet(table, path, columns))
        return [path]
    if path.suffix != ".csv":
        raise ConfigError(f"{path}: expected a name that ends in .csv or .parquet")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.dtype.names or ())
    writer.writerows([x.item() if isinstance(x, np.generic) else x for x in row] for row in table)
    publish(path, text.getvalue().encode())
    beside = path.with_name(f"{path.name}-metadata.json")
    publish(beside, _csvw(table, path.name, columns, key))
    return [path, beside]


def _parquet(table: np.ndarray, path: Path, columns: Metadata) -> bytes:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ConfigError(
            f"{path}: Parquet needs pyarrow; `pip install pyarrow`, or write .csv"
        ) from None
    arrays = {name: pyarrow.array(np.ascontiguousarray(table[name])) for name in table.dtype.names or ()}
    fields = [
        pyarrow.field(
            name, array.type, metadata={key: _text(value) for key, value in columns[name].items()}
        )
        for name, array in arrays.items()
    ]
    sink = io.BytesIO()
    pyarrow.parquet.write_table(
        pyarrow.table(list(arrays.values()), schema=pyarrow.schema(fields)), sink
    )
    return sink.getvalue()


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


_CSVW_TYPES: Mapping[str, str] = {"i": "integer", "u": "integer", "b": "boolean", "f": "double"}


def _csvw(table: np.ndarray, name: str, columns: Metadata, key: Sequence[str]) -> bytes:
    described = []
    for column in table.dtype.names or ():
        found = columns[column]
        entry: dict[str, Any] = {
            "name": column,
            "titles": column,
            "datatype": _CSVW_TYPES[table.dtype[column].kind],
            "dc:description": found["description"],
            "schema:unitText": found["unit"],
        }
        if "band_hz" in found:
            low, high = found["band_hz"]
            edges = {"schema:minValue": low, "schema:maxValue": high, "schema:unitText": "Hz"}
            entry["schema:additionalProperty"] = {"schema:name": "band", **edges}
        described.append(entry)
    page = {
        "@context": "http://www.w3.org/ns/csvw",
        "url": name,
        "tableSchema": {"columns": described, "primaryKey": list(key)},
    }
    return (json.dumps(page, indent=1) + "\n").encode()
