"""Open-plan offices (ISO 3382-3:2022): how speech falls off along a line of workstations.

Levels L of speech at distances r from a source are fitted with L = a + b lg(r / 1 m). D_2,S = -b lg 2 is the
decay per doubling of distance, L_p,A,S,4m = a + b lg 4 the level at 4 m, r_C = 10^((45 dB - a) / b) m the
comfort distance. The speech transmission index is fitted with STI = a + b r; r_D is where it falls to 0.50, r_P
to 0.20.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soundspaces_sim import ConfigError

_RANGE_M = (2.0, 16.0)  # distances that take part
_LEAST = 4  # positions
_COMFORT_DB, _DISTRACTION, _PRIVACY = 45.0, 0.50, 0.20


class Estimate(NamedTuple):
    """A value and its standard error, of the fit and of the levels. NaN: does not exist."""

    value: float
    error: float


class OfficeParameters(NamedTuple):
    """Single numbers of ISO 3382-3 and what they were fitted to: `distance` (n,) m, `level` (n,) dB, A-weighted
    speech, `sti` (n,), of the positions within 2 to 16 m."""

    d2s: Estimate  # dB
    lpas4m: Estimate  # dB
    comfort_distance: Estimate  # m
    distraction_distance: Estimate  # m
    privacy_distance: Estimate  # m
    distance: np.ndarray
    level: np.ndarray
    sti: np.ndarray


class _Line(NamedTuple):
    offset: float
    slope: float
    covariance: np.ndarray  # (2, 2)

    def at(self, x: float) -> Estimate:
        g = np.array([1.0, x])
        return Estimate(self.offset + self.slope * x, float(np.sqrt(g @ self.covariance @ g)))

    def reaches(self, y: float) -> Estimate:
        """x of a value; NaN unless the line falls."""
        if not self.slope < 0.0:
            return Estimate(float("nan"), float("nan"))
        x = (y - self.offset) / self.slope
        g = np.array([1.0, x]) / self.slope
        return Estimate(float(x), float(np.sqrt(g @ self.covariance @ g)))


def _fit(x: np.ndarray, y: np.ndarray, error: np.ndarray) -> _Line:
    """Least squares of y = a + b x. Errors: of the scatter about the line, and of `y` themselves."""
    design = np.stack([np.ones_like(x), x], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    solve = inverse @ design.T
    found = solve @ y
    scatter = float(((y - design @ found) ** 2).sum() / (len(x) - 2))
    own = solve @ np.diag(np.nan_to_num(error) ** 2) @ solve.T
    return _Line(float(found[0]), float(found[1]), scatter * inverse + own)


def office_parameters(
    distance: Sequence[float] | np.ndarray,
    level: np.ndarray,
    sti: np.ndarray,
    level_error: np.ndarray,
    sti_error: np.ndarray,
) -> OfficeParameters:
    """From (n,) distances in m, A-weighted speech levels in dB and STI at them, with standard errors. Raises
    `ConfigError` unless four distances lie within 2 to 16 m and differ."""
    r = np.asarray(distance, float)
    use = (r >= _RANGE_M[0]) & (r <= _RANGE_M[1]) & np.isfinite(level)
    if use.sum() < _LEAST or not np.ptp(r[use]) > 0.0:
        raise ConfigError(
            f"listeners: expected at least {_LEAST} at different distances within {_RANGE_M[0]:g} to "
            f"{_RANGE_M[1]:g} m of the source, where speech arrives (ISO 3382-3), got {int(use.sum())}"
        )
    r, level, sti = r[use], np.asarray(level)[use], np.asarray(sti)[use]
    line = _fit(np.log10(r), level, np.asarray(level_error)[use])
    at_4_m, comfort = line.at(np.log10(4.0)), line.reaches(_COMFORT_DB)
    scale = np.log10(2.0)
    metres = 10.0**comfort.value
    missing = Estimate(float("nan"), float("nan"))
    speech = _fit(r, sti, np.asarray(sti_error)[use]) if np.isfinite(sti).all() else None
    return OfficeParameters(
        Estimate(-line.slope * scale, float(np.sqrt(line.covariance[1, 1])) * scale),
        at_4_m,
        Estimate(metres, comfort.error * metres * np.log(10.0)),
        missing if speech is None else speech.reaches(_DISTRACTION),
        missing if speech is None else speech.reaches(_PRIVACY),
        r,
        level,
        sti,
    )
