"""Poses of bodies and how one moves at a constant velocity, by the names of `habitat_sim.physics`; no forces."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from soundspaces_rlr.arguments import vector3
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat.magnum import Quaternion, Vector3
from soundspaces_rlr.habitat.rotations import as_wxyz, matrix, product, quat_from_angle_axis


class MotionType(Enum):
    """How a body of habitat-sim moves."""

    UNDEFINED = -1
    STATIC = 0
    KINEMATIC = 1
    DYNAMIC = 2


class JointType(Enum):
    """How two links of a body of habitat-sim hang together."""

    Revolute = 0
    Prismatic = 1
    Spherical = 2
    Planar = 3
    Fixed = 4
    Invalid = 5


class RigidConstraintType(Enum):
    """What holds two bodies of habitat-sim together."""

    PointToPoint = 0
    Fixed = 1


@dataclass
class RigidState:
    """How a body is turned and where it is, m."""

    rotation: Any = field(default_factory=Quaternion)
    translation: Any = field(default_factory=Vector3)


@dataclass
class VelocityControl:
    """A velocity, m/s, and an angular one, rad/s about its axis, each in the world or in the body's frame."""

    linear_velocity: Any = field(default_factory=Vector3)
    angular_velocity: Any = field(default_factory=Vector3)
    controlling_lin_vel: bool = False
    controlling_ang_vel: bool = False
    lin_vel_is_local: bool = False
    ang_vel_is_local: bool = False

    def integrate_transform(self, dt: float, rigid_state: RigidState) -> RigidState:
        """Where a body is after `dt` s of what is controlled: first moved, then turned. Raises `RlrError`."""
        if not 0.0 <= float(dt) < np.inf:
            raise RlrError(f"integrate_transform: dt: expected seconds, 0 or more, got {dt!r}")
        turn = rigid_state.rotation
        place = np.array(vector3(rigid_state.translation, "RigidState.translation"))
        if self.controlling_lin_vel:
            moved = np.array(vector3(self.linear_velocity, "VelocityControl.linear_velocity")) * dt
            place = place + (matrix(turn) @ moved if self.lin_vel_is_local else moved)
        if self.controlling_ang_vel:
            spin = np.array(vector3(self.angular_velocity, "VelocityControl.angular_velocity"))
            rate = float(np.linalg.norm(spin))
            if rate > 0.0:
                by = quat_from_angle_axis(rate * dt, spin)
                turn = product(turn, by) if self.ang_vel_is_local else product(by, turn)
        w, *v = as_wxyz(turn, "RigidState.rotation")
        return RigidState(Quaternion(v, w), Vector3(place))
