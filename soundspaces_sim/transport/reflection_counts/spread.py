"""How much counts of reflections spread about their mean: a property of the scene, measured once.

The paths of a bin differ in their counts, and other absorption weighs them anew: beside the mean counts of a pair
their covariance is needed (docs/theory.md, section 11). It rises with the mean as that of renewals does, so what is
kept is cov(n_m, n_k) / sqrt(n̄_m n̄_k), one for all times. Subpaths of a few places in the scene pass detectors at
all of them, until 35 dB of their energy are gone; covariances are those within a pair of places, over all pairs.
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
_PLACES, _WALKS = 8, 512  # places, and subpaths of each
_WINDOW_S = 0.02
_LEAST = 10.0**-3.5  # energy of the mean subpath, beyond which a band is not looked at
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
def _measure_mean(paths: Paths, scale: np.ndarray) -> None:
    """Fill `scale` (b,), with which late passages weigh as much as early ones, and inaudible ones nothing."""
    for b in range(len(scale)):
        total = 0.0
        for i in range(len(paths.alive)):
            if paths.alive[i]:
                total += paths.beta[i, b]
        mean = total / len(paths.alive)
        scale[b] = 1.0 / mean if mean > _LEAST else 0.0


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
            _measure_mean(paths, scratch.scale)
            limit, stage, under_way = min(limit + STEP, settings.max_length), stage + 1, False
            limits = Limits(limit, math.inf, settings.max_length, settings.max_bounces)
            for i in range(len(paths.alive)):
                if paths.alive[i]:
                    paths.alive[i] = _advance(world.geometry, paths, i, limits, context) == UNDER_WAY
                    under_way = under_way or paths.alive[i]
            draw = hashed_uniform(combine(key, 1), 2 + stage)
            resample(paths, settings, limit, draw, len(paths.alive))


class _Spread(NamedTuple):
    spread: np.ndarray  # (C, b)


def count_spread(model: Model) -> np.ndarray:
    """(C, b) `ReflectionCounts.spread` of a scene: `model.once(count_spread)`."""
    groups, bands = group_count(model.world.surfaces), model.world.air.shape[1]
    key = scene_key(model.scene), model.config, model.duration, model.seed, "spread of counts"
    found = cached_on_disk(
        _Spread,
        key,
        lambda: _Spread(_measure(model)),
        lambda found: like(found, {"spread": "f8 c b"}, {"c": row_count(groups), "b": bands}),
    )
    return found.spread


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
        return _Scratch(near, np.empty(bands), np.empty(bands), np.zeros(1, np.int64), paths)

    over_rows(_trace, len(points), world, ends, sums, chunk=1, scratch=make_scratch)
    return _ratios(_Sums(*(s + s.swapaxes(0, 1) for s in sums)))


def _ratios(sums: _Sums) -> np.ndarray:
    """(C, b) Σ cov / Σ sqrt(n̄ n̄) over windows and pairs, by their passages."""
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
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0.0)
