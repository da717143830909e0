"""The calls of SoundSpaces 2's quick tutorial, on both of its data sets."""

import os

import habitat_sim.sim
import numpy as np
from scipy.signal import fftconvolve

SCENES = {
    "mp3d": ("mp3d/UwV83HsGsw3/UwV83HsGsw3", "mp3d/mp3d"),
    "gibson": ("gibson/Oyens", "gibson/gibson_semantic"),
}

for scene, dataset in SCENES.values():
    backend_cfg = habitat_sim.SimulatorConfiguration()
    backend_cfg.scene_id = f"data/scene_datasets/{scene}.glb"
    backend_cfg.scene_dataset_config_file = f"data/scene_datasets/{dataset}.scene_dataset_config.json"
    backend_cfg.load_semantic_mesh, backend_cfg.enable_physics = True, False
    agent_config = habitat_sim.AgentConfiguration()
    sim = habitat_sim.Simulator(habitat_sim.Configuration(backend_cfg, [agent_config]))
    sim.pathfinder.load_nav_mesh(os.path.join(f"data/scene_datasets/{scene}.navmesh"))

    spec = habitat_sim.AudioSensorSpec()
    spec.uuid, spec.enableMaterials = "audio_sensor", True
    spec.channelLayout.type = habitat_sim.sensor.RLRAudioPropagationChannelLayoutType.Binaural
    spec.channelLayout.channelCount = 1
    spec.position = [0.0, 1.5, 0.0]
    spec.acousticsConfig.sampleRate, spec.acousticsConfig.indirect = 48000, True
    sim.add_sensor(spec)
    audio_sensor = sim.get_agent(0)._sensors["audio_sensor"]
    audio_sensor.setAudioMaterialsJSON("data/mp3d_material_config.json")

    source_pos = sim.pathfinder.get_random_navigable_point()
    audio_sensor.setAudioSourceTransform(source_pos + np.array([0, 1.5, 0]))
    agent = sim.get_agent(0)
    new_state = sim.get_agent(0).get_state()
    new_state.position = np.array(source_pos + np.array([2, 0, 0]))
    new_state.sensor_states = {}
    agent.set_state(new_state, True)
    ir = np.array(sim.get_sensor_observations()["audio_sensor"])
    assert ir.shape[0] == 2 and np.isfinite(ir).all() and ir.any()
    assert isinstance(audio_sensor.sourceIsVisible(), bool)
    assert 0.9 < audio_sensor.getRayEfficiency() <= 1.0
    dry = np.random.default_rng(0).standard_normal(4800)
    assert np.array([fftconvolve(dry, channel) for channel in ir]).shape == (2, 4799 + ir.shape[1])
    sim.close()
