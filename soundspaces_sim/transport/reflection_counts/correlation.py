"""How counts of reflections by different materials go together: a property of the scene, measured once.

The paths of a bin differ in their counts, and other absorption weighs them anew: beside the mean counts of a pair
and how much each spreads about it, their correlations are needed (docs/theory.md, section 11), one for all times.
Subpaths of a few places in the scene pass detectors at all of them, as long as they descend from many that set out;
covariances are those within a pair of places and a narrow window, over all pairs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.io.disk_cache import cached_on_disk
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform, point_keys
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.echogram.reflection_counts import row_count
from soundspaces_sim.scene.rays.geometry import Hit
from soundspaces_sim.transport.bsdf.sampling import choose_proposal
from soundspaces_sim.transport.bsdf.surface import group_count, is_delta
from soundspaces_sim.transport.check_cached import like, scene_key
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.paths import mis
from soundspaces_sim.transport.paths.advance import (
    UNDER_WAY,
    Limits,
    Policy,
    apply_departure,
    cos_incidence,
    make_advance,
    sample_bsdf,
)
from soundspaces_sim.transport.paths.detect import (
    Carried,
    Passage,
    Segment,
    chord_in_detector,
    make_pass,
)
from soundspaces_sim.transport.paths.detector import level_of, make_detectors, make_radii
from soundspaces_sim.transport.paths.emission import emit
from soundspaces_sim.transport.paths.path_state import (
    Paths,
    direction_of,
    empty_paths,
    origin_of,
    start_path,
)
from soundspaces_sim.transport.paths.population import STEP, resample
from soundspaces_sim.transport.reflection_counts.groups import inner_places
from soundspaces_sim.transport.state import Ends, Receivers, World
from soundspaces_sim.transport.tables import time_bin

_STREAM = 0xC047  # keeps these subpaths' numbers apart from others'
_PLACES, _WALKS = 8, 1024  # places, and subpaths of each
_WINDOW_S = 0.01  # narrow, lest the course of the mean passes for spread
_FAMILIES = 50.0  # effective number of subpaths that set out, below which a band is not looked at
_RADII = (
    0.3,
    0.1,
    2.0,
)  # m, as in `ReceiverVolumesConfig`: counts vary less from place to place than energy


class _Sums(NamedTuple):
    """Over what P places' subpaths leave at P detectors, in windows."""

    weight: np.ndarray  # (P, P, windows, b)
    squares: np.ndarray  # (P, P, windows, b) of weights
    counts: np.ndarray  # (P, P, windows, groups, b) times counts
    products: np.ndarray  # (P, P, windows, C, b) times products of counts, lower triangle


class _Scratch(NamedTuple):
    """A thread's working arrays."""

    near: np.ndarray  # (G,) for `detect.make_pass`
    scale: np.ndarray  # (b,) 1 / energy of the mean subpath
    family: np.ndarray  # (subpaths,) energy that descends from each that set out
    weight: np.ndarray  # (b,) of a passage
    number: np.ndarray  # (1,) segments so far
    paths: Paths


class _Context(NamedTuple):
    """What the subpaths of a place know while they advance."""

    world: World  # its bins are the windows
    receivers: Receivers
    scratch: _Scratch
    sums: _Sums  # of the place


@part(forceinline=True)
def _detect(
    world: World, receivers: Receivers, segment: Segment, passage: Passage, carried: Carried,
    scratch: _Scratch, sums: _Sums,
) -> None:  # fmt: skip
    """Add what a detector catches of a segment that comes within its radius."""
    detectors, i = receivers.detectors, passage.i
    length = segment.start_length + max(passage.t, 0.0)
    level = level_of(world.radii, length)
    radius = world.radii.radius[level]
    if passage.b2 >= radius * radius or detectors.volume[i, level] <= 0.0:
        return
    window = time_bin(length, world.bin_of_step, world.settings.step)
    if window < 0:
        return
    chord, weight = chord_in_detector(detectors, segment, passage, radius), scratch.weight
    for b in range(len(weight)):
        weight[b] = carried.beta[b] * scratch.scale[b] * chord / detectors.volume[i, level]
        sums.weight[i, window, b] += weight[b]
        sums.squares[i, window, b] += weight[b] * weight[b]
    row = 0
    for m in range(len(carried.counts)):
        n = float(carried.counts[m])
        for b in range(len(weight)):
            sums.counts[i, window, m, b] += weight[b] * n
        for k in range(m + 1):
            both = n * carried.counts[k]
            if both > 0.0:
                for b in range(len(weight)):
                    sums.products[i, window, row + k, b] += weight[b] * both
        row += m + 1


_pass_detectors = make_pass(_detect)


@part(forceinline=True)
def _at_segment(context: _Context, paths: Paths, i: int, hit: Hit) -> None:
    """Add the segment at the detectors that it passes, once it has been scattered."""
    state, settings = paths.state[i], context.world.settings
    if state.scattered:
        nowhere = (0.0, 0.0, 1.0)
        segment = Segment(
            origin=origin_of(state), direction=direction_of(state),
            end=min(hit.distance, settings.max_length - state.length), start_length=state.length,
            shortest=0.0, longest=math.inf, key=state.stream, number=context.scratch.number[0], batch=0,
            share=1.0, events=state.events, sums=mis.start(settings.kappa), material=-1, incident=nowhere,
            normal=nowhere,
        )  # fmt: skip
        carried = Carried(paths.beta[i], paths.first[i], paths.counts[i])
        _pass_detectors(
            context.world, context.receivers, segment, carried, context.scratch, context.sums
        )
    context.scratch.number[0] += 1


@part(forceinline=True)
def _at_surface(context: _Context, paths: Paths, i: int, hit: Hit) -> bool:
    """Go on as the surface's BSDF sends sound; `sample_bsdf` counts."""
    geometry, surfaces, state = context.world.geometry, context.world.surfaces, paths.state[i]
    lobe = sample_bsdf(geometry, surfaces, paths, i, hit, cos_incidence(state, hit))
    if lobe < 0:
        return False
    state.scattered = state.scattered or not is_delta(lobe)
    apply_departure(surfaces, geometry.material[hit.triangle], paths, i, hit, lobe)
    return True


_advance = make_advance(Policy(_at_segment, _at_surface))


@part
def _start(paths: Paths, world: World, ends: Ends, p: int, key: int) -> None:
    """All subpaths of a place."""
    paths.beta[:] = 1.0
    paths.mixture[:] = 1.0
    paths.counts[:] = 0
    for i in range(len(paths.alive)):
        state = paths.state[i]
        start_path(state, row(ends.points, p), emit(key, i))
        state.index = i
        state.stream = combine(key, 2 * i)
        state.proposal = choose_proposal(world.surfaces, hashed_uniform(state.stream, 1))
        paths.alive[i] = True
        paths.retired[i] = False


@part
def _measure_mean(paths: Paths, scratch: _Scratch) -> None:
    """Fill `scale` (b,), with which late passages weigh as much as early ones, and nothing in a band whose energy
    descends from few of the subpaths that set out: copies have met the same surfaces."""
    family, scale = scratch.family, scratch.scale
    for b in range(len(scale)):
        family[:] = 0.0
        for i in range(len(paths.alive)):
            if paths.alive[i]:
                family[paths.state[i].index] += paths.beta[i, b]
        total, squares = 0.0, 0.0
        for i in range(len(family)):
            total += family[i]
            squares += family[i] * family[i]
        many = total * total > _FAMILIES * squares
        scale[b] = len(paths.alive) / total if many else 0.0


@kernel
def _trace(first: int, last: int, world: World, ends: Ends, sums: _Sums, scratch: _Scratch) -> None:
    """Subpaths of the places `first` to `last`, added to `sums`."""
    paths, settings = scratch.paths, world.settings
    for p in range(first, last):
        key = combine(ends.keys[p], _STREAM)
        receivers = Receivers(ends.detectors, ends.detectors.section[p])
        of_place = _Sums(sums.weight[p], sums.squares[p], sums.counts[p], sums.products[p])
        context = _Context(world, receivers, scratch, of_place)
        _start(paths, world, ends, p, key)
        scratch.number[0] = 0
        limit, stage, under_way = 0.0, 0, True
        while limit < settings.max_length and under_way:
            _measure_mean(paths, scratch)
            limit, stage, under_way = min(limit + STEP, settings.max_length), stage + 1, False
            limits = Limits(limit, math.inf, settings.max_length, settings.max_bounces)
            for i in range(len(paths.alive)):
                if paths.alive[i]:
                    paths.alive[i] = _advance(world.geometry, paths, i, limits, context) == UNDER_WAY
                    under_way = under_way or paths.alive[i]
            draw = hashed_uniform(combine(key, 1), 2 + stage)
            resample(paths, settings, limit, draw, len(paths.alive))


class _Correlation(NamedTuple):
    correlation: np.ndarray  # (C, b)


def count_correlation(model: Model) -> np.ndarray:
    """(C, b) `ReflectionCounts.correlation` of a scene: `model.once(count_correlation)`."""
    groups, bands = group_count(model.world.surfaces), model.world.air.shape[1]
    key = scene_key(model.scene), model.config, model.duration, model.seed, "correlation of counts"
    found = cached_on_disk(
        _Correlation,
        key,
        lambda: _Correlation(_measure(model)),
        lambda found: like(found, {"correlation": "f8 c b"}, {"c": row_count(groups), "b": bands}),
    )
    return found.correlation


def _measure(model: Model) -> np.ndarray:
    world, groups = model.world, group_count(model.world.surfaces)
    step, windows = _WINDOW_S * model.config.c, math.ceil(model.duration / _WINDOW_S)
    settings = world.settings._replace(connected=0, step=step, max_length=windows * step)
    world = world._replace(
        radii=make_radii(*_RADII), settings=settings, bin_of_step=np.arange(windows, dtype=np.int64)
    )
    points = inner_places(model.scene, _PLACES)
    keys = point_keys(points, model.seed)
    ends = Ends(points, keys, make_detectors(world.geometry, points, keys, world.radii))
    shape, bands = (len(points), len(points), windows), world.air.shape[1]
    sums = _Sums(
        np.zeros((*shape, bands)),
        np.zeros((*shape, bands)),
        np.zeros((*shape, groups, bands)),
        np.zeros((*shape, row_count(groups), bands)),
    )

    def make_scratch() -> _Scratch:
        paths = empty_paths(_WALKS, bands, world.surfaces.proposal.shape[1], groups)
        near = np.empty(ends.detectors.group_sphere.shape[1])
        scale, weight = np.empty((2, bands))
        return _Scratch(near, scale, np.empty(_WALKS), weight, np.zeros(1, np.int64), paths)

    over_rows(_trace, len(points), world, ends, sums, chunk=1, scratch=make_scratch)
    return _ratios(_Sums(*(s + s.swapaxes(0, 1) for s in sums)))


def _ratios(sums: _Sums) -> np.ndarray:
    """(C, b) correlations, of covariances that are Σ cov / Σ sqrt(n̄ n̄) over windows and pairs, by passages."""
    row, column = np.tril_indices(sums.counts.shape[-2])
    weight = np.where(sums.weight > 0.0, sums.weight, 1.0)
    samples = np.where(sums.weight > 0.0, sums.weight**2 / np.maximum(sums.squares, 1e-300), 0.0)
    mean = sums.counts / weight[..., None, :]
    products = mean[..., row, :] * mean[..., column, :]
    covariance = sums.products / weight[..., None, :] - products
    covariance *= (samples / np.maximum(samples - 1.0, 1.0))[..., None, :]
    share = np.where(samples >= 2.0, samples, 0.0)[..., None, :]
    above = (share * covariance).sum(axis=(0, 1, 2))
    below = (share * np.sqrt(products)).sum(axis=(0, 1, 2))
    ratio = np.divide(above, below, out=np.zeros_like(above), where=below > 0.0)
    variance = np.maximum(ratio[row == column], 0.0)
    roots = np.sqrt(variance[row] * variance[column])
    return np.clip(np.divide(ratio, roots, out=np.zeros_like(ratio), where=roots > 0.0), -1.0, 1.0)
