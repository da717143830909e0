"""SoundSpaces 2's continuous simulator itself, from its checkout: made, reconfigured, reset and stepped, with sound.

Run in a folder with `data/scene_datasets/…` and a sound, with the checkouts of SoundSpaces and of habitat-lab 0.2.2 on
the path.
"""

import os
import pickle
from pathlib import Path

import networkx
import numpy as np
import soundfile
import soundspaces
from habitat.sims import make_sim
from ss_baselines.av_nav.config.default import get_task_config

here = Path(soundspaces.__file__).parents[1]
os.makedirs("data/sounds/1s_all", exist_ok=True)
soundfile.write(
    "data/sounds/1s_all/noise.wav", np.random.default_rng(0).standard_normal(48000) * 0.1, 16000
)
metadata = Path("data/metadata/mp3d/17DRP5sb8fy")
metadata.mkdir(parents=True, exist_ok=True)
(metadata / "points.txt").write_text("0\t0.0\t0.0\t1.5\n1\t1.0\t0.0\t1.5\n")
with open(metadata / "graph.pkl", "wb") as file:
    pickle.dump(networkx.path_graph(2), file)
config = get_task_config(str(here / "configs/audionav/av_nav/mp3d/audiogoal.yaml")).SIMULATOR
config.defrost()
config.TYPE, config.STEP_TIME, config.FORWARD_STEP_SIZE = "ContinuousSoundSpacesSim", 0.25, 0.25
config.USE_RENDERED_OBSERVATIONS, config.AUDIO.CROSSFADE = False, True
config.SCENE = "data/scene_datasets/mp3d/17DRP5sb8fy/17DRP5sb8fy.glb"
config.AGENT_0.SENSORS = ["DEPTH_SENSOR", "RGB_SENSOR"]
config.freeze()
sim = make_sim(config.TYPE, config=config)
config.defrost()
agent = config.AGENT_0
agent.START_POSITION, agent.START_ROTATION, agent.IS_SET_START_STATE = (
    [0.0, 0.0, 0.0],
    [0, 0, 0, 1],
    True,
)
agent.GOAL_POSITION, agent.SOUND_ID = [0.0, 0.0, -2.0], "noise.wav"
sim.reconfigure(config)
seen = sim.reset()
assert seen["depth"].shape == (128, 128, 1) and seen["rgb"].shape == (128, 128, 3)
heard = [sim.get_current_audiogoal_observation()]
for action in (1, 1, 2, 3):
    sim.step(action)
    heard.append(sim.get_current_audiogoal_observation())
assert all(block.shape == (2, 16000) and np.isfinite(block).all() and block.any() for block in heard)
assert not np.array_equal(heard[1], heard[2])
assert abs(sim.geodesic_distance([0.0, 0.0, 0.0], [[0.0, 0.0, -2.0]]) - 2.0) < 0.08
