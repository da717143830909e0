"""What a shard must hold: reads data_schema/ and checks open HDF5 files against it.

A shard has a *form* (``echogram`` or ``waveform``) and a version; docs/promise.md says which are read.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Any, Literal

import h5py
import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.io.hdf5 import attribute, in_our_words, plain_dataset
from soundspaces_sim.core.io.resources import resource

Form = Literal["echogram", "waveform"]
CURRENT: dict[Form, int] = {"echogram": 8, "waveform": 2}
OLDEST: dict[Form, int] = {"echogram": 7, "waveform": 2}
REBUILD = "delete the file and run the same `make rirs` again to rebuild it"
_PREFIX = "soundspaces_sim/"


@cache
def schema(form: Form, version: int | None = None) -> dict[str, Any]:
    """The schema of a version, by default the current one, as parsed JSON."""
    text = resource("data_schema", f"{form}-{version or CURRENT[form]}.json").read_text(encoding="utf-8")
    return json.loads(text)


def fixed_attributes(form: Form) -> dict[str, Any]:
    """Attributes whose value the current schema fixes: name, version, conventions."""
    head = {"format": _PREFIX + form, "schema_version": CURRENT[form]}
    return {**head, **{k: a["value"] for k, a in schema(form)["attributes"].items() if "value" in a}}


def check(file: h5py.File, where: str, form: Form) -> int:
    """The version of an open file, which is a shard of this form, complete. Raises `DatasetError`.

    Nothing of its datasets is read: each lies in the file, whole, and is of the schema's type and shape.
    """
    found = attribute(file, "format", where, DatasetError, REBUILD)
    if found != _PREFIX + form:
        raise DatasetError(
            f"{where}: not a shard of soundspaces_sim (format {found!r}, expected {_PREFIX + form!r})"
        )
    version = attribute(file, "schema_version", where, DatasetError, REBUILD)
    if not isinstance(version, int) or not OLDEST[form] <= version <= CURRENT[form]:
        old = isinstance(version, int) and version < OLDEST[form]
        remedy = "build the dataset anew" if old else "install a newer one"
        raise DatasetError(
            f"{where}: schema version {version}, this version of soundspaces_sim reads {OLDEST[form]} to "
            f"{CURRENT[form]}; {remedy}"
        )
    expected = schema(form, version)
    for name, spec in expected["attributes"].items():
        _check_attribute(attribute(file, name, where, DatasetError, REBUILD), name, spec, where)
    sizes: dict[str, int] = {}
    for name, spec in expected["datasets"].items():
        item = plain_dataset(file, name, where, DatasetError, REBUILD)
        kinds = [spec["dtype"]] if isinstance(spec["dtype"], str) else spec["dtype"]
        with in_our_words(f"{where}: dataset '{name}'", DatasetError, REBUILD):
            dtype, shape = item.dtype, item.shape
        if dtype not in [np.dtype(kind).newbyteorder("<") for kind in kinds] or len(shape) != len(
            spec["shape"]
        ):
            raise DatasetError(
                f"{where}: dataset '{name}' is {dtype} {shape}, expected "
                f"{' or '.join(kinds)} {tuple(spec['shape'])}, little-endian"
            )
        for length, symbol in zip(shape, spec["shape"], strict=True):
            _match(sizes, symbol, length, f"{where}: dataset '{name}' has shape {shape}")
    return version


_KINDS: dict[str, Any] = {"string": str, "integer": int, "number": (int, float)}


def _check_attribute(value: Any, name: str, spec: dict[str, Any], where: str) -> None:
    if value is None:
        raise DatasetError(f"{where}: attribute '{name}' is missing")
    if not isinstance(value, _KINDS[spec["type"]]):
        raise DatasetError(f"{where}: attribute '{name}' is {value!r}, expected a {spec['type']}")
    if "value" in spec and value != spec["value"]:
        raise DatasetError(f"{where}: attribute '{name}' is {value!r}, expected {spec['value']!r}")


def _match(sizes: dict[str, int], symbol: str | int, length: int, what: str) -> None:
    if isinstance(symbol, int):
        expected: int | None = symbol
    elif symbol == "S*L+1":
        expected = sizes.get("S", 0) * sizes.get("L", 0) + 1
    elif symbol.endswith("+1"):
        expected = sizes.setdefault(symbol[:-2], length - 1) + 1
    else:
        expected = sizes.setdefault(symbol, length)
    if length != expected:
        raise DatasetError(f"{what}, expected {symbol} = {expected}")
