"""Random furniture: other plausible absorption of the counted materials, drawn for every response that is read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from soundspaces_sim import ConfigError, Echogram, MaterialError, refurnished
from soundspaces_sim.parts import (
    MOST_DB,
    MaterialGroups,
    absorption_shares as shares,
    closure_error_db,
    logit_reproducibility,
    logits,
    variety,
)

_STEPS = 6  # bisections of how far a draw may go


@dataclass(frozen=True)
class RandomMaterials:
    """Absorption as other products of the same kinds have it.

    With a the absorbed share of what a material does not transmit, ln(a / (1 - a)) is drawn from a normal
    distribution about the simulated one. Its spread has two parts: between products of the material's kind, one
    number for all bands; and between laboratories that measure one product (ISO 12999-2), one for each band, both
    of materials/spreads.toml. `scale`: times these spreads. `names`: the materials that change, by default all that
    were counted. A draw that goes beyond what counts of reflections can tell (`ds.materials`) is moved back towards
    the simulation until the stated error is 0.5 dB, for each pair. Raises `ConfigError`.
    """

    scale: float = 1.0
    names: Sequence[str] | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale >= 0.0):
            raise ConfigError(
                f"RandomMaterials: scale must be a finite number from 0 on, got {self.scale!r}"
            )
        if isinstance(self.names, str):
            raise ConfigError(f"RandomMaterials: names must be a list of names, got {self.names!r}")

    def check(self, groups: MaterialGroups) -> None:
        """Raise `MaterialError` for names that were not counted."""
        for name in self.names or ():
            if name not in groups.names:
                raise MaterialError(
                    f"RandomMaterials: reflections by '{name}' were not counted, only those by "
                    f"{', '.join(groups.names)}"
                )

    def draw(
        self, groups: MaterialGroups, bands: Sequence[float], rng: np.random.Generator
    ) -> np.ndarray:
        """(M, b) absorption of the groups."""
        rest = 1.0 - groups.transmission
        share = groups.absorption / rest
        between = logit_reproducibility(groups.absorption, groups.transmission, bands)
        of_kind, of_band = rng.standard_normal((len(share), 1)), rng.standard_normal(share.shape)
        moved = variety(groups.names)[:, None] * of_kind + between * of_band
        drawn = shares(logits(share) + self.scale * moved) * rest
        chosen = np.isin(groups.names, self.names or groups.names)[:, None] & (self.scale > 0.0)
        return np.where(chosen, drawn, groups.absorption)


def draw_furnished(
    echogram: Echogram, materials: RandomMaterials, rng: np.random.Generator
) -> tuple[Echogram, np.ndarray]:
    """An echogram that has counts of reflections with `materials` that `rng` draws, and their absorption (M, b).
    Raises `MaterialError`."""
    assert echogram.counts is not None
    groups = echogram.counts.groups
    materials.check(groups)
    now, drawn = groups.absorption, materials.draw(groups, echogram.bands, rng)
    low, high = 0.0, 1.0
    if closure_error_db(echogram, drawn) <= MOST_DB:
        low = 1.0
    else:
        for _ in range(_STEPS):
            half = 0.5 * (low + high)
            within = closure_error_db(echogram, now + half * (drawn - now)) <= MOST_DB
            low, high = (half, high) if within else (low, half)
    absorption = now + low * (drawn - now)
    return refurnished(echogram, absorption), absorption
