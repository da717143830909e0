"""Specular walks: sound that is never scattered, and where it is first scattered.

Where walls scatter little, half of the late sound has only been mirrored, along the few directions that
miss everything soft. Copies of such a walk follow it exactly, so resampling cannot help; many first
directions can. These walks make no choice between scattering and mirroring: they carry the mirrored
part of the energy and are cheap, because those that have become weak end by Russian roulette. They make
all paths without a diffuse event, except those that `images` finds.

On every patch that they meet they leave the energy that is scattered there (`Firsts`): what `middle` makes
late paths of. On the little surface that is of no patch they are scattered or not. So late paths that no patch
scatters are theirs, too.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.scene.rays.directions import stratified_pair
from soundspaces_sim.transport.bsdf import DIFFUSE, MIRROR, THROUGH
from soundspaces_sim.transport.bsdf.surface import depart, even_energy, total, weaken
from soundspaces_sim.transport.image_source.image_source import ORDER
from soundspaces_sim.transport.paths import mis
from soundspaces_sim.transport.paths.bounce import leave, meet
from soundspaces_sim.transport.paths.detect import pass_detectors
from soundspaces_sim.transport.paths.detector import Detectors
from soundspaces_sim.transport.paths.guide import (
    Guide,
    Pilots,
    empty_guide,
    learn_guide,
    make_pilots,
    sample_guided,
    specular_energy,
)
from soundspaces_sim.transport.paths.subpath import make_scratch
from soundspaces_sim.transport.radiance_transfer.first_reflections import FirstReflections, packed
from soundspaces_sim.transport.radiance_transfer.patches import patch_at
from soundspaces_sim.transport.radiance_transfer.prepared import transfer_subpaths
from soundspaces_sim.transport.state import Firsts, Receivers, Scratch, Tables, Walk, World
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, harmonics
from soundspaces_sim.transport.tile import Side, Tile

_STREAM = 0x5BEC  # keeps these walks' numbers apart from those of `walk`
_STEP = 6.0  # m between two looks at the weights
_KEPT = 40.0  # walks for each that carries the mean energy of all sound at its length
_LEAST_THROUGH = 0.1  # probability of passing a wall that transmits at all
_EVENTS = 4  # first events of a walk that there is room for at first


class SpecularWalks(NamedTuple):
    """The specular walks of one batch of one point, advancing together."""

    origin: np.ndarray  # (W, 3)
    direction: np.ndarray  # (W, 3)
    length: np.ndarray  # (W,)
    beta: np.ndarray  # (W, b)
    scattered: np.ndarray  # (W,)
    events: np.ndarray  # (W, 2) all, and reflections
    early: np.ndarray  # (W,) only mirrored so far, at planes that `mirror` knows
    first: np.ndarray  # (W, 9)
    active: np.ndarray  # (W,) numbers of those under way
    mean: np.ndarray  # (b,) energy of the mean walk, see `_mean_energy`


@part
def _store_first(firsts, world, p, slot, walk, patch, length, beta, material, cos):
    """Note what a wall scatters evenly of a walk; returns the next slot."""
    if slot >= firsts.patch.shape[1]:
        return slot + 1  # the caller sees the count and starts again with more room
    firsts.patch[p, slot] = patch
    firsts.length[p, slot] = length
    firsts.walk[p, slot] = walk
    row = firsts.energy[p, slot]
    for b in range(len(beta)):
        row[b] = beta[b] * even_energy(world.surfaces, material, cos, b) / world.settings.specular
    return slot + 1


@part(forceinline=True)
def _turn(surfaces, material, cos, scatter, beta, u):
    """Mirror, pass on, or (with `scatter`) be scattered, weighing `beta`: the lobe, -1 if nothing is left."""
    mirror, through = total(surfaces, material, MIRROR), total(surfaces, material, THROUGH)
    diffuse = total(surfaces, material, DIFFUSE) if scatter else 0.0
    back = mirror + diffuse
    if back + through <= 0.0:
        return -1
    p_through = through / (back + through)
    if through > 0.0 and back > 0.0:
        p_through = max(p_through, _LEAST_THROUGH)
    if u < p_through:
        lobe, chance = THROUGH, p_through
    elif u < p_through + (1.0 - p_through) * diffuse / back:
        lobe, chance = DIFFUSE, (1.0 - p_through) * diffuse / back
    else:
        lobe, chance = MIRROR, (1.0 - p_through) * mirror / back
    return lobe if weaken(surfaces, material, lobe, cos, beta, chance) > 1e-9 else -1


@part
def _advance(world, receivers, walks, w, key, batch, limit, segment, firsts, p, slot, scratch, out):
    """Let walk `w` go on until it is `limit` metres long: (still under way, segment counter, slot)."""
    geometry, surfaces, settings = world.geometry, world.surfaces, world.settings
    origin = (walks.origin[w, 0], walks.origin[w, 1], walks.origin[w, 2])
    direction = (walks.direction[w, 0], walks.direction[w, 1], walks.direction[w, 2])
    length, early, scattered = walks.length[w], walks.early[w], walks.scattered[w]
    events, reflections = walks.events[w, 0], walks.events[w, 1]
    beta = walks.beta[w]
    # Delta events leave both as they are; so do even ones, but for what joins need, which are not here.
    _, a, b = mis.start(settings.kappa)
    nowhere = (0.0, 0.0, 1.0)
    alive = True
    while length < limit:
        remaining = settings.max_length - length
        t, triangle, x, n = meet(geometry, origin, direction, remaining)
        if scattered:
            wanted = length + t > settings.late_length
        else:
            wanted = reflections > 0 and not (early and reflections <= ORDER)
        if wanted:
            harmonics(-direction[0], -direction[1], -direction[2], scratch.arrival)
            walk = Walk(
                key, segment, batch, events, length, settings.late_length if scattered else 0.0, math.inf,
                a, b, 1.0 / settings.specular, -1, nowhere, nowhere,
            )  # fmt: skip
            leg = (*origin, *direction, min(t, remaining))
            pass_detectors(world, receivers, walk, leg, beta, walks.first[w], scratch, out)
        segment += 1
        if triangle < 0 or events >= settings.max_bounces:
            alive = False
            break
        length += t
        events += 1
        material = geometry.material[triangle]
        cos = -(n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2])
        patch = -1
        if settings.merging and total(surfaces, material, DIFFUSE) > 0.0:
            patch = patch_at(world.patches, geometry, triangle, x, n)
            if patch >= 0:
                slot = _store_first(firsts, world, p, slot, w, patch, length, beta, material, cos)
        stream = combine(key, 2 * segment)
        lobe = _turn(
            surfaces,
            material,
            cos,
            settings.merging and patch < 0,
            beta,
            hashed_uniform(stream, 0),
        )
        if lobe < 0:
            alive = False
            break
        if lobe == DIFFUSE:
            scattered = True
        if lobe != THROUGH:
            reflections += 1
        early &= lobe == MIRROR and geometry.plane[triangle] >= 0
        origin, direction = leave(
            geometry, lobe, x, n, direction, hashed_uniform(stream, 1), hashed_uniform(stream, 2)
        )
        cos = n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2]
        depart(surfaces, material, lobe, cos, beta)
    walks.origin[w, 0], walks.origin[w, 1], walks.origin[w, 2] = origin
    walks.direction[w, 0], walks.direction[w, 1], walks.direction[w, 2] = direction
    walks.length[w], walks.early[w], walks.scattered[w] = length, early, scattered
    walks.events[w, 0], walks.events[w, 1] = events, reflections
    return alive, segment, slot


@part
def _mean_energy(decay, pilots, limit, mean):
    """Fill `mean` (b,) with the energy of the mean walk of `limit` m, without air: of all sound, as the scene's
    decay (b,), 1/m, has it, or of what is only mirrored, where that lives longer."""
    for b in range(len(mean)):
        mean[b] = specular_energy(pilots, limit, b)
        if decay[b] > 0.0:
            mean[b] = max(mean[b], math.exp(-decay[b] * limit))


@part
def _roulette(walks, active, key, stage):
    """End walks that carry less than the mean walk, in every band; returns how many go on."""
    kept = 0
    for k in range(active):
        w = walks.active[k]
        chance = 0.0
        for b in range(len(walks.mean)):
            if _KEPT * walks.beta[w, b] > chance * walks.mean[b]:
                chance = _KEPT * walks.beta[w, b] / walks.mean[b] if walks.mean[b] > 0.0 else 1.0
        if chance < 1.0:
            if hashed_uniform(combine(key, 2 * w + 1), stage) >= chance:
                continue
            for b in range(len(walks.mean)):
                walks.beta[w, b] /= chance
        walks.active[kept] = w
        kept += 1
    return kept


@part
def _start(walks, guide, point, key, batch, directions):
    u0, v0 = hashed_uniform(key, 4 * batch + 1), hashed_uniform(key, 4 * batch + 3)
    for w in range(len(walks.length)):
        u, v = stratified_pair(w, u0, v0)
        (dx, dy, dz), density, _ = sample_guided(guide, u, v)
        harmonics(dx, dy, dz, walks.first[w])
        walks.direction[w, 0], walks.direction[w, 1], walks.direction[w, 2] = dx, dy, dz
        directions[w, 0], directions[w, 1], directions[w, 2] = dx, dy, dz
        walks.origin[w, 0], walks.origin[w, 1], walks.origin[w, 2] = point
        walks.active[w] = w
        for b in range(walks.beta.shape[1]):
            walks.beta[w, b] = 1.0 / density
    walks.length[:] = 0.0
    walks.scattered[:] = False
    walks.events[:] = 0
    walks.early[:] = True


def _make_walks(world: World, detectors: Detectors) -> tuple[SpecularWalks, Scratch, Guide, Pilots]:
    slots, bands = world.settings.specular // BATCHES, world.air.shape[1]
    walks = SpecularWalks(
        np.empty((slots, 3)), np.empty((slots, 3)), np.empty(slots),
        np.empty((slots, bands)), np.empty(slots, np.bool_),
        np.empty((slots, 2), np.int64), np.empty(slots, np.bool_), np.empty((slots, CHANNELS)),
        np.empty(slots, np.int64), np.empty(bands),
    )  # fmt: skip
    pilots = make_pilots(world.settings.specular, world.settings.max_length, bands)
    return walks, make_scratch(bands, detectors), empty_guide(), pilots


@kernel
def _trace(first, last, world, decay, points, keys, own_section, detectors, firsts, tables, work):
    """Specular walks of the points `first` to `last`, batch by batch; arguments as `walk.trace_walks`."""
    settings = world.settings
    walks, scratch, guide, pilots = work
    for p in range(first, last):
        receivers = Receivers(detectors, own_section[p])
        out = Tables(tables.arrive[p], tables.leave[p], tables.batches[p])
        point = (points[p, 0], points[p, 1], points[p, 2])
        key = combine(keys[p], _STREAM)
        learn_guide(world, point, key, guide, pilots)
        segment, slot = np.int64(0), np.int64(0)
        for batch in range(BATCHES):
            _start(walks, guide, point, key, batch, firsts.direction[p, batch])
            active, limit, stage = len(walks.length), 0.0, 0
            batch_key = combine(key, batch)
            while limit < settings.max_length and active > 0:
                limit = min(limit + _STEP, settings.max_length)
                stage += 1
                under_way = 0
                for k in range(active):
                    w = walks.active[k]
                    alive, segment, slot = _advance(
                        world,
                        receivers,
                        walks,
                        w,
                        key,
                        batch,
                        limit,
                        segment,
                        firsts,
                        p,
                        slot,
                        scratch,
                        out,
                    )
                    if alive:
                        walks.active[under_way] = w
                        under_way += 1
                _mean_energy(decay, pilots, limit, walks.mean)
                active = _roulette(walks, under_way, batch_key, stage)
            firsts.upto[p, batch] = slot


def _room(points: int, capacity: int, world: World) -> Firsts:
    """For first events of some points."""
    shape, walks = (points, capacity), world.settings.specular // BATCHES
    return Firsts(
        np.empty(shape, np.int32), np.empty(shape, np.float32), np.empty(shape, np.int32),
        np.empty((*shape, world.air.shape[1]), np.float32),
        np.empty((points, BATCHES, walks, 3), np.float32), np.empty((points, BATCHES), np.int64),
    )  # fmt: skip


def trace(tile: Tile, own: Side, other: Side, rows: slice, tables: Tables) -> None:
    """Specular walks of `rows` of `own`, deposited at the points of `other`."""
    world, ends, detectors = tile.model.world, own.ends, other.ends.detectors
    decay = (
        tile.model.once(transfer_subpaths).decay
        if world.settings.merging
        else np.zeros(world.air.shape[1])
    )
    points = len(ends.points[rows])

    def walk(firsts: Firsts, into: Tables) -> None:
        over_rows(
            _trace, points, world, decay, ends.points[rows], ends.keys[rows],
            ends.detectors.section[rows], detectors, firsts, into, chunk=1,
            scratch=lambda: _make_walks(world, detectors),
        )  # fmt: skip

    firsts = own.once(FirstReflections.of)
    if firsts.room is None or len(firsts.room.patch) < points:
        firsts.room = _room(
            points, world.settings.specular * _EVENTS if world.settings.merging else 0, world
        )
    walk(firsts.room, tables)
    most = int(firsts.room.upto[:points, -1].max())
    if most > firsts.room.patch.shape[1]:  # once more, with room enough, and without a second deposit
        firsts.room = _room(points, most + most // 8, world)
        none = Tables(tables.arrive[:, :, :0], tables.leave[:, :, :0], np.zeros_like(tables.batches))
        walk(firsts.room, none)
    if world.settings.merging:
        firsts.blocks.append(packed(Firsts(*(column[:points] for column in firsts.room))))
