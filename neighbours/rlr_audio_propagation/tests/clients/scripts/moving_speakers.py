"""The calls of SonicSim: cameras, ambisonics of 32 bands, a grid over the floor, an array capsule by capsule."""

import math

import habitat_sim.sim
import numpy as np
from habitat_sim.utils import quat_from_angle_axis

ROOM = "17DRP5sb8fy"


def simulator(visual: bool) -> habitat_sim.Simulator:
    backend_cfg = habitat_sim.SimulatorConfiguration()
    backend_cfg.scene_id = f"mp3d/{ROOM}/{ROOM}.glb"
    backend_cfg.scene_dataset_config_file = "SonicSet/material/mp3d.scene_dataset_config.json"
    backend_cfg.load_semantic_mesh, backend_cfg.enable_physics = True, False
    agent_config = habitat_sim.AgentConfiguration()
    if visual:
        for uuid, kind in (("color_sensor", "COLOR"), ("depth_sensor", "DEPTH")):
            spec = habitat_sim.CameraSensorSpec()
            spec.uuid, spec.sensor_type = uuid, getattr(habitat_sim.SensorType, kind)
            spec.resolution, spec.position, spec.hfov = [64, 32], [0.0, 1.5, 0.0], 90.0
            spec.sensor_subtype = habitat_sim.SensorSubType.PINHOLE
            agent_config.sensor_specifications.append(spec)
    sim = habitat_sim.Simulator(habitat_sim.Configuration(backend_cfg, [agent_config]))
    sim.pathfinder.load_nav_mesh(f"mp3d/{ROOM}/{ROOM}.navmesh")
    sim.seed(47)
    return sim


def stand(sim: habitat_sim.Simulator, position: np.ndarray, degrees: float) -> None:
    state = sim.get_agent(0).get_state()
    state.position = np.array(position + np.array([0, 0.0, 0]))
    state.rotation = quat_from_angle_axis(math.radians(degrees), np.array([0, 1.0, 0]))
    state.rotation *= quat_from_angle_axis(math.radians(0), np.array([1.0, 0, 0]))
    state.sensor_states = {}
    sim.get_agent(0).set_state(state, True)


def response(place: np.ndarray, kind: str, channels: int) -> np.ndarray:
    sim = simulator(visual=False)
    stand(sim, place, 90)
    spec = habitat_sim.AudioSensorSpec()
    spec.uuid, spec.enableMaterials, spec.position = "audio_sensor", True, [0.0, 1.5, 0.0]
    spec.channelLayout.type = getattr(habitat_sim.sensor.RLRAudioPropagationChannelLayoutType, kind)
    spec.channelLayout.channelCount = channels
    for name, value in {
        "sampleRate": 16000,
        "direct": True,
        "indirect": True,
        "diffraction": True,
        "transmission": True,
        "directSHOrder": 5,
        "indirectSHOrder": 3,
        "unitScale": 1,
        "frequencyBands": 32,
        "indirectRayCount": 50000,
    }.items():
        setattr(spec.acousticsConfig, name, value)
    spec.acousticsConfig.indirectRayCount = (
        1000  # the one thing that is not SonicSim's: it takes its time
    )
    sim.add_sensor(spec)
    sensor = sim.get_agent(0)._sensors["audio_sensor"]
    sensor.setAudioMaterialsJSON("SonicSet/material/mp3d_material_config.json")
    sensor.setAudioSourceTransform(np.array([-2.0, 0.0, 0.0]) + np.array([0, 1.5, 0]))
    found = np.array(sim.get_sensor_observations()["audio_sensor"])
    sim.close()
    return found


here = np.array([3.0, 0.0, 1.0])
assert response(here, "Ambisonics", 4).shape[0] == 4
capsules = [response(here + np.array([0.05 * k, 0, 0]), "Mono", 1) for k in (-1, 1)]
assert all(ir.shape[0] == 1 and ir.any() for ir in capsules)
sim = simulator(visual=True)
views = []
for angle in (0, 270, 180, 90):
    stand(sim, here, angle)
    views.append(sim.get_sensor_observations()["depth_sensor"])
assert np.concatenate(views, axis=1).shape == (64, 128)
low, high = sim.pathfinder.get_bounds()
assert sim.pathfinder.is_loaded and sim.pathfinder.navigable_area > 100
grid = [
    sim.pathfinder.snap_point(np.array([x, 0.0, z]))
    for x in (low[0], high[0])
    for z in (low[2], high[2])
]
assert np.isfinite(grid).all()
