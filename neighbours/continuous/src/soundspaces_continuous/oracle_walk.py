"""How many actions the oracle takes to a source that rests: as `ContinuousState` and its `oracle_action`, in one
kernel.

Drawing an episode walks the oracle's whole way, so that a reset would cost more for it than for what is heard.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_continuous.distances import DistanceField, look_ahead
from soundspaces_continuous.obstacles import SKIN, step_disc
from soundspaces_sim.parts import Geometry, Vec3, cast_ray, kernel, kernel_part as part


class Gait(NamedTuple):
    """How an agent moves: the options of those names; `turn` in rad."""

    forward: float
    turn: float
    slide: bool
    success_distance: float
    max_steps: int


class Walker(NamedTuple):
    """Where an agent is, and room for a step."""

    pose: np.ndarray  # (2,) m
    facing: float  # rad
    way: np.ndarray  # (2,) m
    ahead: np.ndarray  # (3,), of `look_ahead`


class Ground(NamedTuple):
    """Where a floor is looked for: `height` m of the agent's highest step, downwards to twice that `step`."""

    geometry: Geometry
    center: Vec3  # m, of the scene, from which `geometry` counts
    height: float
    step: float


@part
def has_ground(ground: Ground, x: float, y: float) -> bool:
    """Whether there is a floor within a step at (x, y) m."""
    c = ground.center
    origin = x - c[0], y - c[1], ground.height - c[2]
    reach = 2.0 * ground.step + SKIN
    return bool(cast_ray(ground.geometry, origin, (0.0, 0.0, -1.0), reach)[1] >= 0)


@kernel
def count_actions(ground: Ground, field: DistanceField, gait: Gait, walker: Walker) -> int:
    """Actions of the oracle to the goal of `field`, STOP included, at most `max_steps`; `walker` walks."""
    pose, facing, way, ahead = walker
    steps = 0
    look_ahead(field, pose[0], pose[1], ahead)
    while True:
        steps += 1
        if ahead[0] < gait.success_distance or steps >= gait.max_steps:
            return steps
        off = math.atan2(ahead[2] - pose[1], ahead[1] - pose[0]) - facing
        off = (off + math.pi) % (2.0 * math.pi) - math.pi
        if abs(off) <= 0.5 * gait.turn + 1e-9:
            x, y = pose[0], pose[1]
            way[0], way[1] = gait.forward * math.cos(facing), gait.forward * math.sin(facing)
            step_disc(field.obstacles, pose, way, gait.slide)
            if not has_ground(ground, pose[0], pose[1]):
                pose[0], pose[1] = x, y
            look_ahead(field, pose[0], pose[1], ahead)
        else:
            facing = (facing + (gait.turn if off > 0.0 else -gait.turn)) % (2.0 * math.pi)
