"""Smoothing of what has been traced: the last step before a tile's echograms are stored."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from soundspaces_sim.core.profile import stage
from soundspaces_sim.echogram.denoise import Noise, smooth_late
from soundspaces_sim.echogram.denoise_plan import make_denoise_plan
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.measure_errors import measure_values, widened
from soundspaces_sim.transport.model import EARLY_S, Model
from soundspaces_sim.transport.paths import detector
from soundspaces_sim.transport.reflection_counts.of_tile import CountMoments, counts_of
from soundspaces_sim.transport.reflection_counts.smoothed import smoothed_moments


@dataclass(frozen=True)
class Traced:
    """The raw result of a tile: echograms a -> b and, if wanted, b -> a; and `difference` (A, B, late bins, b),
    half of what late energies by the subpaths of a and of b differ by, of any sign; `error` (A, B, windows, b):
    standard errors of energies in windows of time, by batches; `moments` of counts of reflections, if they are
    wanted; `same`: whether a are the points b."""

    forward: Echograms
    backward: Echograms | None
    difference: np.ndarray
    error: np.ndarray
    moments: CountMoments | None
    same: bool


@stage("smoothing")
def smoothed(model: Model, traced: Traced) -> tuple[Echograms, Echograms | None]:
    """The echograms of a tile, with late bins smoothed in place if the config says so, errors widened by it, and
    counts of reflections."""
    forward, backward, config = traced.forward, traced.backward, model.config
    moments = traced.moments
    if config.denoise:
        values = measure_values(forward, traced.same)
        passage = 2.0 * detector.GROWTH.largest / config.c
        plan = make_denoise_plan(model.time_edges, config.connections.window, passage)
        early = forward.direct_length / config.c + EARLY_S
        splits = np.searchsorted(model.time_edges, early)
        noise = Noise(traced.difference, traced.error, model.world.window_of_bin)
        moved = smooth_late(forward.energy, noise, splits, plan, moments is not None)
        forward = widened(forward, values, traced.same)
        if backward is not None:
            back = Noise(*(x.transpose(1, 0, 2, 3) for x in noise[:2]), noise.window)
            smooth_late(backward.energy, back, splits.T, plan)
        if moments is not None and moved is not None:
            moments = smoothed_moments(model, moments, forward.energy[:, :, :, 0], moved, plan)
    if moments is not None:
        forward = replace(forward, counts=counts_of(model, moments))
    return forward, None if backward is None else with_errors_of(forward, backward)


def with_errors_of(forward: Echograms, backward: Echograms) -> Echograms:
    """The way back has the same energies, so the same errors of measures, and the same counts."""
    assert forward.measure_error is not None  # of all that is traced
    error = np.ascontiguousarray(forward.measure_error.transpose(1, 0, 2, 3))
    counts = None if forward.counts is None else forward.counts.reversed()
    return replace(backward, measure_error=error, counts=counts)
