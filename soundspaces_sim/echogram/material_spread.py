"""What measures of an echogram owe to how well absorption is known: GUM's law of propagation, to first order.

Derivatives are differences of the closure (theory, section 11) by ln ρ of each group of materials, all bands at
once, as no band depends on another.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from soundspaces_sim import echogram as with_numba  # loads what needs Numba when it is asked for it
from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.core.io.untrusted import read_toml
from soundspaces_sim.core.numerics.bands import band_means
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.echogram.refurnish import refurnished

# How well absorption is known: between laboratories, and between products of a kind (materials/spreads.toml).

_ENDS = 0.002, 0.998  # of absorption in logarithms: a printed 0 or 1 is rounded


def reproducibility(absorption: np.ndarray, bands: Sequence[float]) -> np.ndarray:
    """(…, b) standard deviations of `absorption` (…, b) between laboratories that measure the same product after
    ISO 354 (ISO 12999-2:2020); of all thirds of a band together, as if their errors were one."""
    given = _file("spreads.toml")["reproducibility"]
    frequency = np.array(given["frequency_hz"], float)
    slope, offset = (
        band_means(frequency, np.array(given[name], float), bands) for name in ("slope", "offset")
    )
    return np.asarray(slope * np.asarray(absorption, float) + offset)


def logit_reproducibility(
    absorption: np.ndarray, transmission: np.ndarray, bands: Sequence[float]
) -> np.ndarray:
    """(…, b) the same of ln(a / (1 - a)), a = absorption / (1 - transmission)."""
    rest = 1.0 - np.asarray(transmission, float)
    inside = shares(logits(absorption / rest))
    return np.asarray(reproducibility(absorption, bands) / (rest * inside * (1.0 - inside)))


def variety(names: Sequence[str]) -> np.ndarray:
    """(m,) standard deviations of ln(a / (1 - a)) between products of each material's kind."""
    kinds = _varieties()
    pooled = float(np.sqrt(np.mean([spread**2 for spread, _ in kinds.values()])))
    of_name = {name: spread for spread, members in kinds.values() for name in members}
    return np.array([of_name.get(name, pooled) for name in names])


def logits(share: np.ndarray) -> np.ndarray:
    """ln(a / (1 - a)) of shares from 0 to 1, of which the ends are taken as rounded."""
    inside = np.clip(share, *_ENDS)
    return np.asarray(np.log(inside / (1.0 - inside)))


def shares(logit: np.ndarray) -> np.ndarray:
    """The inverse of `logits`, between its ends."""
    return np.asarray(np.exp(-np.logaddexp(0.0, -logit)))


@cache
def _varieties() -> dict[str, tuple[float, tuple[str, ...]]]:
    """By kind, spread and members."""
    rows = _file("materials.toml")["materials"]
    out = {}
    for kind, members in _file("spreads.toml")["kinds"].items():
        values = logits(np.array([rows[name]["absorption"] for name in members], float))
        out[kind] = (float(np.sqrt(values.var(axis=0, ddof=1).mean())), tuple(members))
    return out


@cache
def _file(name: str) -> dict[str, Any]:
    return read_toml(resource("materials", name), MaterialError, "file")


_STEP = 0.005  # of ln ρ: differences are right to its square times (n̄)², and far above what bins round


def measure_jacobian(
    echogram: Echogram, names: Sequence[str] = MEASURES, at: np.ndarray | None = None
) -> np.ndarray:
    """(measures, M, b) derivatives of room measures by the absorption of each group of counted materials; NaN where
    a measure is. `at`: absorption (M, b) at which, by default that of the simulation. Raises `MaterialError`
    without counts."""
    if echogram.counts is None:
        raise MaterialError(
            "spread of measures: the echogram has no counts of reflections; simulate it with "
            "`[simulation.materials] enabled = true`"
        )
    groups = echogram.counts.groups
    at = groups.absorption if at is None else at
    left = 1.0 - at - groups.transmission
    out = np.empty((len(names), *at.shape))
    for m in range(len(groups.names)):
        ends = []
        for sign in (1.0, -1.0):
            absorption = at.copy()
            absorption[m] += left[m] * -np.expm1(sign * _STEP)
            found = with_numba.room_measures(refurnished(echogram, absorption, force=True))
            ends.append(np.array([getattr(found, name) for name in names]))
        out[:, m] = -(ends[0] - ends[1]) / (2.0 * _STEP * left[m])
    return out


def measure_spread(
    echogram: Echogram, absorption_spread: np.ndarray | None = None, names: Sequence[str] = MEASURES
) -> np.ndarray:
    """(measures, b) standard deviations of room measures that come of those of absorption (M, b), independent
    between materials; by default of laboratories (`absorption_spread.reproducibility`)."""
    jacobian = measure_jacobian(echogram, names)
    assert echogram.counts is not None  # checked
    if absorption_spread is None:
        absorption_spread = reproducibility(echogram.counts.groups.absorption, echogram.bands)
    if absorption_spread.shape != jacobian.shape[1:] or not (absorption_spread >= 0.0).all():
        raise MaterialError(
            f"spread of absorption: expected {jacobian.shape[1:]} numbers, none negative (groups, bands), got "
            f"shape {absorption_spread.shape}"
        )
    return np.asarray(np.sqrt(((jacobian * absorption_spread) ** 2).sum(axis=1)))
