"""The calls of SoundSpaces' examples/minimal_example.py: a source and an agent at given places of a scene."""

import habitat_sim.sim
import numpy as np
from scipy.io import wavfile

backend_cfg = habitat_sim.SimulatorConfiguration()
backend_cfg.scene_id = "data/scene_datasets/mp3d/UwV83HsGsw3/UwV83HsGsw3.glb"
backend_cfg.scene_dataset_config_file = "data/scene_datasets/mp3d/mp3d.scene_dataset_config.json"
backend_cfg.load_semantic_mesh = True
backend_cfg.enable_physics = False
sim = habitat_sim.Simulator(habitat_sim.Configuration(backend_cfg, [habitat_sim.AgentConfiguration()]))

spec = habitat_sim.AudioSensorSpec()
spec.uuid = "audio_sensor"
spec.enableMaterials = True
spec.channelLayout.type = habitat_sim.sensor.RLRAudioPropagationChannelLayoutType.Mono
spec.channelLayout.channelCount = 1
spec.position = [0.0, 1.5, 0.0]
spec.acousticsConfig.sampleRate = 16000
spec.acousticsConfig.indirect = True
sim.add_sensor(spec)

sensor = sim.get_agent(0)._sensors["audio_sensor"]
source, listener = np.array([-8.56, 1.5, 0.50]), np.array([-10.57, 0, -0.25])
sensor.setAudioSourceTransform(source)
sensor.setAudioMaterialsJSON("data/mp3d_material_config.json")
state = sim.get_agent(0).get_state()
state.position, state.sensor_states = listener, {}
sim.get_agent(0).set_state(state, True)
obs = np.array(sim.get_sensor_observations()["audio_sensor"])
wavfile.write("output.wav", 16000, obs.T)
onset = np.flatnonzero(wavfile.read("output.wav")[1])[0]
assert abs(onset - np.linalg.norm(source - listener - [0, 1.5, 0]) / 343 * 16000) < 10
