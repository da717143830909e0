"""habitat-lab itself, from its checkout: an environment of PointNav is made, reset and stepped, with our audio sensor.

Run in a folder with `data/scene_datasets/…`, with habitat-lab's package on the path.
"""

import gzip
import json
from pathlib import Path

import habitat
import habitat_sim
import numpy as np
from habitat.config import read_write
from habitat.datasets.pointnav.pointnav_dataset import PointNavDatasetV1

SCENE = "gibson/Oyens.glb"
episode = {
    "episode_id": "0", "scene_id": SCENE, "start_position": [0.0, 0.0, 0.0], "start_rotation": [0, 0, 0, 1],
    "goals": [{"position": [0.0, 0.0, -2.0], "radius": 0.2}], "shortest_paths": None,
    "info": {"geodesic_distance": 2.0},
}  # fmt: skip
split = Path("data/pointnav/train.json.gz")
split.parent.mkdir(parents=True, exist_ok=True)
split.write_bytes(gzip.compress(json.dumps({"episodes": [episode]}).encode()))
config = habitat.get_config("benchmark/nav/pointnav/pointnav_gibson.yaml")
with read_write(config):
    config.habitat.dataset.data_path = str(split)
    config.habitat.dataset.scenes_dir = "data/scene_datasets"
    config.habitat.dataset.split = "train"
    config.habitat.dataset.type = "PointNav-v1"
    for camera in config.habitat.simulator.agents.main_agent.sim_sensors.values():
        camera.width = camera.height = 32
env = habitat.Env(config=config, dataset=PointNavDatasetV1(config.habitat.dataset))
sim = env.sim
assert isinstance(sim, habitat_sim.Simulator) and type(sim).__module__.startswith("habitat.sims")
spec = habitat_sim.AudioSensorSpec()
spec.uuid, spec.acousticsConfig.sampleRate, spec.acousticsConfig.indirectRayCount = "ears", 16000, 500
sim.add_sensor(spec)
sim.get_agent(0)._sensors["ears"].setAudioSourceTransform(np.array([0.0, 1.5, -2.0]))
seen = env.reset()
assert seen["depth"].shape == (32, 32, 1) and seen["rgb"].shape == (32, 32, 3)
assert abs(seen["pointgoal_with_gps_compass"][0] - 2.0) < 1e-5
levels, distances = [], []
for action in ("move_forward", "move_forward", "turn_left", "move_forward"):
    seen = env.step(action)
    response = sim._prev_sim_obs["ears"]
    assert response.shape[0] == 2 and np.isfinite(response).all()
    levels.append(float((response**2).sum()))
    distances.append(env.get_metrics()["distance_to_goal"])
assert levels[1] > levels[0] > 0.0, levels  # nearer is louder
assert np.allclose(np.diff(distances)[:2], [-0.25, 0.0], atol=0.06), distances
env.step("stop")
assert env.episode_over and env.get_metrics()["success"] == 0.0
path = habitat_sim.MultiGoalShortestPath()
path.requested_start, path.requested_ends = [0.0, 0.0, 0.0], [[5.0, 0.0, 0.0], [0.0, 0.0, -2.0]]
assert sim.pathfinder.find_path(path) and path.closest_end_point_index == 1
env.close()
