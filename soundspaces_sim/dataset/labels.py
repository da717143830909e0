"""What a network learns of pairs beside their responses: columns of the table, and where the source is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.dataset.reader import RirDataset


def pair_labels(
    ds: RirDataset, pairs: np.ndarray, names: Sequence[str] | None = None
) -> dict[str, np.ndarray]:
    """Labels of (k, 2) pairs: columns of the table (k,), and those per band under their common name, (k, bands).

    `names`: ``distance``, ``t30`` and so on; by default all but points and positions. Raises `ConfigError` if there
    is no such column.
    """
    table = ds.table(collocated=True)
    columns: dict[str, list[str]] = {}
    for column in table.dtype.names or ():
        name, _, band = column.rpartition("_")
        columns.setdefault(name if band.isdigit() else column, []).append(column)
    own = {"source", "listener", *(f"{end}_{axis}" for end in ("source", "listener") for axis in "xyz")}
    names = [n for n in columns if n not in own] if names is None else names
    unknown = [n for n in names if n not in columns]
    if unknown:
        raise ConfigError(f"labels: no '{unknown[0]}' in the table; there are {', '.join(columns)}")
    rows = table[pairs[:, 0] * len(ds.points) + pairs[:, 1]]  # every pair, by source and listener
    return {
        n: rows[n] if columns[n] == [n] else np.stack([rows[c] for c in columns[n]], axis=-1)
        for n in names
    }


def source_direction(ds: RirDataset, s: int, l: int, heading_deg: float = 0.0) -> tuple[float, float]:
    """Azimuth and elevation in degrees of point `s` from point `l`, for a head that faces `heading_deg`.

    Azimuth is positive to the left, in (-180, 180]; both are NaN if the points are one.
    """
    x, y, z = ds.points[s] - ds.points[l]
    if x == y == z == 0.0:
        return float("nan"), float("nan")
    azimuth = np.rad2deg(np.arctan2(y, x)) - heading_deg
    return float(180.0 - (180.0 - azimuth) % 360.0), float(np.rad2deg(np.arctan2(z, np.hypot(x, y))))
