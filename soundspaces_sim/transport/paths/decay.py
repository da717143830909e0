"""How long a scene rings: the energy that is still under way against path length."""

import math

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.transport.bsdf.surface import choose_hero, depart
from soundspaces_sim.transport.paths.bounce import bounce, meet
from soundspaces_sim.transport.paths.emission import emit


@kernel
def measure_decay(
    first, last, geometry, surfaces, points, keys, walks, max_bounces, step, air, decay, work
):
    """Fill rows of `decay` (P, steps, b): weight of `walks` walks times air, a mean at every `step` m."""
    bands, steps = decay.shape[2], decay.shape[1]
    beta, mixture = work
    for i in range(first, last):
        decay[i] = 0.0
        for index in range(walks):
            stream = combine(keys[i], 2 * index)
            hero = choose_hero(surfaces, hashed_uniform(stream, 1))
            direction = emit(keys[i], index)
            origin = (points[i, 0], points[i, 1], points[i, 2])
            beta[:] = 1.0
            mixture[:] = 1.0
            length, at = 0.0, 0
            for event in range(1, max_bounces + 2):
                t, triangle, x, n = meet(geometry, origin, direction, math.inf)
                if triangle < 0:
                    break
                length += t
                while at < steps and at * step < length:
                    for b in range(bands):
                        decay[i, at, b] += beta[b] * air[at, b] / walks
                    at += 1
                if at >= steps:
                    break
                material = geometry.material[triangle]
                cos_in = -(n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2])
                lobe, origin, direction, stream = bounce(
                    geometry,
                    surfaces,
                    material,
                    hero,
                    event,
                    cos_in,
                    x,
                    n,
                    direction,
                    stream,
                    beta,
                    mixture,
                )
                if lobe < 0:
                    break
                cos_out = n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2]
                depart(surfaces, material, lobe, cos_out, beta)
