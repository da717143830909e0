"""Which transfer subpaths are traced: those that all points share, those of each point alone, and a few pilots."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.core.profile import stage
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.paths.population import STEP
from soundspaces_sim.transport.radiance_transfer.decay_compensation import (
    Decay,
    compensate_decay,
    fit_decay,
    rise,
)
from soundspaces_sim.transport.radiance_transfer.patches import inverse
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import (
    Populations,
    TransferSubpaths,
    by_origin,
    trace_populations,
)
from soundspaces_sim.transport.state import World
from soundspaces_sim.transport.tables import BATCHES

_STREAM = 0x3D1E  # keeps these random numbers apart from those of points' subpaths
_PER_SUBPATH = 8  # transfer subpaths of a scene, at least, for each subpath of a point
_OWN = 2  # specular subpaths of a point for each of its own transfer subpaths; one each brings no less noise
_MOST_RISE = 13.0  # nepers: single precision leaves early energies 3 % then
_PILOTS = 256  # subpaths that tell how much others leave
_DECAY_PILOTS, _MARGIN = 4, 0.7  # populations of pilots that tell the decay; part of it that counts
_RISE = 12.0  # nepers: most by which the compensation grows over the longest path


def subpaths_per_patch(subpaths: int, patches: int) -> int:
    """M for so many `subpaths` of a point and `patches` of a scene: a multiple of BATCHES.

    Batch k of a point is carried on by subpaths m = k (mod BATCHES), so that batch variances include their noise.
    """
    wanted = -(-_PER_SUBPATH * subpaths // max(patches, 1))
    return max(-(-wanted // BATCHES), 1) * BATCHES


def subpath_count(world: World) -> int:
    """M for a world."""
    patches = len(world.patches.weight)
    return subpaths_per_patch(world.settings.round, patches) if patches else 0


def own_continuations(world: World) -> int:
    """First reflections of a batch of a point that are carried on, where points have subpaths of their own."""
    return max(world.settings.specular // (BATCHES * _OWN), 1)


def own_populations(patch: np.ndarray, keys: np.ndarray) -> Populations:
    """Of N points, those of batch k of point i, from the patches `patch[i, k]` of (N, BATCHES, S), are population
    i BATCHES + k. `keys` (N,) uint64 of the points' random streams."""
    of_point = [combine(np.uint64(key), _STREAM) for key in keys]
    of_batch = [combine(np.uint64(key), k) for key in of_point for k in range(BATCHES)]
    return Populations(
        np.array(of_batch, np.uint64),
        np.ascontiguousarray(patch.reshape(-1, patch.shape[2]), np.int32),
    )


def trace_transfer_subpaths(world: World, seed: int) -> TransferSubpaths:
    """Trace the shared transfer subpaths of a world. Raises `ConfigError` if there is no memory for them."""
    patches, rows, key = len(world.patches.weight), subpath_count(world), _scene_key(seed)
    populations = Populations(  # M, with a subpath from each patch
        np.array([combine(key, row) for row in range(rows)], np.uint64),
        np.tile(np.arange(patches, dtype=np.int32), (rows, 1)),
    )
    events = trace_populations(world, populations, events_of_pilots(world, seed))
    subpaths = by_origin(events, patches, patches)
    decay, reach = fit_decay(subpaths.length, subpaths.energy)
    compensate_decay(subpaths.length, decay, reach, subpaths.energy)
    return subpaths._replace(decay=decay, reach=reach)


def events_of_pilots(world: World, seed: int) -> float:
    """How many events pilots of a world leave, in the mean."""
    pilots = _pilots(world, _scene_key(seed))
    found = trace_populations(world, pilots, None)
    return float(found.count[0]) / len(pilots.patch[0])


def trace_own_subpaths(
    world: World, patch: np.ndarray, keys: np.ndarray, decay: Decay, each: float
) -> TransferSubpaths:
    """Trace transfer subpaths of N points alone, those of `own_populations`; `decay`, by which they are
    compensated; `each`: events that one leaves, about. Raises `ConfigError` if there is no memory for them."""
    populations = own_populations(patch, keys)
    events = trace_populations(world, populations, each)
    subpaths = by_origin(events, patch.shape[2], len(world.patches.weight))
    compensate_decay(subpaths.length, decay.rate, decay.reach, subpaths.energy)
    first = [*subpaths.start[::BATCHES, 0], len(subpaths.length)]  # of the events of each point
    of_points = map(slice, first, first[1:])
    found = max(rise(subpaths.length[of], subpaths.energy[of], decay.rate) for of in of_points)
    if found > _MOST_RISE:
        raise ConfigError(
            f"radiance_transfer.subpaths = own: late energies would drown early ones in rounding (compensated for "
            f"their decay they rise by {found:.0f} nepers, expected at most {_MOST_RISE:g}): give 'shared', or "
            f"another seed"
        )
    return subpaths._replace(decay=decay.rate, reach=decay.reach)


@stage("late decay")
def pilot_decay(model: Model) -> Decay:
    """The decay that a few subpaths tell, from patches all over the scene, less a margin:
    `model.first.once(pilot_decay)`.

    But for rounding the result is the same whatever it is, so nothing that other subpaths find is dropped for its
    length. A rate that is too low loses what is far below the first energies. One that is too high lets late
    energies rise until all others drown in their rounding: a few subpaths may miss what decays slowest. Energies do
    not rise with length before they are compensated, so that they rise by `_RISE` at most.
    """
    world = model.world
    events = trace_populations(world, _pilots(world, _scene_key(model.seed), _DECAY_PILOTS), None)
    found = [(events.length[r, :n], events.energy[r, :n]) for r, n in enumerate(events.count)]
    rate, _ = fit_decay(*(np.concatenate(column) for column in zip(*found, strict=True)))
    longest = world.settings.max_length + STEP
    return Decay(np.minimum(_MARGIN * rate, _RISE / longest), np.full(len(rate), longest))


def _scene_key(seed: int) -> np.uint64:
    """Of the random numbers that all points of a scene share."""
    return np.uint64(combine(seed, _STREAM))


def _pilots(world: World, key: np.uint64, rows: int = 1) -> Populations:
    """Populations on some of the patches, by systematic sampling in proportion to what they scatter."""
    strength = inverse(world.patches.weight).mean(axis=1)
    count = min(_PILOTS, len(strength))
    upto = np.cumsum(strength)
    at = (np.arange(count) + combine(key, _STREAM) / 2.0**64) / count * upto[-1]
    patch = np.minimum(np.searchsorted(upto, at, "right"), len(strength) - 1)
    keys = np.array([combine(key, 2**32 + row) for row in range(rows)], np.uint64)
    return Populations(keys, np.tile(patch.astype(np.int32), (rows, 1)))
