"""A subpath passes detectors: the estimator that needs no connection and completes the others.

Track-length estimator (Spanier & Gelbard 1969; Křivánek et al. 2014): a segment of a subpath contributes (its
length inside the detector) / (volume) times its throughput, so its expectation is the fluence averaged over the
detector. The delay is that of the plane wave through the point itself (length to the closest approach).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.rng import hashed_uniform
from soundspaces_sim.core.numerics.vec3 import Vec3, along, divide, dot, length, row, subtract
from soundspaces_sim.scene.rays.geometry import Geometry, in_sight
from soundspaces_sim.transport.bsdf.surface import pdf
from soundspaces_sim.transport.paths import mis
from soundspaces_sim.transport.paths.detector import Detectors, direction_cell, level_of
from soundspaces_sim.transport.state import Receivers, Scratch, Tables, World
from soundspaces_sim.transport.tables import absorb_air, deposit, deposit_batch, deposit_counts, time_bin


class Segment(NamedTuple):
    """A straight piece of a subpath."""

    origin: Vec3  # m
    direction: Vec3  # unit
    end: float  # m from the origin
    start_length: float  # m, of the subpath at the origin
    shortest: float  # m: shorter paths are left to another estimator, …
    longest: float  # … and so are longer ones
    key: int  # of random numbers, with the number of `events`
    batch: int
    share: float  # 1 / number of subpaths
    events: int  # so far
    sums: mis.PartialSums
    material: int  # of the surface that scattered it last, -1 after a delta lobe
    incident: Vec3  # direction in which it came to that surface
    normal: Vec3  # of that surface


class Carried(NamedTuple):
    """What a subpath carries along a segment."""

    beta: np.ndarray  # (b,) throughput
    first: np.ndarray  # (9,) harmonics of its first direction
    counts: np.ndarray  # (groups,) reflections so far


class Passage(NamedTuple):
    """How a segment's line passes detector i."""

    i: int
    t: float  # m from the segment's origin to the closest approach; negative if that is behind
    b2: float  # m², square of the distance there
    distance2: float  # m², square of the distance from the origin
    to_point: Vec3  # m, from the origin


@part(forceinline=True)
def chord_in_detector(
    geometry: Geometry, detectors: Detectors, segment: Segment, passage: Passage, radius: float
) -> float:
    """Length, m, of a segment inside a detector of this nominal radius (an unbiased estimate where walls cut
    it)."""
    i = passage.i
    half = math.sqrt(radius * radius - passage.b2)
    t0, t1 = max(passage.t - half, 0.0), min(passage.t + half, segment.end)
    if t1 <= t0:
        return 0.0
    if radius <= detectors.clearance[i]:
        return t1 - t0
    u = hashed_uniform(segment.key ^ detectors.keys[i], segment.events)
    place = along(segment.origin, t0 + u * (t1 - t0), segment.direction)
    point = row(detectors.points, i)
    v = subtract(place, point)
    d = length(v)
    if d <= detectors.clearance[i]:
        return t1 - t0
    if detectors.reach[i, direction_cell(v[0] / d, v[1] / d, v[2] / d)] < d:
        return 0.0
    return t1 - t0 if in_sight(geometry, point, place) else 0.0


@part(forceinline=True)
def _weight(
    world: World,
    receivers: Receivers,
    segment: Segment,
    passage: Passage,
    level: int,
    path_length: float,
) -> float:
    """MIS weight of a path that this estimator closes at a detector."""
    settings = world.settings
    vertex_term = 0.0
    if (
        segment.material >= 0
    ):  # scattered last: it could have been connected there, if that faces the point
        to_point = divide(passage.to_point, math.sqrt(passage.distance2))
        forward_w = pdf(world.surfaces, segment.material, segment.incident, segment.normal, to_point)
        if forward_w > 0.0:
            vertex_term = passage.distance2 / forward_w
    connectable = (
        path_length <= settings.connection_length and segment.events <= settings.connection_depth
    )
    section = receivers.detectors.section[passage.i, level]
    return mis.weight_receiver_volume(
        segment.sums, vertex_term, receivers.own_section[level], section, settings.kappa, connectable
    )


@part(forceinline=True)
def _detect(
    world: World,
    receivers: Receivers,
    segment: Segment,
    passage: Passage,
    carried: Carried,
    scratch: Scratch,
    out: Tables,
) -> None:
    """Deposit what a detector catches of a segment that comes within its radius."""
    detectors, settings, i = receivers.detectors, world.settings, passage.i
    path_length = segment.start_length + max(passage.t, 0.0)
    if path_length > segment.longest or path_length <= segment.shortest:
        return
    level = level_of(world.radii, path_length)
    radius = world.radii.radius[level]
    if passage.b2 >= radius * radius or detectors.volume[i, level] <= 0.0:
        return
    bin_index = time_bin(path_length, world.bin_of_step, settings.step)
    if bin_index < 0:
        return
    chord = chord_in_detector(world.geometry, detectors, segment, passage, radius)
    if chord <= 0.0:
        return
    weight = _weight(world, receivers, segment, passage, level, path_length)
    scale = weight * chord * segment.share / detectors.volume[i, level]
    energy = scratch.energy
    for band in range(len(energy)):
        energy[band] = carried.beta[band] * scale
    absorb_air(energy, world.air, settings.air_step, path_length)
    window = world.window_of_bin[bin_index]
    deposit_batch(out.batches[i], segment.batch, window, energy)
    deposit_counts(out.batches[i], carried.counts, world.surfaces.kept, window, energy)
    scratch.tally[0].deposits += 1
    if out.arrive.shape[1] > 0:
        deposit(out.arrive[i], bin_index, scratch.arrival, energy)
    if out.leave.shape[1] > 0:
        deposit(out.leave[i], bin_index, carried.first, energy)


@part(forceinline=True, fastmath=True)
def _measure_groups(spheres: np.ndarray, segment: Segment, r: float, near: np.ndarray) -> None:
    """Squared distance of each bounding sphere from a segment, less its reach: negative is near.

    Without branches, so that it is compiled to vector instructions.
    """
    ox, oy, oz = segment.origin
    dx, dy, dz = segment.direction
    end = segment.end
    for g in range(spheres.shape[1]):
        vx, vy, vz = spheres[0, g] - ox, spheres[1, g] - oy, spheres[2, g] - oz
        t = vx * dx + vy * dy + vz * dz
        t = t if t > 0.0 else 0.0
        t = t if t < end else end
        wx, wy, wz = vx - t * dx, vy - t * dy, vz - t * dz
        reach = spheres[3, g] + r
        near[g] = wx * wx + wy * wy + wz * wz - reach * reach


def make_pass(detect: Any) -> Any:
    """Compiled `pass_detectors(world, receivers, segment, carried, scratch, out)`: one segment of a subpath at
    every detector that it passes; `detect` (compiled) says what becomes of it at one that it comes near to.

    Detectors are tested in groups with a bounding sphere, then one by one.
    """

    @part(forceinline=True)
    def pass_detectors(
        world: World, receivers: Receivers, segment: Segment, carried: Carried, scratch: Any, out: Any
    ) -> None:
        detectors = receivers.detectors
        # No path of this segment is longer, so no detector is wider.
        r = world.radii.radius[level_of(world.radii, segment.start_length + segment.end)]
        r2 = r * r
        near, points = scratch.near, detectors.sorted_points
        _measure_groups(detectors.group_sphere, segment, r, near)
        for g in range(len(detectors.group_start) - 1):
            if near[g] >= 0.0:
                continue
            for k in range(detectors.group_start[g], detectors.group_start[g + 1]):
                v = subtract(row(points, k), segment.origin)
                t = dot(v, segment.direction)
                distance2 = dot(v, v)
                b2 = max(distance2 - t * t, 0.0)
                if b2 >= r2 or t <= -r or t >= segment.end + r:
                    continue
                passage = Passage(detectors.order[k], t, b2, distance2, v)
                detect(world, receivers, segment, passage, carried, scratch, out)

    return pass_detectors


pass_detectors = make_pass(_detect)
