"""The calls of SoundSpaces' PanoIR/render_panoIR.py: panoramas of colour and depth, then responses in another simulator."""

import json
import math

import habitat_sim
import magnum as mn
import numpy as np
from habitat_sim.utils.common import quat_from_angle_axis

SCENE = "data/scene_datasets/gibson/Oyens.glb"
ANGLES = (90, 70, 50, 30, 10, 350, 330, 310, 290)


def configuration(visual: bool) -> habitat_sim.Configuration:
    backend_cfg = habitat_sim.SimulatorConfiguration()
    backend_cfg.scene_id = SCENE
    backend_cfg.enable_physics = False
    agent_cfg = habitat_sim.agent.AgentConfiguration()
    agent_cfg.sensor_specifications = []
    if visual:
        rgb = habitat_sim.CameraSensorSpec()
        rgb.resolution, rgb.far = (384, 64), np.iinfo(np.int32).max
        depth = habitat_sim.CameraSensorSpec()
        depth.uuid, depth.resolution = "depth_camera", (384, 64)
        depth.sensor_type = habitat_sim.SensorType.DEPTH
        for spec in (rgb, depth):
            spec.hfov, spec.position = mn.Deg(20), np.array([0, 1.5, 0])
        agent_cfg.sensor_specifications = [rgb, depth]
    return habitat_sim.Configuration(backend_cfg, [agent_cfg])


def turn(sim: habitat_sim.Simulator, place: np.ndarray, degrees: float) -> None:
    state = sim.get_agent(0).get_state()
    state.position = place
    state.rotation = quat_from_angle_axis(math.radians(degrees), np.array([0, 1, 0]))
    state.sensor_states = {}
    sim.get_agent(0).set_state(state, True)


sim = habitat_sim.Simulator(configuration(visual=True))
receiver, source = (sim.pathfinder.get_random_navigable_point() for _ in range(2))
distance = np.sqrt((source[0] - receiver[0]) ** 2 + (source[2] - receiver[2]) ** 2)
json.dumps({0: (np.rad2deg(np.arctan2(source[2] - receiver[2], source[0] - receiver[0])), distance)})
colours, depths = [], []
for angle in ANGLES:
    turn(sim, receiver, angle)
    seen = sim.get_sensor_observations()
    colours.append(seen["rgba_camera"][..., :3])
    depths.append(np.clip(seen["depth_camera"], 0, 10) / 10)
sim.close()
rgb, depth = np.concatenate(colours, axis=1), np.concatenate(depths, axis=1)
assert rgb.shape == (384, 64 * len(ANGLES), 3) and depth.shape == rgb.shape[:2] and depth.min() > 0
# neighbouring pictures join: their edges are one direction, less a pixel
assert np.abs(depth[192, 63::64][:-1] - depth[192, 64::64]).max() < 0.1

sim = habitat_sim.Simulator(configuration(visual=False))
spec = habitat_sim.AudioSensorSpec()
spec.uuid, spec.enableMaterials, spec.position = "audio_sensor", False, [0.0, 1.5, 0.0]
spec.channelLayout.type = habitat_sim.sensor.RLRAudioPropagationChannelLayoutType.Mono
spec.channelLayout.channelCount = 1
sim.add_sensor(spec)
sensor = sim.get_agent(0)._sensors["audio_sensor"]
sensor.setAudioMaterialsJSON("data/mp3d_material_config.json")
sensor.setAudioSourceTransform(source)
turn(sim, receiver, 0)
assert np.array(sim.get_sensor_observations()["audio_sensor"])[0].any()
sim.close()
sim.close()
