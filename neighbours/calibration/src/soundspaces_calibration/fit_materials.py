"""Absorption that fits measured room measures: the most probable one, by the counts of reflections of echograms.

With u = ln(a / (1 - a)), a = absorption / (1 - transmission), per group of materials and band, the sum of squares

    Σ ((measured - model(u)) / σ)² + Σ ((u - u_0) / s)²

is least where u is most probable, if errors are normal and u about the table's u_0 is, with spreads s. The spread
of u is that of its linear model there (Laplace). Derivatives are those of the closure (`material_spread`); SciPy's
least_squares does the algebra.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from soundspaces_sim import Echogram, MaterialError, refurnished
from soundspaces_sim.echogram import room_measures
from soundspaces_sim.parts import (
    MOST_DB,
    MaterialGroups,
    absorption_shares as shares,
    closure_error_db,
    logit_reproducibility,
    logits,
    measure_jacobian,
    variety,
)

_UNDETERMINED = 0.9  # of the prior's spread, from which on a measurement has told nothing


@dataclass(frozen=True)
class MaterialFit:
    """M groups of materials, b bands. `spread`: one standard deviation of `absorption`; `prior_spread`: before
    anything was measured, and `prior_logit` that of ln(a / (1 - a)); `undetermined`: where it is nearly as large,
    so that the table's value has stayed. `misfit`, `misfit_before`: root mean squares of measured minus modelled
    values over their standard errors, with the fitted absorption and the table's. `within`: whether counts of
    reflections reach that far; else simulate anew with this absorption, and fit again."""

    names: tuple[str, ...]
    absorption: np.ndarray  # (M, b)
    spread: np.ndarray  # (M, b)
    prior_spread: np.ndarray  # (M, b)
    prior_logit: np.ndarray  # (M, b)
    misfit: float
    misfit_before: float
    within: bool

    @property
    def undetermined(self) -> np.ndarray:
        """(M, b)"""
        return np.asarray(self.spread > _UNDETERMINED * self.prior_spread)


def fit_materials(
    echograms: Sequence[Echogram],
    measured: np.ndarray,
    error: np.ndarray,
    names: Sequence[str] = ("t30", "edt", "c80", "d50"),
    prior: np.ndarray | None = None,
    about: np.ndarray | None = None,
) -> MaterialFit:
    """The absorption of the counted materials that fits measured values of pairs.

    `echograms`: of n pairs, with counts of reflections of the same materials; `measured` (n, measures, b) of room
    measures `names`, NaN where there is none; `error`, alike, their standard errors, with those of the simulation;
    `prior` (M, b) spreads of u, by default of kinds of products and laboratories together
    (materials/spreads.toml), about the absorption `about` (M, b), by default that of the simulation. Raises
    `MaterialError`.
    """
    groups = _groups_of(echograms)
    bands = echograms[0].bands
    shape = (len(echograms), len(names), len(bands) - 1)
    measured, error = np.asarray(measured, float), np.asarray(error, float)
    known = np.isfinite(measured)
    if measured.shape != shape or error.shape != shape or not (error[known] > 0.0).all():
        raise MaterialError(
            f"fit of materials: expected values and standard errors above 0 of shape {shape} (pairs, measures, "
            f"bands), got {measured.shape} and {error.shape}"
        )
    if not known.any():
        raise MaterialError("fit of materials: no value is finite")
    rest = 1.0 - groups.transmission
    about = groups.absorption if about is None else about
    start = logits(about / rest)
    if prior is None:
        between = logit_reproducibility(about, groups.transmission, bands)
        prior = np.hypot(variety(groups.names)[:, None], between)
    if prior.shape != start.shape or not (prior > 0.0).all():
        raise MaterialError(f"fit of materials: prior needs spreads above 0 of shape {start.shape}")
    problem = _Problem(echograms, measured, error, tuple(names), known, rest, start, prior)
    before = problem.residuals(start.ravel())
    if not np.isfinite(before).all():
        raise MaterialError(
            "fit of materials: some measured value has none in the simulation, whose decay is too short; simulate "
            "a longer duration, or leave it out (NaN)"
        )
    found = least_squares(problem.residuals, start.ravel(), problem.jacobian, xtol=1e-6, ftol=1e-8)
    share = shares(found.x.reshape(start.shape))
    jacobian = np.asarray(found.jac)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    deviation = np.sqrt(np.diag(covariance)).reshape(start.shape)
    by_logit = rest * share * (1.0 - share)
    data = slice(int(known.sum()))
    return MaterialFit(
        groups.names,
        rest * share,
        by_logit * deviation,
        by_logit * prior,
        prior,
        float(np.sqrt(np.mean(found.fun[data] ** 2))),
        float(np.sqrt(np.mean(before[data] ** 2))),
        all(closure_error_db(echogram, rest * share) <= MOST_DB for echogram in echograms),
    )


def _groups_of(echograms: Sequence[Echogram]) -> MaterialGroups:
    """The groups that all echograms have. Raises `MaterialError`."""
    found = [echogram.counts.groups for echogram in echograms if echogram.counts is not None]
    if not found or len(found) < len(echograms):
        raise MaterialError(
            "fit of materials: expected one or more echograms with counts of reflections; simulate them with "
            "`[simulation.materials] enabled = true`"
        )
    first = found[0]
    for other in found[1:]:
        same = other.names == first.names and np.array_equal(other.absorption, first.absorption)
        if not same:
            raise MaterialError(
                "fit of materials: expected echograms of one simulation, got several tables"
            )
    return first


@dataclass(frozen=True)
class _Problem:
    """Residuals by u (M b,), the measured ones first, and their derivatives."""

    echograms: Sequence[Echogram]
    measured: np.ndarray
    error: np.ndarray
    names: tuple[str, ...]
    known: np.ndarray
    rest: np.ndarray
    start: np.ndarray
    prior: np.ndarray

    def residuals(self, u: np.ndarray) -> np.ndarray:
        u = u.reshape(self.start.shape)
        modelled = np.empty_like(self.measured)
        for k, echogram in enumerate(self.echograms):
            found = room_measures(refurnished(echogram, self.rest * shares(u), force=True))
            modelled[k] = [getattr(found, name) for name in self.names]
        off = ((modelled - self.measured) / self.error)[self.known]
        return np.concatenate([off, ((u - self.start) / self.prior).ravel()])

    def jacobian(self, u: np.ndarray) -> np.ndarray:
        share = shares(u.reshape(self.start.shape))
        by_logit = self.rest * share * (1.0 - share)
        groups, bands = share.shape
        own = np.arange(bands)
        whole = np.zeros((*self.measured.shape, groups, bands))
        for k, echogram in enumerate(self.echograms):
            found = measure_jacobian(echogram, self.names, self.rest * share) * by_logit
            whole[k][:, own, :, own] = np.moveaxis(found, 2, 0)  # no band depends on another
        whole /= self.error[..., None, None]
        data = whole[self.known].reshape(-1, groups * bands)
        return np.concatenate([data, np.diag(1.0 / self.prior.ravel())])
