"""The calls of checks before a large run: what the build has, what a pair costs, what the engine saw of the scene."""

import habitat_sim
import numpy as np
import trimesh

clt = habitat_sim.sensor.RLRAudioPropagationChannelLayoutType
assert habitat_sim.audio_enabled and clt.Binaural != clt.Mono
wanted = "sourceIsVisible getRayEfficiency setListenerHRTF writeIRWave writeSceneMeshOBJ reset".split()
assert all(hasattr(habitat_sim.AudioSensor, name) for name in wanted)
spec = habitat_sim.AudioSensorSpec()
fields = {
    n: getattr(spec.acousticsConfig, n) for n in dir(spec.acousticsConfig) if not n.startswith("_")
}
assert fields["maxIRLength"] == 4.0 and fields["directRayCount"] == 500
try:
    spec.acousticsConfig.noSuchField = 1
except AttributeError:
    pass
else:
    raise SystemExit("a field that there is not was taken")

backend = habitat_sim.SimulatorConfiguration()
backend.scene_id = "data/scene_datasets/gibson/Oyens.glb"
sim = habitat_sim.Simulator(habitat_sim.Configuration(backend, [habitat_sim.agent.AgentConfiguration()]))
sim.seed(7)
spec.uuid, spec.enableMaterials = "audio_sensor", False
spec.channelLayout.type, spec.channelLayout.channelCount = clt.Binaural, 2
spec.acousticsConfig.sampleRate = 16000
sim.add_sensor(spec)
agent, sensor = sim.get_agent(0), sim.get_agent(0)._sensors["audio_sensor"]
listener = sim.pathfinder.get_random_navigable_point()
source = sim.pathfinder.get_random_navigable_point_near(listener, 3.0)
path = habitat_sim.ShortestPath()
path.requested_start, path.requested_end = listener, source
assert sim.pathfinder.find_path(path) and np.isfinite(path.geodesic_distance)
rows = []
for _ in range(2):
    sensor.reset()
    state = agent.get_state()
    state.position, state.sensor_states = listener, {}
    agent.set_state(state, True)
    sensor.setAudioSourceTransform(np.asarray(source) + np.array([0.0, 1.5, 0.0]))
    rows.append(np.asarray(sim.get_sensor_observations()["audio_sensor"], dtype="<f4"))
assert np.isfinite(rows[0]).all() and rows[0].tobytes() == rows[1].tobytes()
assert sensor.writeIRWave("pair.wav") is True and sensor.writeSceneMeshOBJ("scene.obj") is True
seen = trimesh.load("scene.obj")
np.testing.assert_allclose(seen.bounds[:, 1], [0.0, 2.8], atol=1e-6)
assert sensor.getRayEfficiency() > 0.95
