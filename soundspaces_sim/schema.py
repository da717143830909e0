"""What a shard must hold: reads data_schema/ and checks open HDF5 files against it."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import h5py

from soundspaces_sim.errors import DatasetError
from soundspaces_sim.resources import resource

FORMAT = "soundspaces_sim/echogram"
VERSION = 1


@cache
def schema() -> dict[str, Any]:
    """The schema of the current version, as parsed JSON."""
    text = resource("data_schema", f"echogram-{VERSION}.json").read_text(encoding="utf-8")
    parsed: dict[str, Any] = json.loads(text)
    return parsed


def fixed_attributes() -> dict[str, str]:
    """Attributes whose value the schema fixes: the conventions."""
    return {k: a["value"] for k, a in schema()["attributes"].items() if "value" in a}


def check(file: h5py.File, where: str) -> None:
    """Raise `DatasetError` unless an open file is a shard of this version, complete in form."""
    if file.attrs.get("format") != FORMAT:
        raise DatasetError(
            f"{where}: not a shard of soundspaces_sim (format {file.attrs.get('format')!r}, "
            f"expected {FORMAT!r})"
        )
    if int(file.attrs.get("schema_version", -1)) != VERSION:
        raise DatasetError(
            f"{where}: schema version {file.attrs.get('schema_version')}, this version reads {VERSION}"
        )
    for name, attribute in schema()["attributes"].items():
        if name not in file.attrs:
            raise DatasetError(f"{where}: attribute '{name}' is missing")
        if "value" in attribute and file.attrs[name] != attribute["value"]:
            raise DatasetError(
                f"{where}: attribute '{name}' is {file.attrs[name]!r}, expected {attribute['value']!r}"
            )
    sizes: dict[str, int] = {}
    for name, spec in schema()["datasets"].items():
        if name not in file:
            raise DatasetError(f"{where}: dataset '{name}' is missing")
        item = file[name]
        if item.dtype.name != spec["dtype"] or item.ndim != len(spec["shape"]):
            raise DatasetError(
                f"{where}: dataset '{name}' is {item.dtype.name} {item.shape}, expected "
                f"{spec['dtype']} {tuple(spec['shape'])}"
            )
        for length, symbol in zip(item.shape, spec["shape"], strict=True):
            _match(sizes, symbol, length, f"{where}: dataset '{name}' has shape {item.shape}")


def _match(sizes: dict[str, int], symbol: str | int, length: int, what: str) -> None:
    if isinstance(symbol, int):
        expected: int | None = symbol
    elif symbol == "S*L+1":
        expected = sizes["S"] * sizes["L"] + 1
    elif symbol.endswith("+1"):
        expected = sizes.setdefault(symbol[:-2], length - 1) + 1
    else:
        expected = sizes.setdefault(symbol, length)
    if length != expected:
        raise DatasetError(f"{what}, expected {symbol} = {expected}")
