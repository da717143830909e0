"""Our audio sensor in a simulator of habitat-sim itself, built without audio.

    sim = habitat_sim.Simulator(...)                        # its pictures, its physics
    sensor = attach(sim, AudioSensorSpec(uuid="ears"))
    sensor.setAudioSourceTransform([2.5, 1.5, -1.5])
    sim.get_sensor_observations()                           # pictures, and under "ears" (channels, samples)

Sensors of habitat-sim are objects of C++, of which a build without audio makes none for sound: its
`AudioSensorSpec` has no settings, and an `AudioSensor` ends the process. So nothing of ours is put into its
scene graph. On the one simulator, `get_sensor_observations` (by which `step` and `reset` observe) and
`get_sensor_observations_async_finish` add to its observations what our sensors hear from where `Agent.get_state`
has the agents. These are the same in releases 0.2.2 to 0.3.4, which keep sensors by agent, and in the later
source, which keeps them by name.
"""

from __future__ import annotations

import weakref
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_rlr.arguments import pick
from soundspaces_rlr.errors import RlrError, as_runtime_errors
from soundspaces_rlr.habitat.agent import Agent, AgentState
from soundspaces_rlr.habitat.records import AudioSensorSpec
from soundspaces_rlr.habitat.scenes import find_scene
from soundspaces_rlr.habitat.sensor import AudioSensor
from soundspaces_sim import Scene

_HEARING = "_soundspaces_sim_hearing"
_WRAPPED = ("get_sensor_observations", "get_sensor_observations_async_finish")


def attach(
    sim: Any,
    spec: AudioSensorSpec,
    agent_id: int | None = None,
    *,
    scene: str | Path | Scene | None = None,
    materials: str | Path | None = None,
) -> AudioSensor:
    """Give an agent of a `habitat_sim.Simulator` an audio sensor of this package; the sensor.

    `agent_id`: by default the simulator's default agent. `scene`: what is heard, as `find_scene` takes it; by
    default the file of the simulator's `scene_id`, also after `reconfigure` has changed it. All sensors of a
    simulator hear the scene that was given last. `materials`: a database for `setAudioMaterialsJSON`. Raises
    TypeError for a specification that is not ours, `RlrError` for a name that is taken, an agent or a scene that
    is not there.
    """
    if not isinstance(spec, AudioSensorSpec):
        raise TypeError(
            f"attach: expected a soundspaces_rlr.habitat.AudioSensorSpec, got {type(spec).__name__}"
        )
    number = sim.config.sim_cfg.default_agent_id if agent_id is None else agent_id
    body = pick(sim.agents, number, "agent")
    hearing = vars(sim).get(_HEARING) or _Hearing(sim)
    twin = hearing.twins.get(number) or Agent()
    if spec.uuid in {*twin.sensors, *(s.uuid for s in body.agent_config.sensor_specifications)}:
        raise RlrError(f"attach: agent {number} has a sensor {spec.uuid!r}; give this one another uuid")
    hearing.take(scene)
    sensor: AudioSensor = twin.add_sensor(spec)
    if materials is not None:
        sensor.setAudioMaterialsJSON(str(materials))
    hearing.twins[number] = twin
    for name, value in ((_HEARING, hearing), *((name, getattr(hearing, name)) for name in _WRAPPED)):
        setattr(sim, name, value)
    return sensor


def detach(sim: Any) -> None:
    """Take all sensors that `attach` gave a simulator away again, and the scene."""
    for name in (_HEARING, *_WRAPPED):
        vars(sim).pop(name, None)


class _Hearing:
    """The audio sensors of one simulator, each on a twin of the agent that carries it. `AudioSensor` is given this
    for its simulator."""

    def __init__(self, sim: Any) -> None:
        self._sim = weakref.ref(sim)  # which holds this: habitat-sim closes when the last reference goes
        self.twins: dict[int, Agent] = {}
        self._given = False
        self._stage: tuple[str, str] | None = None
        self._scene: Scene | None = None

    def take(self, scene: str | Path | Scene | None) -> None:
        """Hear this scene, or with None the one of before or the simulator's."""
        if scene is not None:
            self._stage = self._present_stage()
            self._scene, self._given = _read(scene, self._stage[1]), True
        _ = self.scene  # what cannot be read is refused here

    @property
    def scene(self) -> Scene:
        """What is heard now. Raises `RlrError` if the simulator went elsewhere and only `attach` knew the scene."""
        stage = self._present_stage()
        if self._scene is None or stage != self._stage:
            if self._given and self._stage is not None:
                raise RlrError(
                    f"the simulator went from {self._stage[0]!r} to {stage[0]!r}, and attach was given a scene for "
                    "the former: detach, and attach with the scene of the latter"
                )
            if not Path(stage[0]).exists():
                raise RlrError(f"the simulator's scene_id {stage[0]!r} is no file: give attach a scene")
            self._scene, self._stage = _read(*stage), stage
        return self._scene

    def get_sensor_observations(self, agent_ids: int | list[int] = 0) -> Any:
        """The simulator's observations and what is heard."""
        sim = self._simulator()
        return self._add(type(sim).get_sensor_observations(sim, agent_ids), agent_ids)

    def get_sensor_observations_async_finish(self) -> Any:
        """The same, of pictures that were begun before; what is heard now."""
        sim = self._simulator()
        agent_ids = sim._async_draw_agent_ids  # None where none were begun, which is an error there
        return self._add(type(sim).get_sensor_observations_async_finish(sim), agent_ids)

    def _add(self, observations: Any, agent_ids: int | list[int]) -> Any:
        each = {agent_ids: observations} if isinstance(agent_ids, int) else observations
        for number, seen in each.items():
            heard = self._heard(number)
            if taken := seen.keys() & heard.keys():
                raise RlrError(f"agent {number} has two sensors of the same uuid: {', '.join(taken)}")
            seen.update(heard)
        return observations

    def _heard(self, number: int) -> dict[str, np.ndarray]:
        if number not in self.twins:
            return {}
        twin, state = self.twins[number], self._simulator().get_agent(number).get_state()
        twin.set_state(AgentState(state.position, state.rotation))
        return {name: sensor.get_observation(self) for name, sensor in twin.sensors.items()}

    def _simulator(self) -> Any:
        sim = self._sim()
        if sim is None:
            raise RlrError("the simulator of these sensors is gone")
        return sim

    def _present_stage(self) -> tuple[str, str]:
        backend = self._simulator().config.sim_cfg
        return str(backend.scene_id), str(backend.scene_dataset_config_file)


def _read(scene: str | Path | Scene, dataset_config: str) -> Scene:
    with as_runtime_errors():
        return find_scene(scene, dataset_config)
