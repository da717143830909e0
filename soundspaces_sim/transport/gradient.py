"""Derivatives of a loss by the absorption of every material, for the very walks (docs/theory.md, section 11).

A path that material m reflects n_m times carries ρ_m^n_m, ρ = 1 - α - τ, so dE/dα_m of a bin is -n̄_m E / ρ_m: mean
counts of the walks, one for each bin. No path is traced anew, and what is drawn does not move with α. The ratios by
which arrivals that come together are scaled (`diffraction.coherence`) are taken for constants.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.memory import check_memory
from soundspaces_sim.core.simulation_config import (
    MaterialsConfig,
    RadianceTransferConfig,
    SimulationConfig,
)
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.integrator import trace_tile
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.simulate import as_points, model_between
from soundspaces_sim.transport.technique import Technique
from soundspaces_sim.transport.techniques import TECHNIQUES
from soundspaces_sim.transport.tile import batch_rows

_GROUPS = 12
Weights = ArrayLike | Callable[[Echograms], ArrayLike]


@dataclass(frozen=True)
class Gradient:
    """Derivatives of a loss: `absorption` (M, b), by that of the material `names` (M,), in every band; `echograms`
    are those at which they are taken, not smoothed."""

    names: tuple[str, ...]
    absorption: np.ndarray
    echograms: Echograms


def gradient(
    scene: Scene,
    sources: ArrayLike,
    listeners: ArrayLike,
    weights: Weights,
    config: SimulationConfig | None = None,
    seed: int = 0,
) -> Gradient:
    """As `soundspaces_sim.gradient`, of a `Scene`."""
    a, b = as_points(sources, "sources"), as_points(listeners, "listeners")
    config = config or SimulationConfig(radiance_transfer=RadianceTransferConfig(enabled=False))
    _check_config(config)
    counted = MaterialsConfig(enabled=True, groups=_GROUPS)
    config = msgspec.structs.replace(config, materials=counted, denoise=False)
    return gradient_of(bin_by_bin(model_between(scene, a, b, config, seed)), a, b, weights)


def _check_config(config: SimulationConfig) -> None:
    """Raise `ConfigError` for what has no exact derivative."""
    if config.radiance_transfer.enabled:
        raise ConfigError(
            "gradient: radiance transfer counts reflections in wide steps, which is no exact derivative; set "
            "simulation.radiance_transfer = {enabled = false}, and other techniques make its paths"
        )
    if config.target_error is not None:
        raise ConfigError(
            "gradient: expected no simulation.target_error, whose rounds depend on the result"
        )


def bin_by_bin(model: Model) -> Model:
    """The model with counts in every bin. Raises `ConfigError` for materials whose law depends on the angle."""
    surfaces = model.world.surfaces
    of_angle = (surfaces.law != 0) & (surfaces.group >= 0)
    if of_angle.any():
        name = model.prepared.groups.names[surfaces.group[of_angle.argmax()]]
        raise ConfigError(
            f"gradient: '{name}' reflects by a law of angles, for which counts are no exact derivative; expected "
            "simulation.reflection = random, and no other law in its materials"
        )
    bins = np.arange(len(model.time_edges) - 1)
    return replace(model, world=model.world._replace(window_of_bin=bins))


def gradient_of(
    model: Model,
    a: np.ndarray,
    b: np.ndarray,
    weights: Weights,
    techniques: Sequence[Technique] = TECHNIQUES,
) -> Gradient:
    """The gradient of a model of `bin_by_bin`, between (S, 3) sources and (L, 3) listeners."""
    bands, bins = model.world.air.shape[1], len(model.time_edges) - 1
    check_memory(8.0 * len(a) * len(b) * 2 * batch_rows(model) * bins * bands, "counts in every bin")
    echoes = trace_tile(model, a, b, both_ways=False, techniques=techniques).forward
    given = weights(echoes) if callable(weights) else weights
    weight, expected = np.asarray(given, float), (*echoes.shape, bins, bands)
    if weight.shape != expected or not np.isfinite(weight).all():
        raise ConfigError(
            f"gradient: weights must be finite numbers of shape {expected} (sources, listeners, bins, bands), got "
            f"shape {weight.shape}"
        )
    assert echoes.counts is not None
    groups = echoes.counts.groups
    energy = weight * echoes.energy[:, :, :, 0]
    by_log = np.einsum("sltb,sltmb->mb", energy, echoes.counts.mean.astype(float))
    by_log += _of_arrivals(echoes, weight, len(groups.names))
    return Gradient(groups.names, -by_log / (1.0 - groups.absorption - groups.transmission), echoes)


def _of_arrivals(echoes: Echograms, weight: np.ndarray, groups: int) -> np.ndarray:
    """(M, b) weighted energy of discrete arrivals, in the bins in which they come, times their counts."""
    early = echoes.early
    pair = np.repeat(np.arange(len(echoes)), np.diff(echoes.early_start))
    time = np.searchsorted(echoes.time_edges, early.delay, "right") - 1
    inside = time < weight.shape[2]
    of_pair = weight.reshape(len(echoes), *weight.shape[2:])
    weighted = np.zeros_like(early.energy)
    weighted[inside] = early.energy[inside] * of_pair[pair[inside], time[inside]]
    counts = np.stack([(early.groups == m).sum(axis=1) for m in range(groups)])
    return np.asarray(counts @ weighted)
