"""A stand-in for a habitat-sim built without audio: as much of its `Simulator` as `habitat.attach` meets.

Written from its documentation and source (releases 0.2.2 to 0.3.4, and the source of May 2026), not copied: agents on nodes
of a scene graph in single precision, as Magnum's are; cameras on nodes below them; observations by sensor, of one
agent or of a list; `step` and `reset` that observe; pictures begun and read later; another stage by `reconfigure`.
A picture is the camera's place in the world, so that a test sees whether it moved. `BY_NAME` keeps sensors as the later
source does: one table for all agents, read by what hangs on an agent's node. It shares no code with the package.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np


class Quaternion:
    """w, x, y, z, as numpy-quaternion has them."""

    def __init__(self, w: float, x: float, y: float, z: float) -> None:
        self.w, self.x, self.y, self.z = (float(v) for v in (w, x, y, z))


def yaw(degrees: float) -> Quaternion:
    """About the axis that points up, to the left."""
    half = np.deg2rad(degrees) / 2.0
    return Quaternion(np.cos(half), 0.0, np.sin(half), 0.0)


class SceneNode:
    """A place and a turn in the frame of a parent; float32."""

    def __init__(self, parent: SceneNode | None = None) -> None:
        self.parent, self.children = parent, list[SceneNode]()
        self.matrix = np.eye(4, dtype=np.float32)
        self.turn = np.array([1.0, 0.0, 0.0, 0.0], np.float32)  # w, x, y, z
        self.subtree_sensors: dict[str, Any] = {}

    def create_child(self) -> SceneNode:
        self.children.append(SceneNode(self))
        return self.children[-1]

    def place(self, position: Any, turn: Quaternion) -> None:
        self.turn = np.array([turn.w, turn.x, turn.y, turn.z], np.float32)
        w, v = self.turn[0], self.turn[1:]
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]], np.float32)
        self.matrix[:3, :3] = np.eye(3, dtype=np.float32) + 2 * w * cross + 2 * cross @ cross
        self.matrix[:3, 3] = position

    @property
    def absolute_matrix(self) -> np.ndarray:
        return self.matrix if self.parent is None else self.parent.absolute_matrix @ self.matrix

    @property
    def absolute_translation(self) -> np.ndarray:
        return np.array(self.absolute_matrix[:3, 3])


@dataclass
class CameraSensorSpec:
    uuid: str = "color"
    position: Any = (0.0, 1.5, 0.0)


class AudioSensorSpec:
    """Nothing can be set, and a simulator cannot take one."""

    uuid = "audio"


@dataclass
class ActuationSpec:
    amount: float


@dataclass
class ActionSpec:
    name: str
    actuation: ActuationSpec


def _actions() -> dict[str, ActionSpec]:
    return {
        name: ActionSpec(name, ActuationSpec(amount))
        for name, amount in (("move_forward", 0.25), ("turn_left", 10.0), ("turn_right", 10.0))
    }


@dataclass
class AgentConfiguration:
    sensor_specifications: list[Any] = field(default_factory=list)
    action_space: dict[str, ActionSpec] = field(default_factory=_actions)


@dataclass
class AgentState:
    position: Any = field(default_factory=lambda: np.zeros(3))
    rotation: Any = field(default_factory=lambda: Quaternion(1.0, 0.0, 0.0, 0.0))


class Agent:
    def __init__(self, scene_node: SceneNode, agent_config: AgentConfiguration) -> None:
        self.scene_node, self.agent_config = scene_node, agent_config
        self.initial_state: AgentState | None = None
        for spec in agent_config.sensor_specifications:
            self.hang(spec)

    def hang(self, spec: Any) -> None:
        node = self.scene_node.create_child()
        node.place(spec.position, Quaternion(1.0, 0.0, 0.0, 0.0))
        self.scene_node.subtree_sensors[spec.uuid] = node

    def get_state(self) -> AgentState:
        return AgentState(self.scene_node.absolute_translation, Quaternion(*self.scene_node.turn))

    def set_state(self, state: AgentState, is_initial: bool = False) -> None:
        self.scene_node.place(state.position, state.rotation)
        if is_initial:
            self.initial_state = state

    def act(self, action_id: str) -> bool:
        action = self.agent_config.action_space[action_id]
        node, amount = self.scene_node, action.actuation.amount
        if action.name == "move_forward":
            node.place(node.matrix[:3, 3] - amount * node.matrix[:3, 2], Quaternion(*node.turn))
            return False
        more = yaw(amount if action.name == "turn_left" else -amount)
        w, x, y, z = node.turn
        turned = Quaternion(
            w * more.w - y * more.y, x * more.w - z * more.y, y * more.w + w * more.y, z * more.w + x * more.y
        )  # fmt: skip
        node.place(node.matrix[:3, 3], turned)
        return False


@dataclass
class SimulatorConfiguration:
    scene_id: str = ""
    scene_dataset_config_file: str = "default"
    default_agent_id: int = 0


@dataclass
class Configuration:
    sim_cfg: SimulatorConfiguration
    agents: list[AgentConfiguration]


class _Camera:
    """What draws, and is read later."""

    def __init__(self, node: SceneNode) -> None:
        self.node, self.buffer = node, np.zeros(3)

    def draw(self) -> None:
        self.buffer = self.node.absolute_translation

    def read(self) -> np.ndarray:
        return self.buffer


class Simulator:
    """`BY_NAME` is set by tests: where it keeps its sensors."""

    BY_NAME = False

    def __init__(self, config: Configuration) -> None:
        self._set(config)

    def _set(self, config: Configuration) -> None:
        root = SceneNode()
        self.config = config
        self.agents = [Agent(root.create_child(), agent) for agent in config.agents]
        self.__sensors: list[dict[str, _Camera]] = [{} for _ in config.agents]
        self._sensor_registry: dict[str, _Camera] = {}
        self._async_draw_agent_ids: int | list[int] | None = None
        for i, agent in enumerate(self.agents):
            for uuid, node in agent.scene_node.subtree_sensors.items():
                self._keep(i, uuid, node)
            agent.set_state(AgentState(), is_initial=True)

    def _keep(self, number: int, uuid: str, node: SceneNode) -> None:
        where = self._sensor_registry if self.BY_NAME else self.__sensors[number]
        where[uuid] = _Camera(node)

    def _cameras(self, number: int) -> dict[str, _Camera]:
        if not self.BY_NAME:
            return self.__sensors[number]
        on_it = self.agents[number].scene_node.subtree_sensors
        return {uuid: self._sensor_registry[uuid] for uuid in on_it if uuid in self._sensor_registry}

    def reconfigure(self, config: Configuration) -> None:
        if config != self.config:
            self._set(config)

    def __enter__(self) -> Simulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.agents = []

    def get_agent(self, agent_id: int) -> Agent:
        return self.agents[agent_id]

    def initialize_agent(self, agent_id: int, initial_state: AgentState) -> Agent:
        self.agents[agent_id].set_state(initial_state, is_initial=True)
        return self.agents[agent_id]

    def add_sensor(self, sensor_spec: Any, agent_id: int | None = None) -> None:
        if isinstance(sensor_spec, AudioSensorSpec):
            raise SystemExit("the process ends here")
        number = self.config.sim_cfg.default_agent_id if agent_id is None else agent_id
        agent = self.agents[number]
        agent.agent_config.sensor_specifications.append(sensor_spec)
        agent.hang(sensor_spec)
        self._keep(number, sensor_spec.uuid, agent.scene_node.subtree_sensors[sensor_spec.uuid])

    def reset(self, agent_ids: list[int] | None = None) -> Any:
        for agent in self.agents:
            assert agent.initial_state is not None
            agent.set_state(agent.initial_state, is_initial=True)
        number = self.config.sim_cfg.default_agent_id
        seen = self.get_sensor_observations(agent_ids=[number] if agent_ids is None else agent_ids)
        return seen[number] if agent_ids is None else seen

    def step(self, action: Any) -> Any:
        number = self.config.sim_cfg.default_agent_id
        each = action if isinstance(action, dict) else {number: action}
        met = {i: self.get_agent(i).act(a) for i, a in each.items()}
        seen = self.get_sensor_observations(agent_ids=list(each))
        for i, observations in seen.items():
            observations["collided"] = met[i]
        return seen if isinstance(action, dict) else seen[number]

    def get_sensor_observations(self, agent_ids: int | list[int] = 0) -> Any:
        numbers = [agent_ids] if isinstance(agent_ids, int) else agent_ids
        for i in numbers:
            for camera in self._cameras(i).values():
                camera.draw()
        seen = {i: {uuid: camera.read() for uuid, camera in self._cameras(i).items()} for i in numbers}
        return seen[numbers[0]] if isinstance(agent_ids, int) else seen

    def start_async_render(self, agent_ids: int | list[int] = 0) -> None:
        self._async_draw_agent_ids = agent_ids
        for i in [agent_ids] if isinstance(agent_ids, int) else agent_ids:
            for camera in self._cameras(i).values():
                camera.draw()

    def get_sensor_observations_async_finish(self) -> Any:
        agent_ids = self._async_draw_agent_ids
        if agent_ids is None:
            raise RuntimeError("nothing was begun")
        self._async_draw_agent_ids = None
        numbers = [agent_ids] if isinstance(agent_ids, int) else agent_ids
        seen = {i: {uuid: camera.read() for uuid, camera in self._cameras(i).items()} for i in numbers}
        return seen[numbers[0]] if isinstance(agent_ids, int) else seen
