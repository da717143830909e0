"""Other materials on reading: what of a dataset can be changed, how far, and its echograms and table with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from soundspaces_sim import echogram
from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.shard import FAILED
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.echogram.reflection_counts import MaterialGroups
from soundspaces_sim.echogram.refurnish import (
    MOST_DB,
    Materials,
    closure_error_db,
    refurnished,
    walk_factors,
)

_STEPS = 7  # bisections of a range


@dataclass(frozen=True)
class ChangeableMaterial:
    """A material whose absorption can be chosen on reading, all else being as it was. Arrays (bands,)."""

    name: str
    share: float  # of all reflections of diffuse sound in the scene
    absorption: np.ndarray  # in the simulation
    # absorption down to which the closure's error stays within bounds, all bands together
    lowest: np.ndarray
    highest: np.ndarray

    def __repr__(self) -> str:
        spans = (
            f"{a:.2f} ({low:.2f}–{high:.2f})"
            for a, low, high in zip(self.absorption, self.lowest, self.highest, strict=True)
        )
        return f"{self.name}: {100.0 * self.share:.0f} % of reflections, absorption {', '.join(spans)}"


class ChangeableMaterials(tuple[ChangeableMaterial, ...]):
    """Those of a dataset, the most frequent first; by number or by name."""

    def __repr__(self) -> str:
        return "\n".join(map(repr, self)) or "no materials were counted"

    def named(self, name: str) -> ChangeableMaterial:
        """The one of this name. Raises `MaterialError`."""
        for material in self:
            if material.name == name:
                return material
        raise MaterialError(f"no counts of '{name}'; there are: {', '.join(m.name for m in self)}")


def changeable(groups: MaterialGroups, echograms: list[Echogram]) -> ChangeableMaterials:
    """The materials of a dataset, with ranges in which the closure is within bounds for all of some echograms."""
    found = []
    for m, name in enumerate(groups.names):
        now, most = groups.absorption[m], 1.0 - groups.transmission[m]
        ends = []
        for end in (np.zeros_like(now), now + 0.999 * (most - now)):
            low, high = 0.0, 1.0
            if _within(groups, echograms, m, end):
                low = 1.0
            else:
                for _ in range(_STEPS):
                    half = 0.5 * (low + high)
                    there = _within(groups, echograms, m, now + half * (end - now))
                    low, high = (half, high) if there else (low, half)
            ends.append(now + low * (end - now))
        found.append(ChangeableMaterial(name, float(groups.share[m]), now, *ends))
    return ChangeableMaterials(found)


def _within(groups: MaterialGroups, echograms: list[Echogram], m: int, absorption: np.ndarray) -> bool:
    changed = groups.absorption.copy()
    changed[m] = absorption
    return all(closure_error_db(echogram, changed) <= MOST_DB for echogram in echograms)


@dataclass(frozen=True)
class Furnishing:
    """Materials that were asked for, in every echogram that is read; `force`: beyond the range, too."""

    materials: Materials
    force: bool
    command: str  # that simulates the dataset

    def echogram(self, shard: EchogramShard, s: int, l: int) -> Echogram:
        """That of local source `s` and listener `l`. Raises `MaterialError`."""
        what = f"{shard.where}, pair ({s}, {l})"
        try:
            return refurnished(shard.echogram(s, l, counts=True), self.materials, self.force, what)
        except MaterialError as error:
            again = f"; the dataset was made by `{self.command}`" if self.command else ""
            raise MaterialError(f"{error}{again}") from None

    def columns(self, shard: EchogramShard) -> Mapping[str, np.ndarray]:
        """Datasets of a shard that depend on materials, computed: measures and errors of all pairs."""
        shape, bands = shard.pairs["status"].shape, len(shard.bands) - 1
        out = {name: np.full((*shape, bands), np.nan, np.float32) for name in MEASURES}
        out["relative_error"] = np.array(shard.pairs["relative_error"], np.float32)
        stored = shard.pairs.get("measure_error", np.full((*shape, len(MEASURES), bands), np.nan))
        out["measure_error"] = np.array(stored, np.float32)
        for s, l in _pairs(shard):
            plain = shard.echogram(s, l, counts=True)
            here, off = (refurnished(plain, self.materials, self.force, off=off) for off in (0.0, 1.0))
            found, moved = echogram.room_measures(here), echogram.room_measures(off)
            walks = walk_factors(plain, self.materials).max(axis=0) * out["measure_error"][s, l]
            for k, name in enumerate(MEASURES):
                values = getattr(found, name)
                out[name][s, l] = values
                closure = np.nan_to_num(np.abs(getattr(moved, name) - values))
                out["measure_error"][s, l, k] = np.hypot(walks[k], closure)
            out["relative_error"][s, l] = here.relative_error
        echogram.drop_uncertain(out, out["measure_error"])
        return out


def with_spreads(
    rows: np.ndarray, bands: int, spread: Callable[[int, int], Mapping[str, np.ndarray]]
) -> np.ndarray:
    """A table of pairs with columns ``t30_spread_0`` … behind: what `spread` of source and listener tells of every
    measure."""
    names = [f"{name}_spread_{b}" for name in MEASURES for b in range(bands)]
    out = np.empty(len(rows), np.dtype([*rows.dtype.descr, *((name, "f4") for name in names)]))
    for name in rows.dtype.names or ():
        out[name] = rows[name]
    for row in out:
        found = spread(int(row["source"]), int(row["listener"]))
        for name, values in found.items():
            for b in range(bands):
                row[f"{name}_spread_{b}"] = values[b]
    return out


def spread_metadata(columns: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """What the columns of `with_spreads` mean, from what those of measures do."""
    text = "standard deviation that comes of what laboratories differ by that measure absorption (ISO 12999-2)"
    out = {}
    for column, entry in columns.items():
        name, _, band = column.rpartition("_")
        if name in MEASURES:
            out[f"{name}_spread_{band}"] = {
                **entry,
                "description": f"of {name}: {text}; NaN: the measure is",
            }
    return out


def _pairs(shard: EchogramShard) -> Iterator[tuple[int, int]]:
    return ((int(s), int(l)) for s, l in np.argwhere(shard.pairs["status"] != FAILED))
