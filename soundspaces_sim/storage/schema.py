"""What a shard must hold: reads data_schema/ and checks open HDF5 files against it.

A shard has a *form* (``echogram`` or ``waveform``) and a version; every version ever written is read.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Any, Literal

import h5py

from soundspaces_sim.base.errors import DatasetError
from soundspaces_sim.base.resources import resource

Form = Literal["echogram", "waveform"]
CURRENT: dict[Form, int] = {"echogram": 2, "waveform": 1}
_PREFIX = "soundspaces_sim/"


@cache
def schema(form: Form, version: int | None = None) -> dict[str, Any]:
    """The schema of a version, by default the current one, as parsed JSON."""
    text = resource("data_schema", f"{form}-{version or CURRENT[form]}.json").read_text(encoding="utf-8")
    parsed: dict[str, Any] = json.loads(text)
    return parsed


def fixed_attributes(form: Form) -> dict[str, Any]:
    """Attributes whose value the current schema fixes: name, version, conventions."""
    head = {"format": _PREFIX + form, "schema_version": CURRENT[form]}
    return {**head, **{k: a["value"] for k, a in schema(form)["attributes"].items() if "value" in a}}


def check(file: h5py.File, where: str, form: Form) -> int:
    """The version of an open file, which is a shard of this form, complete. Raises `DatasetError`."""
    if file.attrs.get("format") != _PREFIX + form:
        raise DatasetError(
            f"{where}: not a shard of soundspaces_sim (format {file.attrs.get('format')!r}, expected "
            f"{_PREFIX + form!r})"
        )
    version = int(file.attrs.get("schema_version", -1))
    if not 1 <= version <= CURRENT[form]:
        raise DatasetError(
            f"{where}: schema version {version}, this version of soundspaces_sim reads 1 to "
            f"{CURRENT[form]}; install a newer one"
        )
    expected = schema(form, version)
    for name, attribute in expected["attributes"].items():
        if name not in file.attrs:
            raise DatasetError(f"{where}: attribute '{name}' is missing")
        if "value" in attribute and file.attrs[name] != attribute["value"]:
            raise DatasetError(
                f"{where}: attribute '{name}' is {file.attrs[name]!r}, expected {attribute['value']!r}"
            )
    sizes: dict[str, int] = {}
    for name, spec in expected["datasets"].items():
        if name not in file:
            raise DatasetError(f"{where}: dataset '{name}' is missing")
        item = file[name]
        kinds = [spec["dtype"]] if isinstance(spec["dtype"], str) else spec["dtype"]
        if item.dtype.name not in kinds or item.ndim != len(spec["shape"]):
            raise DatasetError(
                f"{where}: dataset '{name}' is {item.dtype.name} {item.shape}, expected "
                f"{' or '.join(kinds)} {tuple(spec['shape'])}"
            )
        for length, symbol in zip(item.shape, spec["shape"], strict=True):
            _match(sizes, symbol, length, f"{where}: dataset '{name}' has shape {item.shape}")
    return version


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
