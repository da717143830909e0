"""How long a scene rings: the energy that is still under way against path length.

The mean throughput of subpaths from some points at given lengths, times what air leaves: an estimate of the decay
that sets an echogram's duration.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.scene.rays.geometry import Geometry, Hit
from soundspaces_sim.transport.bsdf.sampling import choose_proposal
from soundspaces_sim.transport.bsdf.surface import Surfaces
from soundspaces_sim.transport.paths.advance import (
    Limits,
    Policy,
    apply_departure,
    cos_incidence,
    ignore,
    make_advance,
    sample_bsdf,
)
from soundspaces_sim.transport.paths.emission import emit
from soundspaces_sim.transport.paths.path_state import Paths, empty_paths, start_path


class _Context(NamedTuple):
    """What subpaths know while they advance."""

    geometry: Geometry
    surfaces: Surfaces
    step: float  # m between entries of `air`
    air: np.ndarray  # (steps, b) transmission of air
    decay: np.ndarray  # (P, steps, b) mean energy under way at every step, to be filled
    subpaths: int  # of each point
    max_events: int


class _OfPoint(NamedTuple):
    context: _Context
    p: int  # the point


@part(forceinline=True)
def _at_surface(of_point: _OfPoint, paths: Paths, i: int, hit: Hit) -> bool:
    """Note the throughput at every step up to this surface; end where all steps have been passed."""
    context, state = of_point.context, paths.state[i]
    steps, bands = context.decay.shape[1], context.decay.shape[2]
    decay = context.decay[of_point.p]
    while state.next < steps and state.next * context.step < state.length:
        for b in range(bands):
            decay[state.next, b] += paths.beta[i, b] * context.air[state.next, b] / context.subpaths
        state.next += 1
    if state.next >= steps:
        return False
    geometry, surfaces = context.geometry, context.surfaces
    lobe = sample_bsdf(geometry, surfaces, paths, i, hit, cos_incidence(state, hit))
    if lobe < 0:
        return False
    apply_departure(surfaces, hit.material, paths, i, hit, lobe)
    return True


_advance = make_advance(Policy(ignore, _at_surface))


@kernel
def _measure(
    first: int, last: int, context: _Context, points: np.ndarray, keys: np.ndarray, paths: Paths
) -> None:
    """Fill rows `first` to `last` of `context.decay`."""
    state = paths.state[0]
    limits = Limits(math.inf, math.inf, math.inf, context.max_events + 1)
    for p in range(first, last):
        context.decay[p] = 0.0
        for index in range(context.subpaths):
            start_path(state, row(points, p), emit(keys[p], index))
            state.stream = combine(keys[p], 2 * index)
            state.proposal = choose_proposal(context.surfaces, hashed_uniform(state.stream, 1))
            paths.beta[:] = 1.0
            paths.mixture[:] = 1.0
            _advance(context.geometry, paths, 0, limits, _OfPoint(context, p))


def measure_decay(
    geometry: Geometry,
    surfaces: Surfaces,
    points: np.ndarray,
    keys: np.ndarray,
    steps: int,
    step: float,
    air: np.ndarray,
    max_bounces: int,
    subpaths: int = 256,
) -> np.ndarray:
    """(P, steps, b) mean energy under way, of 1 that (P, 3) points emit, after every `step` m.

    `keys` (P,) of the points' random streams; `air` (steps or more, b) transmission; `subpaths` of every point.
    """
    bands, proposals = air.shape[1], surfaces.proposal.shape[1]
    decay = np.empty((len(points), steps, bands))
    context = _Context(geometry, surfaces, step, air, decay, subpaths, max_bounces)
    over_rows(
        _measure,
        len(points),
        context,
        points,
        keys,
        chunk=1,
        scratch=lambda: empty_paths(1, bands, proposals),
    )
    return decay
