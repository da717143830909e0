"""A walk passes detectors: the technique that needs no join and completes the estimator.

Track-length estimator: a segment of a walk contributes (length inside the detector) / (volume) times
its weight, so its expectation is the fluence averaged over the detector. The delay is that of the
plane wave through the point itself (length to the closest approach), not of the place of the hit.
"""

import math

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.rng import hashed_uniform
from soundspaces_sim.transport.bsdf.surface import density
from soundspaces_sim.transport.paths import mis
from soundspaces_sim.transport.paths.detector import direction_cell, level_of
from soundspaces_sim.transport.tables import absorb_air, deposit, deposit_batch, time_bin


@part(forceinline=True)
def chord_in_detector(detectors, i, r, walk_key, segment, leg, tq, b2):
    """Length of a segment inside detector `i` of radius `r` (an unbiased estimate where walls cut it)."""
    ox, oy, oz, dx, dy, dz, t_end = leg
    half = math.sqrt(r * r - b2)
    t0, t1 = max(tq - half, 0.0), min(tq + half, t_end)
    if t1 <= t0:
        return 0.0
    if r <= detectors.clearance[i]:
        return t1 - t0
    u = hashed_uniform(walk_key ^ detectors.keys[i], segment)
    t = t0 + u * (t1 - t0)
    vx = ox + t * dx - detectors.points[i, 0]
    vy = oy + t * dy - detectors.points[i, 1]
    vz = oz + t * dz - detectors.points[i, 2]
    d = math.sqrt(vx * vx + vy * vy + vz * vz)
    if d > 0.0 and detectors.reach[i, direction_cell(vx / d, vy / d, vz / d)] < d:
        return 0.0
    return t1 - t0


@part(forceinline=True)
def _detect(i, world, receivers, walk, leg, tq, b2, distance2, to_point, beta, first, scratch, out):
    """Deposit what detector `i` catches of a segment that comes within its radius."""
    detectors, settings = receivers.detectors, world.settings
    length = walk.length + max(tq, 0.0)
    if length > walk.longest or length <= walk.shortest:
        return
    level = level_of(world.radii, length)
    r = world.radii.radius[level]
    if b2 >= r * r or detectors.volume[i, level] <= 0.0:
        return
    bin_index = time_bin(length, world.bin_of_step, settings.step)
    if bin_index < 0:
        return
    chord = chord_in_detector(detectors, i, r, walk.key, walk.segment, leg, tq, b2)
    if chord <= 0.0:
        return

    vertex_term = 0.0
    if walk.material >= 0:  # scattered last: it could have been joined there, if that faces the point
        r = math.sqrt(distance2)
        forward_w = density(
            world.surfaces, walk.material, walk.came, walk.normal,
            (to_point[0] / r, to_point[1] / r, to_point[2] / r),
        )  # fmt: skip
        if forward_w > 0.0:
            vertex_term = distance2 / forward_w
    weight = mis.weight_hit(
        walk.a, walk.b, vertex_term, receivers.own_section[level], detectors.section[i, level],
        settings.kappa, length <= settings.join_length and walk.events <= settings.join_depth,
    )  # fmt: skip
    scale = weight * chord * walk.share / detectors.volume[i, level]
    energy = scratch.energy
    for band in range(len(energy)):
        energy[band] = beta[band] * scale
    absorb_air(energy, world.air, settings.air_step, length)
    deposit_batch(out.batches[i], walk.batch, world.window_of_bin[bin_index], energy)
    if out.arrive.shape[1] > 0:
        deposit(out.arrive[i], bin_index, scratch.arrival, energy)
    if out.leave.shape[1] > 0:
        deposit(out.leave[i], bin_index, first, energy)


@part(forceinline=True, fastmath=True)
def _measure_groups(spheres, ox, oy, oz, dx, dy, dz, t_end, r, near):
    """Squared distance of each bounding sphere from a segment, less its reach: negative is near.

    Without branches, so that it is compiled to vector instructions.
    """
    for g in range(spheres.shape[1]):
        vx, vy, vz = spheres[0, g] - ox, spheres[1, g] - oy, spheres[2, g] - oz
        t = vx * dx + vy * dy + vz * dz
        t = t if t > 0.0 else 0.0
        t = t if t < t_end else t_end
        wx, wy, wz = vx - t * dx, vy - t * dy, vz - t * dz
        reach = spheres[3, g] + r
        near[g] = wx * wx + wy * wy + wz * wz - reach * reach


@part(forceinline=True)
def pass_detectors(world, receivers, walk, leg, beta, first, scratch, out):
    """Deposit one segment of a walk at every detector that it passes.

    Detectors are tested in groups with a bounding sphere, then one by one.
    """
    detectors = receivers.detectors
    ox, oy, oz, dx, dy, dz, t_end = leg
    # No path of this segment is longer, so no detector is wider.
    r = world.radii.radius[level_of(world.radii, walk.length + t_end)]
    r2 = r * r
    near, points = scratch.near, detectors.sorted_points
    _measure_groups(detectors.group_sphere, ox, oy, oz, dx, dy, dz, t_end, r, near)
    for g in range(len(detectors.group_start) - 1):
        if near[g] >= 0.0:
            continue
        for k in range(detectors.group_start[g], detectors.group_start[g + 1]):
            # Read by index: unpacking a row makes a view, which costs more than the test itself.
            vx, vy, vz = points[k, 0] - ox, points[k, 1] - oy, points[k, 2] - oz
            tq = vx * dx + vy * dy + vz * dz
            distance2 = vx * vx + vy * vy + vz * vz
            b2 = max(distance2 - tq * tq, 0.0)
            if b2 >= r2 or tq <= -r or tq >= t_end + r:
                continue
            _detect(
                detectors.order[k], world, receivers, walk, leg, tq, b2, distance2, (vx, vy, vz), beta,
                first, scratch, out,
            )  # fmt: skip
