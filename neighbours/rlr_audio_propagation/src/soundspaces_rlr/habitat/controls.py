"""What an agent can do: actions by name, with an amount in m or degrees."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat.node import Node
from soundspaces_rlr.habitat.rotations import as_wxyz, make, product, quat_from_angle_axis

_TOUCH = 1e-5  # m, as habitat: a step that gets less far by more than this collided


@dataclass
class ActuationSpec:
    """How far: m for steps, degrees for turns. `constraint`: the steepest look up or down, degrees."""

    amount: float
    constraint: float | None = None


@dataclass
class ActionSpec:
    """`name`: what is done, one of `ACTIONS`; `actuation`: how far."""

    name: str
    actuation: ActuationSpec | None = None


def default_action_space() -> dict[Any, ActionSpec]:
    """A step of 0.25 m and turns of 10 degrees."""
    return {
        "move_forward": ActionSpec("move_forward", ActuationSpec(0.25)),
        "turn_left": ActionSpec("turn_left", ActuationSpec(10.0)),
        "turn_right": ActionSpec("turn_right", ActuationSpec(10.0)),
    }


#: By name: whether it moves the body or the sensors, and by what in the frame of what moves: a direction to go, or
#: an axis to turn about.
ACTIONS: Mapping[str, tuple[bool, str, tuple[float, float, float]]] = {
    "move_forward": (True, "move", (0.0, 0.0, -1.0)),
    "move_backward": (True, "move", (0.0, 0.0, 1.0)),
    "move_left": (True, "move", (-1.0, 0.0, 0.0)),
    "move_right": (True, "move", (1.0, 0.0, 0.0)),
    "turn_left": (True, "turn", (0.0, 1.0, 0.0)),
    "turn_right": (True, "turn", (0.0, -1.0, 0.0)),
    "move_up": (False, "move", (0.0, 1.0, 0.0)),
    "move_down": (False, "move", (0.0, -1.0, 0.0)),
    "look_left": (False, "turn", (0.0, 1.0, 0.0)),
    "look_right": (False, "turn", (0.0, -1.0, 0.0)),
    "look_up": (False, "turn", (1.0, 0.0, 0.0)),
    "look_down": (False, "turn", (-1.0, 0.0, 0.0)),
}


def is_body_action(name: str) -> bool:
    """Whether an action moves the agent, not its sensors. Raises `RlrError` for one that there is not."""
    if name not in ACTIONS:
        raise RlrError(f"ActionSpec: expected one of {', '.join(ACTIONS)}, got {name!r}")
    return ACTIONS[name][0]


def moved(
    node: Node, name: str, how_far: ActuationSpec, walk: Callable[[Any, Any], Any] | None = None
) -> tuple[Node, bool]:
    """A node after an action, and whether it met something. `walk(start, end)` says where one gets to. Raises
    `RlrError`."""
    _, what, direction = ACTIONS[name]
    amount = float(how_far.amount)
    if not math.isfinite(amount):
        raise RlrError(
            f"ActuationSpec of {name}: amount: expected a finite number, got {how_far.amount!r}"
        )
    if what == "turn":
        return Node(
            node.absolute_translation, _turned(node, direction, amount, how_far.constraint)
        ), False
    start = np.array(node.absolute_translation, float)
    end = start + amount * (node.axes @ direction)
    reached = end if walk is None else np.array(walk(start, end), float)
    short = float(np.linalg.norm(reached - start)) + _TOUCH < float(np.linalg.norm(end - start))
    return Node(reached, node.rotation), short


def _turned(
    node: Node, axis: tuple[float, float, float], degrees: float, constraint: float | None
) -> Any:
    """A rotation turned about an axis of its own, as far as a constraint lets it."""
    if constraint is not None and axis[0]:
        if not float(constraint) >= 0.0:
            raise RlrError(f"ActuationSpec: constraint: expected degrees, 0 or more, got {constraint!r}")
        now = math.degrees(math.asin(min(1.0, max(-1.0, -float(node.axes[1, 2])))))
        degrees = axis[0] * (
            min(max(now + axis[0] * degrees, -float(constraint)), float(constraint)) - now
        )
    turned = product(node.rotation, quat_from_angle_axis(math.radians(degrees), axis))
    parts = np.array(as_wxyz(turned, "rotation"))
    return make(*(parts / np.linalg.norm(parts)))
