"""The calls of habitat-sim's examples/tutorials/audio_agent.py: records made apart from the specification."""

import habitat_sim
import habitat_sim.sensor
import habitat_sim.sim
import numpy as np

backend_cfg = habitat_sim.SimulatorConfiguration()
backend_cfg.scene_id = "data/scene_datasets/mp3d_example/17DRP5sb8fy/17DRP5sb8fy.glb"
backend_cfg.scene_dataset_config_file = "data/scene_datasets/mp3d_example/mp3d.scene_dataset_config.json"
backend_cfg.load_semantic_mesh, backend_cfg.enable_physics = True, False
with habitat_sim.Simulator(
    habitat_sim.Configuration(backend_cfg, [habitat_sim.AgentConfiguration()])
) as sim:
    acoustics_config = habitat_sim.sensor.RLRAudioPropagationConfiguration()
    acoustics_config.enableMaterials = True
    channel_layout = habitat_sim.sensor.RLRAudioPropagationChannelLayout()
    channel_layout.channelType = habitat_sim.sensor.RLRAudioPropagationChannelLayoutType.Binaural
    channel_layout.channelCount = 2
    spec = habitat_sim.AudioSensorSpec()
    spec.uuid, spec.outputDirectory = "audio_sensor", "AudioSimulation"
    spec.acousticsConfig, spec.channelLayout = acoustics_config, channel_layout
    sim.add_sensor(spec)
    sensor = sim.get_agent(0).sensors["audio_sensor"]
    sensor.setAudioSourceTransform(np.array([3.1035, 1.57245, -4.15972]))
    sensor.setAudioMaterialsJSON(
        "src/deps/rlr-audio-propagation/RLRAudioPropagationPkg/data/mp3d_material_config.json"
    )
    obs = sim.get_sensor_observations()["audio_sensor"]
    assert len(obs) == 2 and obs.any()
