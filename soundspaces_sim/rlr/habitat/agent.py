"""Agents: a place to stand, a way to look, and sensors at places in their frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from soundspaces_sim.rlr.arguments import rotation, vector3
from soundspaces_sim.rlr.habitat.records import AudioSensorSpec, Quaternion, as_wxyz
from soundspaces_sim.rlr.habitat.sensor import AudioSensor


@dataclass
class SixDOFPose:
    """A position (3,) m and a rotation."""

    position: Any = field(default_factory=lambda: np.zeros(3))
    rotation: Any = field(default_factory=Quaternion)


@dataclass
class AgentState:
    """Where an agent is, and where its sensors are in the world; states without sensors leave them at their
    places in the agent's frame."""

    position: Any = field(default_factory=lambda: np.zeros(3))
    rotation: Any = field(default_factory=Quaternion)
    sensor_states: dict[str, SixDOFPose] = field(default_factory=dict)


@dataclass
class AgentConfiguration:
    """Size of an agent, m, and its sensors."""

    height: float = 1.5
    radius: float = 0.1
    sensor_specifications: list[AudioSensorSpec] = field(default_factory=list)


class Agent:
    """An agent with audio sensors."""

    def __init__(self, configuration: AgentConfiguration | None = None) -> None:
        self.agent_config = configuration or AgentConfiguration()
        self.sensors: dict[str, AudioSensor] = {}
        self._state = AgentState()
        for spec in self.agent_config.sensor_specifications:
            self.add_sensor(spec)

    @property
    def _sensors(self) -> dict[str, AudioSensor]:
        return self.sensors  # the name that older clients use

    @property
    def state(self) -> AgentState:
        """Where it is."""
        return self.get_state()

    @state.setter
    def state(self, value: AgentState) -> None:
        self.set_state(value)

    def add_sensor(self, spec: AudioSensorSpec) -> AudioSensor:
        """Put an audio sensor at `spec.position` of the agent."""
        if not isinstance(spec, AudioSensorSpec):
            raise TypeError(f"add_sensor: expected an AudioSensorSpec, got {type(spec).__name__}")
        sensor = AudioSensor(spec)
        self.sensors[spec.uuid] = sensor
        self._place({})
        return sensor

    def get_state(self) -> AgentState:
        """A copy of where it and its sensors are."""
        poses = {
            name: SixDOFPose(np.array(sensor.node.absolute_translation), self._state.rotation)
            for name, sensor in self.sensors.items()
        }
        return AgentState(np.array(self._state.position, float), self._state.rotation, poses)

    def set_state(
        self, state: AgentState, reset_sensors: bool = True, infer_sensor_states: bool = True
    ) -> None:
        """Put it somewhere. Sensors go along, to where their specifications have them (`reset_sensors` changes
        nothing: nothing else moves them); without `infer_sensor_states` those that `state.sensor_states`
        names go there instead. Raises `RlrError` and TypeError for what is no pose."""
        del reset_sensors
        position = np.array(vector3(state.position, "AgentState.position"))
        rotation(as_wxyz(state.rotation, "AgentState.rotation"), "AgentState.rotation")
        self._state = AgentState(position, state.rotation)
        self._place({} if infer_sensor_states else dict(state.sensor_states))

    def _place(self, poses: dict[str, SixDOFPose]) -> None:
        turn = rotation(as_wxyz(self._state.rotation, "AgentState.rotation"), "AgentState.rotation")
        for name, sensor in self.sensors.items():
            if name in poses:
                place = np.array(vector3(poses[name].position, f"sensor_states[{name!r}].position"))
            else:
                local = np.array(vector3(sensor.specification().position, "AudioSensorSpec.position"))
                place = np.asarray(self._state.position, float) + turn @ local
            sensor.node.absolute_translation = place
