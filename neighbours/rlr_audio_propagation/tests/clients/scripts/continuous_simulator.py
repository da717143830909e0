"""The calls of SoundSpaces' continuous simulator: an agent that acts and hears, step by step, between resets."""

import habitat_sim
import numpy as np
from habitat_sim.utils.common import quat_from_angle_axis, quat_from_coeffs, quat_to_angle_axis
from scipy.signal import fftconvolve

sim_config = habitat_sim.SimulatorConfiguration()
assert hasattr(sim_config, "scene_id")
sim_config.scene_id = "data/scene_datasets/gibson/Oyens.glb"
sim_config.enable_physics = False
agent_config = habitat_sim.AgentConfiguration()
depth = habitat_sim.CameraSensorSpec()
depth.uuid, depth.sensor_type, depth.resolution = "depth", habitat_sim.SensorType.DEPTH, [32, 32]
depth.gpu2gpu_transfer = False
agent_config.sensor_specifications = [depth]
agent_config.action_space = {
    0: habitat_sim.ActionSpec("stop"),
    1: habitat_sim.ActionSpec("move_forward", habitat_sim.ActuationSpec(amount=0.25)),
    2: habitat_sim.ActionSpec("turn_left", habitat_sim.ActuationSpec(amount=10)),
    3: habitat_sim.ActionSpec("turn_right", habitat_sim.ActuationSpec(amount=10)),
}
sim = habitat_sim.Simulator(config=habitat_sim.Configuration(sim_config, [agent_config]))
spec = habitat_sim.AudioSensorSpec()
spec.uuid, spec.enableMaterials = "audio_sensor", False
spec.channelLayout.type = habitat_sim.sensor.RLRAudioPropagationChannelLayoutType.Binaural
spec.channelLayout.channelCount = 2
spec.acousticsConfig.sampleRate = 16000
spec.acousticsConfig.threadCount = 1
spec.acousticsConfig.indirectRayCount = 500
spec.acousticsConfig.temporalCoherence = True
spec.acousticsConfig.transmission = True
sim.add_sensor(spec)


def place(position: list[float], rotation: list[float]) -> None:
    agent, state = sim.get_agent(0), sim.get_agent(0).get_state()
    state.position, state.rotation, state.sensor_states = position, rotation, {}
    agent.set_state(state, True)


sensor = sim.get_agent(0)._sensors["audio_sensor"]
sensor.setAudioSourceTransform(np.array([4.0, 0.0, 1.0]) + np.array([0, 1.5, 0]))
sim.reset()
place([0.0, 0.0, 0.0], [0, 0, 0, 1])
sim_obs = sim.get_sensor_observations()
angle, axis = quat_to_angle_axis(
    quat_from_coeffs([0, 1, 0, 1]) * quat_from_angle_axis(0.0, np.array([0, 1, 0]))
)
assert np.isclose(angle, np.pi / 2) and np.allclose(axis, [0, 1, 0])
sound, heard = np.random.default_rng(0).standard_normal(16000), []
for action in (1, 2, 1, 3):
    previous = np.transpose(np.array(sim_obs["audio_sensor"]))
    sim_obs = sim.step(action)
    assert sim_obs["collided"] is False and sim_obs["depth"].shape == (32, 32)
    heard.append(np.array([fftconvolve(sound, previous[:, ear]) for ear in range(2)]))
moved = sim.get_agent(0).get_state()
assert np.isclose(np.linalg.norm(moved.position), 0.25 * 2 * np.cos(np.radians(5)), atol=1e-6)
assert not np.array_equal(heard[0], heard[1])
