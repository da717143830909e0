"""A bounce: where a ray meets a wall, and how it goes on from there. One step for all walks."""

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.rng import uniform
from soundspaces_sim.scene.rays.geometry import cast, hit_point
from soundspaces_sim.transport import bsdf as lobes
from soundspaces_sim.transport.bsdf.surface import choose_lobe, weigh


@part(forceinline=True)
def meet(geometry, origin, direction, limit):
    """(distance, triangle, point on it, normal on the incoming side); triangle -1 if none within `limit`."""
    ox, oy, oz = origin
    dx, dy, dz = direction
    t, triangle = cast(geometry, ox, oy, oz, dx, dy, dz, limit)
    if triangle < 0:
        return t, triangle, origin, direction
    x, y, z, nx, ny, nz = hit_point(geometry, triangle, ox, oy, oz, dx, dy, dz, t)
    return t, triangle, (x, y, z), (nx, ny, nz)


@part(forceinline=True)
def leave(geometry, lobe, point, normal, direction, u, v):
    """(origin, direction) of the next ray, off the wall on the side to which the lobe sends it."""
    side = -geometry.epsilon if lobes.passes(lobe) else geometry.epsilon
    origin = (point[0] + side * normal[0], point[1] + side * normal[1], point[2] + side * normal[2])
    return origin, lobes.sample(lobe, direction, normal, u, v)


@part
def bounce(
    geometry, surfaces, material, hero, event, cos, point, normal, direction, stream, beta, mixture
):
    """Choose a lobe and weigh the walk: (lobe, or -1 if it ends; origin and direction of the next ray; stream).

    `cos` is that of incidence; what departs by angle is left to the caller (`surface.depart`).
    """
    stream, u0 = uniform(stream)
    stream, u1 = uniform(stream)
    stream, u2 = uniform(stream)
    lobe = choose_lobe(surfaces, material, hero, event, u0)
    if lobe < 0 or not weigh(surfaces, material, lobe, cos, event, beta, mixture):
        return -1, point, direction, stream
    origin, direction = leave(geometry, lobe, point, normal, direction, u1, u2)
    return lobe, origin, direction, stream
