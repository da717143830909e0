"""The calls of NVAS3D: responses of every pair of some points of the floor, each in a simulator of its own, and a map."""

import itertools

import habitat_sim.sim
import numpy as np
from habitat_sim.utils import quat_from_angle_axis

ROOM = "17DRP5sb8fy"


def scene() -> habitat_sim.Simulator:
    backend_cfg = habitat_sim.SimulatorConfiguration()
    backend_cfg.scene_id = f"./data/scene_datasets/mp3d/{ROOM}/{ROOM}.glb"
    backend_cfg.scene_dataset_config_file = "./data/scene_datasets/mp3d/mp3d.scene_dataset_config.json"
    backend_cfg.load_semantic_mesh, backend_cfg.enable_physics = True, False
    return habitat_sim.Simulator(
        habitat_sim.Configuration(backend_cfg, [habitat_sim.AgentConfiguration()])
    )


sim = scene()
top = sim.pathfinder.get_topdown_view(meters_per_pixel=0.1, height=sim.pathfinder.get_bounds()[0][1])
assert top.dtype == bool and top.any()
points = [sim.pathfinder.get_random_navigable_point() for _ in range(2)]
sim.close()
for source, receiver in itertools.product(points, repeat=2):
    sim = scene()
    spec = habitat_sim.AudioSensorSpec()
    spec.uuid, spec.enableMaterials, spec.position = "audio_sensor", True, [0.0, 1.5, 0.0]
    spec.channelLayout.type = habitat_sim.sensor.RLRAudioPropagationChannelLayoutType.Ambisonics
    spec.channelLayout.channelCount = 4
    spec.acousticsConfig.sampleRate, spec.acousticsConfig.indirectRayCount = 48000, 1000
    spec.acousticsConfig.maxIRLength = 0.5
    sim.add_sensor(spec)
    sensor = sim.get_agent(0)._sensors["audio_sensor"]
    sensor.setAudioMaterialsJSON("./data/mp3d_material_config.json")
    state = sim.get_agent(0).get_state()
    state.position = np.array(receiver)
    state.rotation = quat_from_angle_axis(np.pi / 2, np.array([0, 1.0, 0]))
    state.sensor_states = {}
    sim.get_agent(0).set_state(state, True)
    sensor.setAudioSourceTransform(source + np.array([0.0, 1.5, 0]))
    ir = np.array(sim.get_sensor_observations()["audio_sensor"])
    assert ir.shape[0] == 4 and ir.shape[1] <= 24000 and ir.any()
    sim.close()
