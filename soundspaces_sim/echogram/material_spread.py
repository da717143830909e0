"""What measures of an echogram owe to how well absorption is known: GUM's law of propagation, to first order.

Derivatives are differences of the closure (theory, section 11) by ln ρ of each group of materials, all bands at
once, as no band depends on another.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from soundspaces_sim import echogram as with_numba  # loads what needs Numba when it is asked for it
from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.echogram.absorption_spread import reproducibility
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.echogram.refurnish import refurnished

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
