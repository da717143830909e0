"""First diffuse reflections of the subpaths of points on patches, and which of them transfer subpaths carry on.

A subpath of a point that is only mirrored and transmitted leaves, on every patch that it meets, the energy that
the patch scatters of it (`transport.paths.specular` traces them). These are the incident histograms F of the
point; carried on along transfer subpaths (`transfer_subpaths`) they become its outgoing histograms V.

Which reflections are carried on is drawn by systematic sampling with probability proportional to size: to a
reflection's share of its batch's energy, in the mean over bands.

Source: W. G. Madow (1949), On the theory of systematic sampling, II, Annals of Mathematical Statistics 20.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import at_once, kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.transport.bsdf.surface import group_count
from soundspaces_sim.transport.radiance_transfer.decay_compensation import compensate_decay
from soundspaces_sim.transport.state import ReflectionBlock, World
from soundspaces_sim.transport.tables import BATCHES

_STREAM = 0x51D1  # keeps these random numbers apart from those of the subpaths
_LONG = 2**16  # reflections whose columns are worth a thread each


class Reflections(NamedTuple):
    """First diffuse reflections of N points in one piece, decay-compensated.

    Batch k of point i is rows `start[i, k]` to `start[i, k + 1]` of the (E,) columns.
    """

    start: np.ndarray  # (N, BATCHES + 1)
    patch: np.ndarray  # (E,)
    length: np.ndarray  # (E,) m, from the point to the patch
    subpath: np.ndarray  # (E,) number of the subpath in its batch
    energy: np.ndarray  # (E, b) that the patch scatters, without air
    counts: np.ndarray  # (E, groups) reflections before it
    group: np.ndarray  # (E,) group of the surface that scatters, -1 for none
    direction: np.ndarray  # (N, BATCHES, subpaths, 3) in which each subpath left the point


class Continuations(NamedTuple):
    """Which first reflections transfer subpaths carry on: n of batch k of point i, at `[i, k]`."""

    reflection: np.ndarray  # (N, BATCHES, n) row of `Reflections`, -1 for none
    scale: np.ndarray  # (N, BATCHES, n) inverse of the expected number of draws of this reflection
    population: np.ndarray  # (N, BATCHES, n) of transfer subpaths of which …
    subpath: np.ndarray  # (N, BATCHES, n) … this one carries it on


def room_for(points: int, capacity: int, world: World) -> ReflectionBlock:
    """Room for first reflections of some points, so many of each."""
    shape, subpaths = (points, capacity), world.settings.specular // BATCHES
    return ReflectionBlock(
        patch=np.empty(shape, np.int32),
        length=np.empty(shape, np.float32),
        subpath=np.empty(shape, np.int32),
        energy=np.empty((*shape, world.air.shape[1]), np.float32),
        counts=np.empty((*shape, group_count(world.surfaces)), np.uint16),
        group=np.empty(shape, np.int8),
        direction=np.empty((points, BATCHES, subpaths, 3), np.float32),
        upto=np.empty((points, BATCHES), np.int64),
    )


def packed(block: ReflectionBlock) -> ReflectionBlock:
    """A copy with the reflections of all points in one row, without unused capacity."""
    *columns, direction, upto = block
    used = upto[:, -1]

    def in_a_row(column: np.ndarray) -> np.ndarray:
        return np.concatenate([of_point[:n] for of_point, n in zip(column, used, strict=True)])

    rows = _of_each(in_a_row, columns, int(used.sum()))
    return ReflectionBlock(*(row[None] for row in rows), direction.copy(), upto.copy())


def _of_each(
    make: Callable[[Any], np.ndarray], columns: Sequence[Any], reflections: int
) -> list[np.ndarray]:
    """What is made of each column, side by side if they are long."""
    if reflections < _LONG:
        return [make(column) for column in columns]
    return at_once(*(partial(make, column) for column in columns))


def gather_reflections(
    parts: list[ReflectionBlock], decay: np.ndarray, reach: np.ndarray
) -> Reflections:
    """First reflections of consecutive points in one piece, decay-compensated with the `decay` (b,) and
    `reach` (b,) of the transfer subpaths. Uses up the `parts`, packed."""
    upto = np.concatenate([record.upto for record in parts])
    before = np.concatenate([[0], np.cumsum(upto[:, -1])])
    start = before[:-1, None] + np.concatenate([np.zeros((len(upto), 1), np.int64), upto], axis=1)
    direction = np.concatenate([record.direction for record in parts])
    columns = [list(column) for column in zip(*(record[:-2] for record in parts), strict=True)]
    parts.clear()

    def in_one_piece(column: list[np.ndarray]) -> np.ndarray:
        whole = np.concatenate(column, axis=1)[0]
        column.clear()
        return np.asarray(whole)

    whole = _of_each(in_one_piece, columns, int(before[-1]))
    reflections = Reflections(start, *whole, direction)
    compensate_decay(reflections.length, decay, reach, reflections.energy)
    return reflections


def draw_continuations(
    reflections: Reflections, keys: np.ndarray, count: int, subpaths: int
) -> Continuations:
    """Draw `count` first reflections of every batch, and which of the `subpaths` shared transfer subpaths of its
    patch carries each on.

    Batch k follows populations k (mod BATCHES). `keys` (N,) uint64 of the points' random streams.
    """
    shape = len(reflections.start), BATCHES, count
    drawn = Continuations(
        np.empty(shape, np.int64),
        np.empty(shape, np.float32),
        np.empty(shape, np.int64),
        np.zeros(shape, np.int64),
    )
    most = int(np.diff(reflections.start, axis=1).max(initial=0))
    over_rows(
        _draw, shape[0], reflections, keys, subpaths, drawn, chunk=1, scratch=lambda: np.empty(most)
    )
    return drawn


def with_own_populations(drawn: Continuations) -> Continuations:
    """The same reflections, carried on by transfer subpaths of their point alone (`trace_own_subpaths`)."""
    points, batches, count = drawn.reflection.shape
    population = np.arange(points * batches).reshape(points, batches, 1)
    shape = drawn.reflection.shape
    return drawn._replace(
        population=np.ascontiguousarray(np.broadcast_to(population, shape)),
        subpath=np.ascontiguousarray(np.broadcast_to(np.arange(count), shape)),
    )


def patches_drawn(reflections: Reflections, drawn: Continuations) -> np.ndarray:
    """(N, BATCHES, n) patches of the reflections that are carried on, -1 for none."""
    return np.append(reflections.patch, -1)[drawn.reflection]


@part
def _shares(energy: np.ndarray, start: int, end: int, share: np.ndarray) -> int:
    """Fill `share` (n,) with the shares of the rows `start` to `end` of `energy` (E, b) in the sums of their
    bands, summed over bands; returns the number of bands with energy."""
    share[: end - start] = 0.0
    bands = 0
    for b in range(energy.shape[1]):
        total = 0.0
        for r in range(start, end):
            total += energy[r, b]
        if total > 0.0:
            bands += 1
            for r in range(start, end):
                share[r - start] += energy[r, b] / total
    return bands


@kernel
def _draw(
    first: int,
    last: int,
    reflections: Reflections,
    keys: np.ndarray,
    subpaths: int,
    drawn: Continuations,
    share: np.ndarray,
) -> None:
    """Draw reflections of the points `first` to `last`: the i-th draw of n is where the running sum of the
    probabilities passes (i - u) / n."""
    count = drawn.reflection.shape[2]
    for i in range(first, last):
        for k in range(BATCHES):
            start, end = reflections.start[i, k], reflections.start[i, k + 1]
            bands = _shares(reflections.energy, start, end, share)
            drawn.reflection[i, k, :] = -1
            if bands == 0:
                continue
            key = combine(keys[i], _STREAM + k)
            u, cumulative, taken = hashed_uniform(key, 0), 0.0, 0
            for r in range(start, end):
                probability = share[r - start] / bands
                cumulative += probability
                upto = min(int(cumulative * count + u), count)
                for slot in range(taken, upto):
                    drawn.reflection[i, k, slot] = r
                    drawn.scale[i, k, slot] = 1.0 / (count * probability)
                    step = int(hashed_uniform(key, 1 + slot) * (subpaths // BATCHES))
                    drawn.population[i, k, slot] = k + BATCHES * step
                    drawn.subpath[i, k, slot] = reflections.patch[r]
                taken = max(taken, upto)
