"""One loop for all subpaths: to the next surface, and on from there as a BSDF sends sound.

`make_advance(policy)` gives the compiled loop with a policy's functions within it. Subpaths of points (`subpath`),
specular ones (`specular`), those from patch to patch (`radiance_transfer.transfer_subpaths`), those that measure
the decay (`decay`) and the pilots of guided sampling (`guide`) differ in their policies alone.
"""

from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.rng import event_uniforms
from soundspaces_sim.core.numerics.vec3 import dot
from soundspaces_sim.scene.rays.geometry import Geometry, Hit, before, intersect
from soundspaces_sim.transport import bsdf
from soundspaces_sim.transport.bsdf.sampling import choose_lobe, update_throughput
from soundspaces_sim.transport.bsdf.surface import Surfaces, apply_departure_factor, is_transmission
from soundspaces_sim.transport.elements import through_element
from soundspaces_sim.transport.paths.path_state import (
    PathRow,
    Paths,
    direction_of,
    origin_of,
    put_direction,
    put_origin,
)

ENDED, UNDER_WAY, RETIRED = range(3)


class Limits(NamedTuple):
    """How far subpaths go."""

    until: float  # m: they stop, under way, where a segment would start at this length or beyond
    retire: float  # m: they retire where a segment would start beyond
    longest: float  # m: they end
    events: int  # so many, and they end


class Policy(NamedTuple):
    """What is done on the way. Both are compiled functions, of a record `context` that the policy defines, the
    subpaths, the number of the one that moves, and what its ray hits."""

    at_segment: Any  # -> None: before the subpath moves, also where its ray hits nothing
    # -> bool: length and events include this surface; starts the next ray, or says that it ends
    at_surface: Any


@part(forceinline=True)
def ignore(context: Any, paths: Paths, i: int, hit: Hit) -> None:
    """An `at_segment` that does nothing."""


def make_advance(policy: Policy) -> Any:
    """Compiled `advance(geometry, paths, i, limits, context)`: subpath i goes on until it stops; ENDED, UNDER_WAY
    or RETIRED."""
    at_segment, at_surface = policy

    @part
    def advance(geometry: Geometry, paths: Paths, i: int, limits: Limits, context: Any) -> int:
        state = paths.state[i]
        while state.length < limits.until:
            if state.length > limits.retire:
                return RETIRED
            remaining = limits.longest - state.length
            hit = intersect(geometry, origin_of(state), direction_of(state), remaining)
            at_segment(context, paths, i, hit)
            if hit.triangle < 0 or state.events >= limits.events:
                return ENDED
            state.length += hit.distance
            state.events += 1
            if not at_surface(context, paths, i, hit):
                return ENDED
        return UNDER_WAY

    return advance


@part(forceinline=True)
def cos_incidence(state: PathRow, hit: Hit) -> float:
    """Cosine of the angle at which a subpath meets a surface."""
    return -dot(hit.normal, direction_of(state))


@part(forceinline=True)
def spawn_ray(
    geometry: Geometry,
    surfaces: Surfaces,
    state: PathRow,
    hit: Hit,
    lobe: int,
    uv: tuple[float, float],
    energy: np.ndarray,
) -> None:
    """Start the next ray where a lobe sends sound, off the surface on that side; `uv`: two uniform numbers. What
    enters an element goes on behind it, with what is left of its `energy` (b,)."""
    direction = direction_of(state)
    if is_transmission(lobe):
        passed, origin, direction = through_element(geometry, surfaces, hit, direction, uv[0], energy)
        put_origin(state, origin)
        state.length += passed
    else:
        put_origin(state, before(geometry, hit, direction))
    put_direction(state, bsdf.sample(lobe, direction, hit.normal, uv))


@part(forceinline=True)
def count_reflection(surfaces: Surfaces, paths: Paths, i: int, material: int, lobe: int) -> None:
    """Count subpath i's reflection in its material's group, if it has one; transmissions are not counted."""
    group = surfaces.group[material]
    if group >= 0 and group < paths.counts.shape[1] and not is_transmission(lobe):
        paths.counts[i, group] += np.uint16(1)


@part
def sample_bsdf(
    geometry: Geometry, surfaces: Surfaces, paths: Paths, i: int, hit: Hit, cos_in: float
) -> int:
    """Draw a lobe, update the throughput and start the next ray: the lobe, or -1 if the subpath ends.

    The law's factor of the angle of departure is left to the caller (`apply_departure`).
    """
    state, material = paths.state[i], hit.material
    u, v, w = event_uniforms(state.stream, state.events)
    lobe = choose_lobe(surfaces, material, state.proposal, state.events, u)
    if lobe < 0 or not update_throughput(
        surfaces, material, lobe, cos_in, state.events, paths.beta[i], paths.mixture[i]
    ):
        return -1
    count_reflection(surfaces, paths, i, material, lobe)
    spawn_ray(geometry, surfaces, state, hit, lobe, (v, w), paths.beta[i])
    return lobe


@part(forceinline=True)
def apply_departure(
    surfaces: Surfaces, material: int, paths: Paths, i: int, hit: Hit, lobe: int
) -> None:
    """Multiply the throughput by the law's factor of the angle at which the subpath departs."""
    cos_out = dot(hit.normal, direction_of(paths.state[i]))
    apply_departure_factor(surfaces, material, lobe, cos_out, paths.beta[i])
