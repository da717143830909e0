"""SAVN-CE's simulator itself, from its checkout: made, reconfigured for an episode, reset and stepped, with a goal and
a distractor that sound.

Run in a folder with `data/scene_datasets/…` and a sound, with the checkout on the path.
"""

import os
from pathlib import Path

import numpy as np
import savnce  # registers its simulator
import soundfile
from habitat.config import Config
from habitat.sims import make_sim
from savnce_baselines.magnet.config.default import get_task_config

here = Path(savnce.__file__).parents[1]
noise = np.random.default_rng(0).standard_normal(16000) * 0.1
for folder in ("goal", "distractor"):
    os.makedirs(f"data/sounds/{folder}", exist_ok=True)
    soundfile.write(f"data/sounds/{folder}/noise.wav", noise, 16000)
config = get_task_config(str(here / "configs/savnce/av_nav/mp3d/savnce_distractor.yaml")).SIMULATOR
config.defrost()
config.SCENE = "data/scene_datasets/mp3d/17DRP5sb8fy/17DRP5sb8fy.glb"
config.AUDIO.SOURCE_SOUND_DIR, config.AUDIO.DISTRACTOR_SOUND_DIR = (
    "data/sounds/goal", "data/sounds/distractor",
)  # fmt: skip
config.AGENT_0.SENSORS = ["DEPTH_SENSOR", "RGB_SENSOR"]
config.AUDIO.THREADS = 1
config.freeze()
sim = make_sim(config.TYPE, config=config)
config.defrost()
agent = config.AGENT_0
agent.START_POSITION, agent.START_ROTATION, agent.IS_SET_START_STATE = (
    [0.0, 0.0, 0.0],
    [0, 0, 0, 1],
    True,
)
for name, value in {
    "GOAL_POSITION": [0.0, 0.0, -2.0], "DISTRACTOR_POSITION": [3.0, 0.0, 0.0], "SOUND_ID": "noise.wav",
    "DISTRACTOR_SOUND_ID": "noise.wav", "ONSET": 0.0, "OFFSET": 5.0, "DURATION": 5.0,
}.items():  # fmt: skip
    setattr(agent, name, value)
assert isinstance(config, Config)
sim.reconfigure(config)
seen = sim.reset()
assert seen["depth"].shape == (128, 128, 1) and seen["rgb"].shape == (128, 128, 3)
heard = [sim.get_current_audiogoal_observation()]
for action in (1, 1, 2, 3):
    seen = sim.step(action)
    heard.append(sim.get_current_audiogoal_observation())
assert all(block.shape == (4000, 2) and np.isfinite(block).all() and block.any() for block in heard)
assert not np.array_equal(heard[1], heard[2])
assert abs(sim.geodesic_distance([0.0, 0.0, 0.0], [[0.0, 0.0, -2.0]]) - 2.0) < 0.08
assert not sim.is_silent
