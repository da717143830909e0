"""Agents: a place to stand, a way to look, and sensors at places in their frame."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from soundspaces_rlr.arguments import vector3
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat.camera import CameraSensor, CameraSensorSpec
from soundspaces_rlr.habitat.controls import (
    ActionSpec,
    default_action_space,
    is_body_action,
    moved,
)
from soundspaces_rlr.habitat.node import Node, from_euler
from soundspaces_rlr.habitat.records import AudioSensorSpec
from soundspaces_rlr.habitat.rotations import as_wxyz, identity, make, matrix, product
from soundspaces_rlr.habitat.sensor import AudioSensor


class Sensor(Protocol):
    """What an agent carries."""

    node: Node

    def specification(self) -> Any:
        """What it was made of."""

    def get_observation(self, sim: Any) -> np.ndarray:
        """What it gives in a simulator from where its node is."""

    def reset(self) -> None:
        """Forget the scene."""


#: Sensors by what specifies them.
_SENSORS: dict[type, Callable[[Any], Any]] = {
    AudioSensorSpec: AudioSensor,
    CameraSensorSpec: CameraSensor,
}


@dataclass
class SixDOFPose:
    """A position (3,) m and a rotation."""

    position: Any = field(default_factory=lambda: np.zeros(3))
    rotation: Any = field(default_factory=identity)


@dataclass
class AgentState:
    """Where an agent is, and where its sensors are in the world; states without sensors leave them at their
    places in the agent's frame."""

    position: Any = field(default_factory=lambda: np.zeros(3))
    rotation: Any = field(default_factory=identity)
    sensor_states: dict[str, SixDOFPose] = field(default_factory=dict)


@dataclass
class AgentConfiguration:
    """Size of an agent, m, its sensors, and what it can do: an `ActionSpec` by key."""

    height: float = 1.5
    radius: float = 0.1
    sensor_specifications: list[Any] = field(default_factory=list)
    action_space: dict[Any, ActionSpec] = field(default_factory=default_action_space)
    body_type: str = "cylinder"


class Agent:
    """An agent with sensors. `scene_node`: where it stands and how it is turned."""

    def __init__(self, configuration: AgentConfiguration | None = None) -> None:
        self.agent_config = configuration or AgentConfiguration()
        self.sensors: dict[str, Any] = {}
        self.scene_node = Node()
        self.initial_state = AgentState()
        self._looks: dict[str, Node] = {}  # of sensors in the agent's frame
        for spec in self.agent_config.sensor_specifications:
            self.add_sensor(spec)

    @property
    def _sensors(self) -> dict[str, Any]:
        return self.sensors  # the name that older clients use

    @property
    def state(self) -> AgentState:
        """Where it is."""
        return self.get_state()

    @state.setter
    def state(self, value: AgentState) -> None:
        self.set_state(value)

    def add_sensor(self, spec: Any) -> Any:
        """Put a sensor at `spec.position` of the agent."""
        if type(spec) not in _SENSORS:
            raise TypeError(
                f"add_sensor: expected an AudioSensorSpec or a CameraSensorSpec, got {type(spec).__name__}"
            )
        sensor = _SENSORS[type(spec)](spec)
        self.sensors[spec.uuid] = sensor
        self._looks[spec.uuid] = _of_spec(spec)
        self._place({})
        return sensor

    def remove_sensor(self, uuid: str) -> None:
        """Take a sensor away."""
        del self.sensors[uuid], self._looks[uuid]

    def get_state(self) -> AgentState:
        """A copy of where it and its sensors are."""
        poses = {
            name: SixDOFPose(np.array(sensor.node.absolute_translation), sensor.node.rotation)
            for name, sensor in self.sensors.items()
        }
        node = self.scene_node
        return AgentState(np.array(node.absolute_translation, float), node.rotation, poses)

    def set_state(
        self,
        state: AgentState,
        reset_sensors: bool = True,
        infer_sensor_states: bool = True,
        is_initial: bool = False,
    ) -> None:
        """Put it somewhere. Sensors go along: with `reset_sensors` to where their specifications have them, without
        it to where they are in the agent's frame now; without `infer_sensor_states` those that
        `state.sensor_states` names go there instead. `is_initial`: where `reset` brings it back to. Raises
        `RlrError` and TypeError for what is no pose."""
        position = np.array(vector3(state.position, "AgentState.position"))
        turn = as_wxyz(state.rotation, "AgentState.rotation")
        matrix(state.rotation, "AgentState.rotation")
        self.scene_node = Node(position, make(*turn))
        if reset_sensors:
            self._looks = {n: _of_spec(s.specification()) for n, s in self.sensors.items()}
        self._place({} if infer_sensor_states else dict(state.sensor_states))
        if is_initial:
            self.initial_state = deepcopy(state)  # clients change arrays in place

    def act(self, action_id: Any, walk: Callable[[Any, Any], Any] | None = None) -> bool:
        """Do what `agent_config.action_space` has under a key; whether it met something. `walk(start, end)`: how
        far one gets, by default all the way. Raises `RlrError` for what it cannot do."""
        space = self.agent_config.action_space
        if action_id not in space:
            raise RlrError(f"no action {action_id!r}: expected one of {list(space)}")
        action = space[action_id]
        body = is_body_action(action.name)
        if action.actuation is None:
            return False
        if body:
            self.scene_node, met = moved(self.scene_node, action.name, action.actuation, walk)
        else:
            met = False
            self._looks = {n: moved(k, action.name, action.actuation)[0] for n, k in self._looks.items()}
        self._place({})
        return met

    def _place(self, poses: dict[str, SixDOFPose]) -> None:
        at, turn = np.asarray(self.scene_node.absolute_translation, float), self.scene_node.rotation
        for name, sensor in self.sensors.items():
            if name in poses:
                what = f"sensor_states[{name!r}]"
                place = np.array(vector3(poses[name].position, f"{what}.position"))
                looks = make(*as_wxyz(poses[name].rotation, f"{what}.rotation"))
            else:
                local = self._looks[name]
                place = at + matrix(turn) @ local.absolute_translation
                looks = product(turn, local.rotation)
            sensor.node.absolute_translation, sensor.node.rotation = place, looks


def _of_spec(spec: Any) -> Node:
    """Where a specification has its sensor in the agent's frame."""
    what = type(spec).__name__
    place = np.array(vector3(spec.position, f"{what}.position"))
    return Node(place, from_euler(spec.orientation, f"{what}.orientation"))
