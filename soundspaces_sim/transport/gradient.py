"""Derivatives of a loss by the absorption of every material, for the very walks (docs/theory.md, section 11).

A path that material m reflects n_m times carries ρ_m^n_m, ρ = 1 - α - τ, so dE/dα_m of a bin is -n̄_m E / ρ_m: mean
counts of the walks, one for each bin. Radiance transfer, which counts in wide steps, has the derivative of its
products (`radiance_transfer.derivative`). No path is traced anew, and what is drawn does not move with α. The
ratios by which arrivals that come together are scaled (`diffraction.coherence`) are taken for constants.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.memory import check_memory
from soundspaces_sim.core.simulation_config import MaterialsConfig, SimulationConfig
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.integrator import connect_all, run_techniques, traced
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.radiance_transfer.derivative import weighted_derivatives
from soundspaces_sim.transport.radiance_transfer.technique import RADIANCE_TRANSFER
from soundspaces_sim.transport.reflection_counts.of_tile import counts_of, moments_of
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
    config = config or SimulationConfig()
    _check_config(config)
    counted = MaterialsConfig(enabled=True, groups=_GROUPS)
    config = msgspec.structs.replace(config, materials=counted, denoise=False)
    return gradient_of(bin_by_bin(model_between(scene, a, b, config, seed)), a, b, weights)


def _check_config(config: SimulationConfig) -> None:
    """Raise `ConfigError` for what has no exact derivative."""
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
    apart = [t for t in techniques if t is RADIANCE_TRANSFER and model.world.settings.radiance_transfer]
    tile = run_techniques(
        model, a, b, both_ways=False, techniques=[t for t in techniques if t not in apart]
    )
    moments = moments_of(tile)
    assert moments is not None
    counted, counts = tile.to_b[:, :, :, 0].astype(float), counts_of(model, moments)
    connect_all(tile, apart)
    echoes = traced(model, tile, a, b, both_ways=False).forward
    given = weights(echoes) if callable(weights) else weights
    weight, expected = np.asarray(given, float), (*echoes.shape, bins, bands)
    if weight.shape != expected or not np.isfinite(weight).all():
        raise ConfigError(
            f"gradient: weights must be finite numbers of shape {expected} (sources, listeners, bins, bands), got "
            f"shape {weight.shape}"
        )
    groups = counts.groups
    by_log = np.einsum("sltb,sltmb->mb", weight * counted, counts.mean.astype(float))
    by_log += _of_arrivals(echoes, weight, len(groups.names))
    if apart:
        by_log += weighted_derivatives(tile, weight)
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
