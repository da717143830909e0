"""Writer of material files, which `load_materials` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import numpy as np

from soundspaces_sim import MaterialError, MaterialTable
from soundspaces_sim.parts import (
    FREE,
    band_means,
    fractional_octaves,
    nominal,
)

_FIELDS = ("absorption", "scattering", "transmission")
_LOWEST, _HIGHEST = 31.0, 16100.0  # Hz, of octaves' midband frequencies


def in_octaves(table: MaterialTable) -> MaterialTable:
    """The table at the midband frequencies of octaves from 31.5 Hz to 16 kHz: means over them."""
    _, exact = fractional_octaves(1, _LOWEST, _HIGHEST)
    centre = np.array([nominal(float(f)) for f in exact])
    between = np.sqrt(centre[1:] * centre[:-1])  # where a table of octaves has its steps
    edges = [0.5 * between[0], *between, 2.0 * between[-1]]
    columns = [
        np.clip(band_means(table.frequency_hz, values, edges), 0.0, 1.0)
        for values in (*(getattr(table, name) for name in _FIELDS), table.sheet)
    ]
    return MaterialTable(
        table.names,
        centre,
        *columns,
        reflection=table.reflection,
        mounting=table.mounting,
    )


def materials_toml(
    table: MaterialTable,
    rows: Sequence[int],
    head: str,
    further: Mapping[str, Mapping[str, Sequence[float] | Sequence[bool] | str]],
) -> str:
    """The text of a material file with some rows of a table. `head`: lines of comment; `further`: by material, keys
    that `load_materials` leaves alone. Raises `MaterialError` for layers that hang free under a name that does not
    say so."""
    parts = ["".join(f"# {line}\n" for line in head.splitlines())]
    parts.append(f"frequency_hz = {_list(table.frequency_hz)}\n")
    for row in rows:
        name = table.names[row]
        if name.endswith(FREE) != (table.mounting[row] == "free"):
            raise MaterialError(
                f"'{name}' is mounted {table.mounting[row]}, which its name does not say"
            )
        parts.append(f"\n[materials.{json.dumps(name)}]\n")
        parts += [f"{field} = {_list(getattr(table, field)[row])}\n" for field in _FIELDS]
        if np.isfinite(table.sheet[row]).all():
            parts.append(f"sheet = {_list(table.sheet[row])}\n")
        if table.reflection[row]:
            parts.append(f"reflection = {json.dumps(table.reflection[row])}\n")
        for key, value in further.get(name, {}).items():
            text = json.dumps(value) if isinstance(value, str) else _list(value)
            parts.append(f"{key} = {text}\n")
    return "".join(parts)


def _list(values: Sequence[float] | Sequence[bool] | np.ndarray) -> str:
    """A TOML array."""
    return f"[{', '.join(_one(value) for value in np.asarray(values).tolist())}]"


def _one(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.5g}"
