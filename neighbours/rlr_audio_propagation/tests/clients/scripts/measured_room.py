"""The calls of studies that set many acoustic fields: Magnum's vectors, twelve bands, a loud volume, later names."""

import habitat_sim
import magnum as mn
import numpy as np

backend_cfg = habitat_sim.SimulatorConfiguration()
backend_cfg.scene_id = "data/scene_datasets/gibson/Oyens.glb"
backend_cfg.scene_dataset_config_file = (
    "data/scene_datasets/gibson/gibson_semantic.scene_dataset_config.json"
)
backend_cfg.load_semantic_mesh, backend_cfg.enable_physics = True, False
spec = habitat_sim.AudioSensorSpec()
spec.uuid, spec.enableMaterials = "audio_sensor", True
spec.channelLayout.type = habitat_sim.sensor.RLRAudioPropagationChannelLayoutType.Mono
spec.channelLayout.channelCount = 1
spec.position, spec.orientation = mn.Vector3(0.0, 0.0, 0.0), mn.Vector3(0.0, 0.0, 0.0)
for name, value in {
    "sampleRate": 48000,
    "indirect": True,
    "indirectRayCount": 5000,
    "indirectRayDepth": 300,
    "sourceRayCount": 2000,
    "directRayCount": 1000,
    "indirectSHOrder": 1,
    "globalVolume": 270.0,
    "frequencyBands": 12,
    "maxIRLength": 1.0,
}.items():
    setattr(spec.acousticsConfig, name, value)
sim = habitat_sim.Simulator(
    habitat_sim.Configuration(backend_cfg, [habitat_sim.agent.AgentConfiguration()])
)
sim.add_sensor(spec)
agent = sim.get_agent(0)
state = agent.get_state()
state.rotation = habitat_sim.utils.quat_from_angle_axis(0.0, np.array([0, 1, 0]))
state.position = mn.Vector3(-0.692150, 1.277938, 0.577850)
agent.set_state(state)
sensor = sim.get_agent(0)._sensors["audio_sensor"]
source = np.array([-0.3302, 1.1811, -0.17542])
sensor.setAudioSourceTransform(source)
sensor.setAudioMaterialsJSON("data/mp3d_material_config.json")
obs = np.array(sim.get_sensor_observations()["audio_sensor"])
distance = np.linalg.norm(source - np.asarray(state.position))
onset = int(distance / 343 * 48000)
level = np.abs(obs[0, onset - 8 : onset + 40]).sum()
assert level > 0.3 * 270.0 * 0.282 / distance and sensor.sourceIsVisible()
