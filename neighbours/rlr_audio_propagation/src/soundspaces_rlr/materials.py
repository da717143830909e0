"""The material database of RLR (JSON), and which of its materials a category gets.

`{"materials": [{"name", "labels": [...], "absorption": [f, v, ...], "scattering", "transmission", ...}]}`:
curves are pairs of frequency (Hz) and fraction of energy. `damping`, `speed` and `density` describe waves
inside solids, which this engine does not have; they are not used.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_rlr.errors import RlrError
from soundspaces_sim import MaterialTable
from soundspaces_sim.parts import limit_transmission as limit, overlay_tables as overlay, read_json

_log = logging.getLogger(__name__)
_CURVES = ("absorption", "scattering", "transmission")
#: What a category without a material gets, as in RLR.
DEFAULT = MaterialTable(
    ("(default)",), np.array([1000.0]), np.array([[0.1]]), np.array([[0.5]]), np.array([[0.0]])
)


@dataclass(frozen=True)
class Database:
    """Materials, each a table of one row, and their labels in lower case."""

    tables: tuple[MaterialTable, ...] = ()
    labels: tuple[frozenset[str], ...] = ()

    def find(self, category: str) -> MaterialTable | None:
        """The material of a category: the one of that name, else the one with most of its labels within the
        category (all in lower case; the longer labels decide ties), if there is any."""
        name = category.strip().lower()
        for table in self.tables:
            if table.names[0].strip().lower() == name:
                return table
        hits = [[label for label in labels if label and label in name] for labels in self.labels]
        scores = [(len(found), sum(map(len, found))) for found in hits]
        best = max(range(len(scores)), key=scores.__getitem__, default=-1)  # the first of equals
        return self.tables[best] if best >= 0 and scores[best][0] > 0 else None

    def materials(self, categories: Sequence[str]) -> list[MaterialTable]:
        """The material of each category; the default, and a warning, where there is none."""
        found = [self.find(category) for category in categories]
        lost = [
            c
            for c, table in zip(categories, found, strict=True)
            if table is None and c.lower() != "default"
        ]
        if lost:
            _log.warning("no material for %s: the default (.1, .5, 0)", ", ".join(map(repr, lost)))
        return [DEFAULT if table is None else table for table in found]


def load_database(path: str | Path) -> Database:
    """Read a material database. Raises `RlrError` naming the file and the material."""
    raw = read_json(path, RlrError, "material database")
    rows = raw.get("materials") if isinstance(raw, dict) else None
    if not isinstance(rows, list):
        raise RlrError(f'{path}: expected {{"materials": [...]}}')
    tables, labels = [], []
    for i, row in enumerate(rows):
        if not isinstance(row, dict) or not isinstance(row.get("name"), str):
            raise RlrError(f"{path}: material {i} has no name")
        tables.append(_table(row, f"{path}: material {i} ({row['name']})"))
        labels.append(frozenset(str(label).strip().lower() for label in row.get("labels") or []))
    return Database(tuple(tables), tuple(labels))


def _table(row: dict[str, Any], where: str) -> MaterialTable:
    curves = [_curve(row, key, where) for key in _CURVES]
    frequency = np.unique(np.concatenate([f for f, _ in curves]))
    absorption, scattering, transmission = (_at(frequency, *curve)[None] for curve in curves)
    return MaterialTable(
        (row["name"],), frequency, absorption, scattering, limit(absorption, transmission)
    )


def _curve(row: dict[str, Any], key: str, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and values of a curve; one that is missing has the default's. Values beyond [0, 1], as
    reverberation chambers give them for absorption, are brought back into it."""
    if key not in row:
        return DEFAULT.frequency_hz, getattr(DEFAULT, key)[0]
    try:
        pairs = np.array(row[key], float).reshape(-1, 2)
    except (TypeError, ValueError):
        pairs = np.empty((0, 2))
    if len(pairs) == 0 or not np.isfinite(pairs).all() or (pairs[:, 0] <= 0.0).any():
        raise RlrError(f"{where}: {key} needs pairs [frequency in Hz, value, ...], got {row[key]!r}")
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    _, first = np.unique(pairs[:, 0], return_index=True)
    return pairs[first, 0], np.clip(pairs[first, 1], 0.0, 1.0)


def _at(frequency: np.ndarray, given: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values linear in log frequency between given ones, flat beyond."""
    return np.interp(np.log(frequency), np.log(given), values)


def concatenate_tables(tables: list[MaterialTable]) -> MaterialTable:
    """One table of several of one row each, in their order, under numbered names."""
    named = [
        MaterialTable((f"{i}",), t.frequency_hz, t.absorption, t.scattering, t.transmission)
        for i, t in enumerate(tables)
    ]
    table = reduce(lambda rest, top: overlay(rest, top), reversed(named))
    order = [table.index(f"{i}") for i in range(len(tables))]
    return MaterialTable(
        tuple(f"{i} {t.names[0]}" for i, t in enumerate(tables)),
        table.frequency_hz,
        *(getattr(table, curve)[order] for curve in _CURVES),
    )
