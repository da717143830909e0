"""`Simulator`: a scene, agents in it, what their audio sensors hear."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import numpy as np

from soundspaces_sim.rlr.arguments import pick
from soundspaces_sim.rlr.errors import as_runtime_errors
from soundspaces_sim.rlr.habitat.agent import Agent, AgentConfiguration, AgentState
from soundspaces_sim.rlr.habitat.pathfinder import PathFinder
from soundspaces_sim.rlr.habitat.records import AudioSensorSpec, as_wxyz
from soundspaces_sim.rlr.habitat.scenes import find_scene
from soundspaces_sim.rlr.habitat.sensor import AudioSensor
from soundspaces_sim.scene.scene import Scene


@dataclass
class SimulatorConfiguration:
    """`scene_id`: what `load_scene` takes: a file, a folder of Replica or Matterport3D, 'demo', a `Scene`.
    `scene_dataset_config_file` and files beside the scene's: see `scenes.find_scene`. The other fields are those
    that clients of habitat-sim set; they concern pictures and physics, and do nothing."""

    scene_id: str | Path | Scene = "demo"
    scene_dataset_config_file: str = "default"
    load_semantic_mesh: bool = False
    enable_physics: bool = False
    create_renderer: bool = False
    gpu_device_id: int = 0
    random_seed: int = 0
    allow_sliding: bool = True


@dataclass
class Configuration:
    """A simulator's settings and its agents'."""

    sim_cfg: SimulatorConfiguration
    agents: list[AgentConfiguration] = field(default_factory=lambda: [AgentConfiguration()])


class Simulator:
    """Sound in one scene; what habitat-sim's `Simulator` does about it. `pathfinder`: where agent 0 can walk."""

    def __init__(self, config: Configuration) -> None:
        self.config = config
        with as_runtime_errors():
            # as the engine of SoundSpaces 2 has it: what is open stays open
            self.scene = find_scene(config.sim_cfg.scene_id, config.sim_cfg.scene_dataset_config_file)
        self.agents = [Agent(agent) for agent in config.agents]
        size = (config.agents or [AgentConfiguration()])[0]
        self.pathfinder = PathFinder(self.scene, size.height, size.radius)

    def __enter__(self) -> Simulator:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self, destroy: bool = True) -> None:
        """Let go of what the sensors hold."""
        del destroy
        for agent in self.agents:
            for sensor in agent.sensors.values():
                sensor.reset()

    def seed(self, new_seed: int) -> None:
        """Seed what is drawn by chance: the pathfinder's points. Sound has no chance in it."""
        self.pathfinder.seed(new_seed)

    def get_agent(self, agent_id: int) -> Agent:
        """An agent by number. Raises `RlrError`."""
        return pick(self.agents, agent_id, "agent")

    def initialize_agent(self, agent_id: int, initial_state: AgentState | None = None) -> Agent:
        """Put an agent where `initial_state` says."""
        agent = self.get_agent(agent_id)
        if initial_state is not None:
            agent.set_state(initial_state)
        return agent

    def add_sensor(self, sensor_spec: AudioSensorSpec, agent_id: int = 0) -> None:
        """Give an agent an audio sensor."""
        self.get_agent(agent_id).add_sensor(sensor_spec)

    def get_sensor_observations(self, agent_ids: int = 0) -> dict[str, np.ndarray]:
        """(channels, samples) float32 response of each sensor of an agent, by its name."""
        agent = self.get_agent(agent_ids)
        return {name: self._observe(sensor, agent) for name, sensor in agent.sensors.items()}

    def _observe(self, sensor: AudioSensor, agent: Agent) -> np.ndarray:
        turn = as_wxyz(agent.state.rotation, "AgentState.rotation")
        sensor.setAudioListenerTransform(sensor.node.absolute_translation, turn)
        sensor.runSimulation(self)
        return sensor.getIR()
