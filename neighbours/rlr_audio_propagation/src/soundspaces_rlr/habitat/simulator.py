"""`Simulator`: a scene, agents in it, what they hear and see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from soundspaces_rlr.arguments import pick
from soundspaces_rlr.errors import RlrError, as_runtime_errors
from soundspaces_rlr.habitat.agent import Agent, AgentConfiguration, AgentState
from soundspaces_rlr.habitat.controls import ActionSpec
from soundspaces_rlr.habitat.floor import NavMeshSettings
from soundspaces_rlr.habitat.follower import GreedyGeodesicFollower
from soundspaces_rlr.habitat.pathfinder import PathFinder
from soundspaces_rlr.habitat.refused import RefusedObject
from soundspaces_rlr.habitat.rotations import quat_from_angle_axis
from soundspaces_rlr.habitat.scenes import find_scene, vertex_colors
from soundspaces_rlr.habitat.semantic import SemanticScene
from soundspaces_sim import Scene


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
    requires_textures: bool = True
    default_agent_id: int = 0
    frustum_culling: bool = True
    random_seed: int = 0
    allow_sliding: bool = True
    navmesh_settings: NavMeshSettings | None = None  # None: by the size of agent 0
    physics_config_file: str = ""
    leave_context_with_background_renderer: bool = False
    enable_hbao: bool = False
    enable_gfx_replay_save: bool = False


@dataclass
class Configuration:
    """A simulator's settings and its agents'."""

    sim_cfg: SimulatorConfiguration
    agents: list[AgentConfiguration] = field(default_factory=lambda: [AgentConfiguration()])
    enable_batch_renderer: bool = False


class Simulator:
    """One scene, agents in it, what they hear and see; what habitat-sim's `Simulator` does about it. `pathfinder`:
    where agent 0 can walk; `random`: what `seed` seeds."""

    def __init__(self, config: Configuration) -> None:
        self._prepare(config)

    def _prepare(self, config: Configuration) -> None:
        self.config = config
        backend = config.sim_cfg
        for name, asked in (
            ("SimulatorConfiguration.enable_gfx_replay_save", backend.enable_gfx_replay_save),
            ("Configuration.enable_batch_renderer", config.enable_batch_renderer),
        ):
            if asked:
                raise RlrError(f"{name}: there is no renderer here")
        with as_runtime_errors():
            # as the engine of SoundSpaces 2 has it: what is open stays open
            self.scene = find_scene(backend.scene_id, backend.scene_dataset_config_file)
        for made in ("semantic_scene", "vertex_colors"):
            vars(self).pop(made, None)
        self.agents = [Agent(agent) for agent in config.agents]
        size = (config.agents or [AgentConfiguration()])[0]
        self.pathfinder = PathFinder(self.scene, size.height, size.radius, backend.navmesh_settings)
        self.random = np.random.default_rng(backend.random_seed)
        self.pathfinder.seed(backend.random_seed)

    def reconfigure(self, config: Configuration) -> None:
        """Go on in another scene or with other agents, as if made anew."""
        self.close()
        self._prepare(config)

    @property
    def sensors(self) -> dict[str, Any]:
        """The sensors of the default agent by name."""
        return self.get_agent(self.config.sim_cfg.default_agent_id).sensors

    @property
    def _sensors(self) -> dict[str, Any]:
        return self.sensors  # the name that older clients use

    def get_sensor(self, uuid: str) -> Any:
        """A sensor of the default agent by name. Raises `RlrError`."""
        if uuid not in self.sensors:
            raise RlrError(f"no sensor {uuid!r}: expected one of {sorted(self.sensors)}")
        return self.sensors[uuid]

    def remove_sensor(self, uuid: str) -> None:
        """Take a sensor of the default agent away. Raises `RlrError`."""
        self.get_sensor(uuid)
        self.get_agent(self.config.sim_cfg.default_agent_id).remove_sensor(uuid)

    def step_physics(self, dt: float, scene_id: int = 0) -> None:
        """Let time go by: nothing moves of itself, so nothing changes. habitat-lab calls it after each action."""

    def get_object_template_manager(self) -> RefusedObject:
        """Habitat's way to objects, which there are none of; what is asked of it is an error."""
        return RefusedObject("Simulator.get_object_template_manager()")

    def get_rigid_object_manager(self) -> RefusedObject:
        """Likewise."""
        return RefusedObject("Simulator.get_rigid_object_manager()")

    def get_articulated_object_manager(self) -> RefusedObject:
        """Likewise."""
        return RefusedObject("Simulator.get_articulated_object_manager()")

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

    @cached_property
    def semantic_scene(self) -> SemanticScene:
        """The scene's labels as things with boxes."""
        return SemanticScene(self.scene)

    @cached_property
    def vertex_colors(self) -> np.ndarray | None:
        """(V, 3) 0 to 255 of the scene's vertices, or None where its file has none."""
        with as_runtime_errors():
            return vertex_colors(self.config.sim_cfg.scene_id, self.scene)

    @property
    def semantic_annotations(self) -> SemanticScene:
        """`semantic_scene`, by its former name."""
        return self.semantic_scene

    @property
    def action_space(self) -> dict[Any, ActionSpec]:
        """What agent 0 can do, by key."""
        return self.get_agent(0).agent_config.action_space

    def seed(self, new_seed: int) -> None:
        """Seed what is drawn by chance: the pathfinder's points and starts. Sound has no chance in it."""
        self.random = np.random.default_rng(new_seed)
        self.pathfinder.seed(new_seed)

    def get_agent(self, agent_id: int) -> Agent:
        """An agent by number. Raises `RlrError`."""
        return pick(self.agents, agent_id, "agent")

    def initialize_agent(self, agent_id: int, initial_state: AgentState | None = None) -> Agent:
        """Put an agent where `initial_state` says, or anywhere on the floor; `reset` brings it back there."""
        agent = self.get_agent(agent_id)
        if initial_state is None:
            initial_state = AgentState()
            if self.pathfinder.is_loaded:
                initial_state.position = self.pathfinder.get_random_navigable_point()
                heading = float(self.random.uniform(0.0, 2.0 * np.pi))
                initial_state.rotation = quat_from_angle_axis(heading, [0.0, 1.0, 0.0])
        agent.set_state(initial_state, is_initial=True)
        return agent

    def reset(self, agent_ids: int | list[int] | None = None) -> Any:
        """Bring all agents back to where they began; what agent 0, or each of a list of agents, hears and sees."""
        for agent in self.agents:
            agent.set_state(agent.initial_state)
        return self.get_sensor_observations(0 if agent_ids is None else agent_ids)

    def step(self, action: Any, dt: float = 1.0 / 60.0) -> dict[Any, Any]:
        """Let agent 0 do an action, or each agent of a mapping its own; what is heard and seen then, and
        `collided`: whether it met a wall. `dt` is habitat's physics; there is none."""
        del dt
        each = action if isinstance(action, Mapping) else {0: action}
        met = {i: self.get_agent(i).act(key, self.step_filter) for i, key in each.items()}
        seen: dict[Any, Any] = {i: self.get_sensor_observations(i) for i in each}
        for i, observations in seen.items():
            observations["collided"] = met[i]
        return seen if isinstance(action, Mapping) else seen[0]

    def step_filter(self, start_pos: Any, end_pos: Any) -> Any:
        """(3,) how far one gets from a place to another; `SimulatorConfiguration.allow_sliding` says whether along
        walls."""
        if not self.pathfinder.is_loaded:
            return end_pos
        paths = self.pathfinder
        step = paths.try_step if self.config.sim_cfg.allow_sliding else paths.try_step_no_sliding
        return step(start_pos, end_pos)

    def make_greedy_follower(
        self, agent_id: int = 0, goal_radius: float | None = None, **keys: Any
    ) -> GreedyGeodesicFollower:
        """What takes an agent to places; `keys`: those of `GreedyGeodesicFollower`."""
        return GreedyGeodesicFollower(self.pathfinder, self.get_agent(agent_id), goal_radius, **keys)

    def recompute_navmesh(
        self,
        pathfinder: PathFinder,
        navmesh_settings: NavMeshSettings,
        include_static_objects: bool = False,
    ) -> bool:
        """Find the floor for an agent of another size; whether there is any."""
        del include_static_objects  # all is one scene
        return pathfinder.remake(navmesh_settings)

    def add_sensor(self, sensor_spec: Any, agent_id: int | None = None) -> None:
        """Give an agent, or agent 0, a sensor."""
        self.get_agent(agent_id or 0).add_sensor(sensor_spec)

    def get_sensor_observations(self, agent_ids: int | list[int] = 0) -> Any:
        """What each sensor of an agent gives, by its name: responses (channels, samples) float32, pictures; of a
        list of agents, that for each."""
        if not isinstance(agent_ids, int):
            return {i: self.get_sensor_observations(i) for i in agent_ids}
        agent = self.get_agent(agent_ids)
        return {name: sensor.get_observation(self) for name, sensor in agent.sensors.items()}


#: Under habitat's other name for what the simulator is built on; here there is one class.
SimulatorBackend = Simulator
