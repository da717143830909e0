"""Derivatives of a loss by absorption and scattering of every material, for the very walks (docs/theory.md, section
11).

A path that material m reflects n_m times carries ρ_m^n_m, ρ = 1 - α - τ, so dE/dα_m of a bin is -n̄_m E / ρ_m: mean
counts of the walks, one for each bin. It carries s_m of each of these reflections that scatters it and 1 - s_m of
each that mirrors it. The derivative of its logarithm, its score, is the sum of 1 / s_m and -1 / (1 - s_m).
Radiance transfer, which counts in wide steps, has the derivative of its products (`radiance_transfer.derivative`).
No path is traced anew, and what is drawn does not move with α and s.

With edges the derivative of a discrete arrival is not exact: it takes diffracted waves that have joined the arrival
to have its reflections, and what a face takes of a wave by its edge not to change. Without diffraction it is exact.
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
from soundspaces_sim.transport.bsdf.scores import score_count
from soundspaces_sim.transport.bsdf.surface import non_lambertian
from soundspaces_sim.transport.integrator import join_walks, run_techniques, traced
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.radiance_transfer.derivative import weighted_derivatives
from soundspaces_sim.transport.radiance_transfer.technique import RADIANCE_TRANSFER
from soundspaces_sim.transport.reflection_counts.of_tile import counts_of, moments_of
from soundspaces_sim.transport.scene_surfaces import with_scattering_scores
from soundspaces_sim.transport.simulate import as_points, model_between
from soundspaces_sim.transport.tables import BATCHES
from soundspaces_sim.transport.technique import Technique
from soundspaces_sim.transport.techniques import TECHNIQUES
from soundspaces_sim.transport.tile import Sums, batch_rows

_GROUPS = 12
Weights = ArrayLike | Callable[[Echograms], ArrayLike]


@dataclass(frozen=True)
class Gradient:
    """Derivatives of a loss: `absorption` (M, b) and `scattering` (M, b), by those of the materials `names` (M,),
    in every band; `echograms` are those at which they are taken, not smoothed.

    `scattering` is None unless it was asked for, and NaN where a material's is 0 or 1: paths of the other kind,
    which it would add, are not walked."""

    names: tuple[str, ...]
    absorption: np.ndarray
    echograms: Echograms
    scattering: np.ndarray | None = None


def gradient(
    scene: Scene,
    sources: ArrayLike,
    listeners: ArrayLike,
    weights: Weights,
    config: SimulationConfig | None = None,
    seed: int = 0,
    scattering: bool = False,
) -> Gradient:
    """As `soundspaces_sim.gradient`, of a `Scene`."""
    a, b = as_points(sources, "sources"), as_points(listeners, "listeners")
    config = config or SimulationConfig()
    _check_config(config)
    counted = MaterialsConfig(enabled=True, groups=_GROUPS)
    config = msgspec.structs.replace(config, materials=counted, denoise=False)
    model = bin_by_bin(model_between(scene, a, b, config, seed))
    return gradient_of(model, a, b, weights, scattering=scattering)


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
    scattering: bool = False,
) -> Gradient:
    """The gradient of a model of `bin_by_bin`, between (S, 3) sources and (L, 3) listeners."""
    unknown = None
    if scattering:
        model, unknown = _scored(model)
    bands, bins = model.world.air.shape[1], len(model.time_edges) - 1
    check_memory(8.0 * len(a) * len(b) * 2 * batch_rows(model) * bins * bands, "counts in every bin")
    apart = [t for t in techniques if t is RADIANCE_TRANSFER and model.world.settings.radiance_transfer]
    made = run_techniques(
        model, a, b, both_ways=False, techniques=[t for t in techniques if t not in apart]
    )
    sums = made.sums
    counted = sums.to_b[:, :, :, 0].astype(float)
    counts, scores = _counts(model, sums), _scores(model, sums)
    join_walks(made.tile, made.walks, sums, apart)
    echoes = traced(made, both_ways=False).forward
    given = weights(echoes) if callable(weights) else weights
    weight, expected = np.asarray(given, float), (*echoes.shape, bins, bands)
    if weight.shape != expected or not np.isfinite(weight).all():
        raise ConfigError(
            f"gradient: weights must be finite numbers of shape {expected} (sources, listeners, bins, bands), got "
            f"shape {weight.shape}"
        )
    groups = model.prepared.groups
    arrivals = _of_arrivals(model, made.arrived.paths, weight)
    by_log = np.einsum("sltb,sltmb->mb", weight * counted, counts) + arrivals
    by_scattering = np.einsum("sltb,sltmb->mb", weight * counted, scores)
    if apart:
        late = weighted_derivatives(made.tile, *made.walks, weight)
        for derivatives, more in zip((by_log, by_scattering), late, strict=True):
            derivatives += more
    by_absorption = -by_log / (1.0 - groups.absorption - groups.transmission)
    if unknown is None:
        return Gradient(groups.names, by_absorption, echoes)
    by_scattering -= arrivals * _per_mirroring(model)  # arrivals are mirrored
    return Gradient(groups.names, by_absorption, echoes, np.where(unknown, np.nan, by_scattering))


def _scored(model: Model) -> tuple[Model, np.ndarray]:
    """A model whose subpaths carry scores, and (M, b) where they are not known. Raises `ConfigError` for lobes of
    other shapes than Lambert's, of which connections know no scores."""
    surfaces = model.world.surfaces
    lobe = non_lambertian(surfaces, model.world.geometry.material)
    if lobe:
        raise ConfigError(
            f"gradient: scattering by lobe '{lobe}' has no derivative; expected none of it"
        )
    surfaces, unknown = with_scattering_scores(model.prepared)
    return replace(model, world=model.world._replace(surfaces=surfaces)), unknown


def _counts(model: Model, sums: Sums) -> np.ndarray:
    """(S, L, bins, M, b) mean counts of the reflections of paths."""
    moments = moments_of(model, sums)
    assert moments is not None
    return counts_of(model, moments).mean.astype(float)


def _scores(model: Model, sums: Sums) -> np.ndarray:
    """(S, L, bins, M or 0, b) mean scores of paths."""
    last = sums.batches.shape[2]
    whole = sums.batches[:, :, :BATCHES].sum(axis=2, dtype=float)[:, :, :, None]
    summed = np.moveaxis(sums.batches[:, :, last - score_count(model.world.surfaces) :], 2, 3)
    return np.divide(summed, whole, out=np.zeros(summed.shape), where=whole > 0.0)


def _per_mirroring(model: Model) -> np.ndarray:
    """(M, b) 1 / (1 - s), s the scattering of the table; 0 where nothing is mirrored."""
    table, names = model.scene.materials, model.prepared.groups.names
    scattering = table.in_bands(model.config.bands)[1][[table.names.index(name) for name in names]]
    return np.divide(1.0, 1.0 - scattering, out=np.zeros_like(scattering), where=scattering < 1.0)


def _of_arrivals(model: Model, found: PathTable, weight: np.ndarray) -> np.ndarray:
    """(M, b) weighted derivatives by ln ρ of discrete arrivals, in the bins in which they come."""
    time = np.searchsorted(model.time_edges, found.length / model.config.c, "right") - 1
    inside = time < weight.shape[2]
    by_log = np.zeros_like(found.energy)
    by_log[inside] = weight.reshape(-1, *weight.shape[2:])[found.pair[inside], time[inside]]
    by_log *= found.energy
    number = len(model.prepared.groups.names)
    counts = np.stack([(found.groups == m).sum(axis=1) for m in range(number)])
    return np.asarray(counts @ by_log)
