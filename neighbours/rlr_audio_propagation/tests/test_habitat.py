"""habitat-sim's audio sensor over this engine: code of SoundSpaces 2 runs as it is."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from soundspaces_rlr import habitat
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat.scenes import find_scene, vertex_colors

import soundspaces_sim as ss
from neighbours.rlr_audio_propagation.tests.rooms import material, write_database
from neighbours.scene_formats.tests.test_habitat_layouts import gibson
from tests.marks import ci_slow
from tests.ply import write_ply

C, RATE = 343.0, 16000


def box(labels: tuple[str, ...] = ("wall",)) -> ss.Scene:
    """6 × 5 × 2.7 m, Z up, on the origin: in habitat x 0 to 6, y 0 to 2.7, z -5 to 0."""
    mesh = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [6.0, 5.0, 2.7]])
    table = ss.MaterialTable(("any",), *(np.array(x) for x in ([1000.0], [[0.3]], [[0.5]], [[0.0]])))
    zeros = np.zeros(len(mesh.faces), int)
    return ss.Scene(mesh.vertices, mesh.faces, zeros, table, labels, zeros, name="box")


def listening(
    kind: str = "Mono", scene: ss.Scene | None = None, **settings: object
) -> tuple[habitat.Simulator, habitat.AudioSensor]:
    """A simulator with one sensor, quick settings."""
    spec = habitat.AudioSensorSpec(uuid="audio_sensor")
    spec.acousticsConfig.sampleRate, spec.acousticsConfig.indirectRayCount = RATE, 400
    spec.acousticsConfig.irTime = 0.3
    for name, value in settings.items():
        setattr(spec.acousticsConfig, name, value)
    spec.channelLayout.channelType = habitat.RLRAudioPropagationChannelLayoutType[kind]
    spec.channelLayout.channelCount = {"Mono": 1, "Binaural": 2, "Ambisonics": 4}[kind]
    sim = habitat.Simulator(habitat.Configuration(habitat.SimulatorConfiguration(scene or box())))
    sim.add_sensor(spec)
    return sim, sim.get_agent(0).sensors["audio_sensor"]


def stand(sim: habitat.Simulator, position: object, rotation: object = (0.0, 0.0, 0.0, 1.0)) -> None:
    sim.get_agent(0).set_state(habitat.AgentState(position, rotation))


def test_defaults_are_habitats() -> None:
    spec = habitat.AudioSensorSpec()
    assert (spec.uuid, list(spec.position)) == ("audio", [0.0, 1.5, 0.0])
    config = spec.acousticsConfig
    assert (config.sampleRate, config.irTime, config.globalVolume, config.transmission) == (
        44100,
        4.0,
        0.25,
        False,
    )
    assert (spec.channelLayout.channelType.name, spec.channelLayout.channelCount) == ("Binaural", 2)
    types = habitat.RLRAudioPropagationChannelLayoutType
    assert (
        " ".join(t.name for t in types)
        == "Unknown Mono Stereo Binaural Quad Surround_5_1 Surround_7_1 Ambisonics"
    )


def test_the_direct_sound_has_its_time_and_level() -> None:
    """The ear is 1.5 m above where the agent stands; 0.25 / sqrt(4 pi) / r."""
    sim, sensor = listening(indirect=False)
    stand(sim, [1.0, 0.2, -1.0])
    source = np.array([4.0, 1.2, -3.0])
    sensor.setAudioSourceTransform(source)
    ir = sim.get_sensor_observations()["audio_sensor"]
    assert (ir.dtype.name, ir.shape[0], ir.ndim) == ("float32", 1, 2)
    assert ir is sensor.getIR()
    distance = float(np.linalg.norm(source - [1.0, 1.7, -1.0]))
    first = int(np.flatnonzero(ir[0])[0])
    assert 0 <= distance / C * RATE - first <= 8
    spectrum = np.abs(np.fft.rfft(ir[0], 8192))
    band = spectrum[
        (np.fft.rfftfreq(8192, 1.0 / RATE) > 300.0) & (np.fft.rfftfreq(8192, 1.0 / RATE) < 3000.0)
    ]
    np.testing.assert_allclose(band, 0.25 * np.sqrt(1.0 / (4.0 * np.pi)) / distance, rtol=0.02)


def test_ears_turn_with_the_agent() -> None:
    """An agent looks along -z: +x is on its right. Turned left by 90 degrees it looks along -x, and -z is there."""
    sim, sensor = listening("Binaural", indirect=False)

    def ears(source: list[float], rotation: object) -> np.ndarray:
        stand(sim, [3.0, 0.0, -2.5], rotation)
        sensor.setAudioSourceTransform(source)
        return np.asarray((sim.get_sensor_observations()["audio_sensor"] ** 2).sum(axis=1))

    ahead, right = [3.0, 1.5, -4.5], [5.0, 1.5, -2.5]
    left_turn = habitat.quat_from_angle_axis(0.5 * np.pi, [0.0, 1.0, 0.0])
    for source, rotation, ratio in (
        (right, (0.0, 0.0, 0.0, 1.0), 4.0),
        (ahead, left_turn, 4.0),
        (ahead, [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)], 4.0),  # the same as [x, y, z, w]
    ):
        left_ear, right_ear = ears(source, rotation)
        assert right_ear > ratio * left_ear
    left_ear, right_ear = ears(ahead, (0.0, 0.0, 0.0, 1.0))
    assert left_ear == pytest.approx(right_ear, rel=0.15)


def test_labels_are_categories_of_the_database(tmp_path: Path) -> None:
    """A hard and a soft material for the label; switched off, the default, whatever the database holds."""
    energy = {}
    for name, absorption in (("hard", 0.02), ("soft", 0.9)):
        path = write_database(
            tmp_path / f"{name}.json", material("Plaster", absorption, labels=["wall"])
        )
        for enabled in (True, False):
            sim, sensor = listening(direct=False, enableMaterials=enabled)
            sensor.setAudioMaterialsJSON(path)
            stand(sim, [1.0, 0.0, -1.0])
            sensor.setAudioSourceTransform([4.0, 1.2, -3.0])
            energy[name, enabled] = float((sim.get_sensor_observations()["audio_sensor"] ** 2).sum())
    assert energy["hard", True] > 10.0 * energy["soft", True]
    assert energy["hard", False] == energy["soft", False]


def test_the_scene_is_prepared_once() -> None:
    sim, sensor = listening("Ambisonics")
    stand(sim, [1.0, 0.0, -1.0])
    sensor.setAudioSourceTransform([4.0, 1.2, -3.0])
    first = sim.get_sensor_observations()["audio_sensor"]
    assert sensor._context is not None
    kept = sensor._context._propagation
    stand(sim, [2.0, 0.0, -1.0])
    assert not np.array_equal(sim.get_sensor_observations()["audio_sensor"], first)
    assert sensor._context._propagation is kept
    sensor.reset()  # source and materials stay
    stand(sim, [1.0, 0.0, -1.0])
    assert np.array_equal(sim.get_sensor_observations()["audio_sensor"], first)


def test_files_of_a_simulation(tmp_path: Path) -> None:
    """As text, and cut into bands that add up to the whole."""
    import soundfile

    sim, sensor = listening("Binaural", writeIrToFile=True, dumpWaveFiles=True)
    sensor.specification().outputDirectory = str(tmp_path / "run")
    stand(sim, [1.0, 0.0, -1.0])
    sensor.setAudioSourceTransform([4.0, 1.2, -3.0])
    for number in range(2):
        ir = sim.get_sensor_observations()["audio_sensor"]
        folder = tmp_path / f"run{number}"
        table = np.loadtxt(folder / "ir1.txt")
        np.testing.assert_array_equal(table[:, 0], np.arange(ir.shape[1]))
        np.testing.assert_allclose(table[:, 1], ir[1], rtol=1e-6)
        parts = [soundfile.read(folder / f"ir_band{b}.wav")[0] for b in range(4)]
        np.testing.assert_allclose(np.sum(parts, axis=0).T, ir, atol=1e-5)


def _glb(path: Path, extents: tuple[float, float, float]) -> Path:
    """A box on the origin as its file's axes have it."""
    trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], extents]).export(path)
    return path


def _simulator(scene: Path, config: str = "default") -> habitat.Simulator:
    return habitat.Simulator(
        habitat.Configuration(
            habitat.SimulatorConfiguration(str(scene), scene_dataset_config_file=config)
        )
    )


def test_a_glb_of_matterport3d_is_what_lies_beside_it(tmp_path: Path) -> None:
    """`.house` and `_semantic.ply`: Z up and labels, though a GLB is Y up by its format; of this scene, not of another
    in the folder."""
    ply = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [6.0, 5.0, 2.7]])
    vertices = np.array([tuple(v) for v in ply.vertices], [(axis, "f4") for axis in "xyz"])
    faces = np.array([(f, 1) for f in ply.faces], [("vertex_indices", "i4", (3,)), ("object_id", "i4")])
    write_ply(tmp_path / "b_semantic.ply", vertices, faces)
    house = (
        "ASCII 1.1\nC 0 500 wall_raw 1 wall 0 0 0 0 0\nO 1 0 0 0 0 0 1 0 0 0 1 0 1 1 1 0 0 0 0 0 0 0 0\n"
    )
    (tmp_path / "b.house").write_text(house)
    (tmp_path / "a.house").write_text(house)
    scene = _simulator(_glb(tmp_path / "b.glb", (6.0, 5.0, 2.7))).scene
    np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], [6.0, 5.0, 2.7])
    assert [scene.labels[row] for row in np.unique(scene.face_label)] == ["wall"]
    with pytest.raises(RlrError, match=r"a_semantic\.ply is missing"):
        _simulator(_glb(tmp_path / "a.glb", (6.0, 5.0, 2.7)))


def test_the_dataset_configuration_says_which_axis_is_up(tmp_path: Path) -> None:
    glb, config = _glb(tmp_path / "c.glb", (6.0, 5.0, 2.7)), tmp_path / "mp3d.scene_dataset_config.json"
    scene = _simulator(glb).scene
    np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], [6.0, 2.7, 5.0])
    for attributes, size in (
        ('{"up": [0, 0, 1], "front": [0, 1, 0]}', [6.0, 5.0, 2.7]),
        ('{"up": [0.0, 0.0, 1.0], "units_to_meters": 0.01}', [0.06, 0.05, 0.027]),
        ("{}", [6.0, 2.7, 5.0]),
    ):
        config.write_text(f'{{"stages": {{"default_attributes": {attributes}}}}}')
        scene = _simulator(glb, str(config)).scene
        np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], size, rtol=1e-6)
    for text, message in (
        ('{"stages": {"default_attributes": {"up": [1, 0, 0]}}}', r"expected \[0, 1, 0\]"),
        ('{"stages": {"default_attributes": {"units_to_meters": 7}}}', "units_to_meters"),
        ('{"stages": 3}', "default_attributes"),
        ("no JSON", "mp3d.scene_dataset_config.json"),
    ):
        config.write_text(text)
        with pytest.raises(RlrError, match=message):
            _simulator(glb, str(config))


def test_what_is_missing_is_said() -> None:
    sim, sensor = listening()
    with pytest.raises(RuntimeError, match="setAudioSourceTransform first"):
        sim.get_sensor_observations()
    with pytest.raises(RuntimeError, match="runSimulation first"):
        sensor.getIR()
    fresh = habitat.AudioSensor(habitat.AudioSensorSpec())
    with pytest.raises(RuntimeError, match="setAudioListenerTransform first"):
        fresh.runSimulation(sim)
    spec = habitat.AudioSensorSpec()
    spec.channelLayout.channelType = habitat.RLRAudioPropagationChannelLayoutType.Quad
    with pytest.raises(RuntimeError, match="got Quad"):
        sim.add_sensor(spec)
    with pytest.raises(AttributeError):
        spec.acousticsConfig.maxLength = 2.0  # type: ignore[attr-defined] # no name of habitat's
    with pytest.raises(RuntimeError, match="agent 1"):
        sim.get_agent(1)
    with pytest.raises(TypeError, match=r"AgentState\.rotation"):
        stand(sim, [0.0, 0.0, 0.0], "north")
    with pytest.raises(RlrError, match="nowhere"):
        habitat.Simulator(habitat.Configuration(habitat.SimulatorConfiguration("nowhere.glb")))


SCRIPT = """
import numpy as np
import soundspaces_rlr.habitat
soundspaces_rlr.habitat.install()
import habitat_sim
import habitat_sim.sensor
import habitat_sim._ext.habitat_sim_bindings as hsim_bindings
from habitat_sim.utils.common import quat_from_angle_axis

backend = habitat_sim.SimulatorConfiguration()
backend.scene_id, backend.load_semantic_mesh, backend.enable_physics = "demo", True, False
with habitat_sim.Simulator(habitat_sim.Configuration(backend, [habitat_sim.AgentConfiguration()])) as sim:
    acoustics = habitat_sim.sensor.RLRAudioPropagationConfiguration()
    acoustics.enableMaterials, acoustics.indirectRayCount, acoustics.irTime = True, 100, 0.3
    layout = hsim_bindings.RLRAudioPropagationChannelLayout()
    layout.channelType = hsim_bindings.RLRAudioPropagationChannelLayoutType.Binaural
    layout.channelCount = 2
    spec = habitat_sim.AudioSensorSpec()
    spec.uuid, spec.acousticsConfig, spec.channelLayout = "audio_sensor", acoustics, layout
    sim.add_sensor(spec)
    sensor = sim.get_agent(0)._sensors["audio_sensor"]
    sim.pathfinder.load_nav_mesh("data/scene_datasets/demo.navmesh")
    sim.seed(47)
    here = sim.pathfinder.get_random_navigable_point()
    there = sim.pathfinder.get_random_navigable_point() + np.array([0, 1.5, 0])
    way = habitat_sim.nav.ShortestPath()
    way.requested_start, way.requested_end = here, there
    assert sim.pathfinder.find_path(way) and way.geodesic_distance >= np.hypot(*(there - here)[[0, 2]]) - 0.1
    sensor.setAudioSourceTransform(there)
    agent = sim.get_agent(0)
    state = agent.get_state()
    state.position, state.sensor_states = np.array(here), {}
    state.rotation = quat_from_angle_axis(0.5, [0, 1, 0])
    agent.set_state(state, True)
    observation = np.array(sim.get_sensor_observations()["audio_sensor"])
    assert observation.shape[0] == 2 and observation.any(), observation.shape
"""


@ci_slow
def test_code_of_soundspaces_2_runs() -> None:
    subprocess.run([sys.executable, "-c", SCRIPT], check=True)
    late = (
        "import sys, types; sys.modules['habitat_sim'] = types.ModuleType('habitat_sim')\n"
        "from soundspaces_rlr import habitat\n"
        "try: habitat.install()\n"
        "except RuntimeError as e: assert 'is installed' in str(e)\n"
        "else: raise SystemExit('no error')"
    )
    subprocess.run([sys.executable, "-c", late], check=True)


def test_gibson_of_a_simulator(tmp_path: Path) -> None:
    """The configuration's `up` is the .glb's: it does not turn the semantic PLY, whose colours are found."""
    glb = gibson(tmp_path)
    config = tmp_path / "gibson_semantic.scene_dataset_config.json"
    for up in ([0, 0, 1], [0, 1, 0]):
        config.write_text(
            json.dumps({"stages": {"default_attributes": {"up": up, "semantic_up": [0, 1, 0]}}})
        )
        scene = find_scene(str(glb), str(config))
        np.testing.assert_allclose(scene.bounds[1], [4.0, 3.0, 2.5])
        colors = vertex_colors(str(glb), scene)
        assert colors is not None and (colors == 9.0).all()
