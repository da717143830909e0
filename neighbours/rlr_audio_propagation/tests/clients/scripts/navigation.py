"""The calls of habitat-sim's navigation tutorial: look, walk at random, ask the floor, follow a way."""

import habitat_sim
import numpy as np
from habitat_sim.utils import common as utils

backend_cfg = habitat_sim.SimulatorConfiguration()
backend_cfg.scene_id = "data/scene_datasets/mp3d_example/17DRP5sb8fy/17DRP5sb8fy.glb"
backend_cfg.scene_dataset_config_file = "data/scene_datasets/mp3d_example/mp3d.scene_dataset_config.json"
agent_cfg = habitat_sim.agent.AgentConfiguration()
specs = []
for uuid in ("color", "depth", "semantic"):
    spec = habitat_sim.CameraSensorSpec()
    spec.uuid, spec.sensor_type = f"{uuid}_sensor", getattr(habitat_sim.SensorType, uuid.upper())
    spec.resolution, spec.position = [64, 64], [0.0, 1.5, 0.0]
    spec.sensor_subtype = habitat_sim.SensorSubType.PINHOLE
    specs.append(spec)
agent_cfg.sensor_specifications = specs
agent_cfg.action_space = {
    "move_forward": habitat_sim.agent.ActionSpec(
        "move_forward", habitat_sim.agent.ActuationSpec(amount=0.25)
    ),
    "turn_left": habitat_sim.agent.ActionSpec("turn_left", habitat_sim.agent.ActuationSpec(amount=30.0)),
    "turn_right": habitat_sim.agent.ActionSpec(
        "turn_right", habitat_sim.agent.ActuationSpec(amount=30.0)
    ),
}
cfg = habitat_sim.Configuration(backend_cfg, [agent_cfg])
sim = habitat_sim.Simulator(cfg)
scene = sim.semantic_scene
categories = {
    obj.category.name() for level in scene.levels for region in level.regions for obj in region.objects
}
assert categories == {"void", "wall", "chair", "sofa"} and len(scene.objects) == 7
assert all(np.isfinite(obj.aabb.center).all() for obj in scene.objects)

sim.seed(1)
agent = sim.initialize_agent(0)
agent_state = habitat_sim.AgentState()
agent_state.position = np.array([-0.6, 0.0, 0.0])
agent.set_state(agent_state)
names = list(cfg.agents[0].action_space.keys())
draw = np.random.default_rng(1)
for _ in range(20):
    observations = sim.step(names[draw.integers(len(names))])
    assert observations["color_sensor"].shape == (64, 64, 4)
    assert set(np.unique(observations["semantic_sensor"])) <= set(range(7))
    assert sim.pathfinder.is_navigable(agent.get_state().position)

point = sim.pathfinder.get_random_navigable_point()
assert sim.pathfinder.is_navigable(point) and sim.pathfinder.island_radius(point) > 2
view = sim.pathfinder.get_topdown_view(0.1, sim.pathfinder.get_bounds()[0][1])
assert 0.5 < view.mean() < 1
settings = habitat_sim.NavMeshSettings()
settings.set_defaults()
settings.agent_radius, area = 0.4, sim.pathfinder.navigable_area
assert sim.recompute_navmesh(sim.pathfinder, settings) and sim.pathfinder.navigable_area < area

agent_state.position = np.array([-9.0, 0.0, 0.0])
agent_state.rotation = utils.quat_from_angle_axis(1.0, np.array([0, 1, 0]))
agent.set_state(agent_state)
goal = np.array([5.0, 0.0, 3.0])
follower = sim.make_greedy_follower(0, goal_radius=0.3)
for _ in range(200):
    action = follower.next_action_along(goal)
    if action is None:
        break
    agent.act(action)
assert np.linalg.norm(agent.state.position - goal) < 0.5
