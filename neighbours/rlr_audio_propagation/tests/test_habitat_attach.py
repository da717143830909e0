"""Our audio sensor in habitat-sim: in a stand-in of its simulator, and in the genuine one where that is installed."""

from __future__ import annotations

import gc
import importlib
import importlib.util
import sys
import weakref
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import trimesh
from soundspaces_rlr import habitat
from soundspaces_rlr.errors import RlrError

from neighbours.rlr_audio_propagation.tests import habitat_stand_in as stand_in
from neighbours.rlr_audio_propagation.tests.rooms import material, write_database
from neighbours.rlr_audio_propagation.tests.test_habitat import box

SOURCE = [4.0, 1.2, -3.0]
POSES = [
    ([1.0, 0.0, -1.0], stand_in.yaw(0.0)),
    ([2.3, 0.1, -3.7], stand_in.yaw(130.0)),
    ([4.9, 0.0, -0.6], stand_in.yaw(-77.0)),
]


def ears(uuid: str = "ears", kind: str = "Binaural", **settings: object) -> habitat.AudioSensorSpec:
    spec = habitat.AudioSensorSpec(uuid=uuid)
    spec.acousticsConfig.sampleRate, spec.acousticsConfig.irTime = 16000, 0.1
    spec.acousticsConfig.indirectRayCount = 100
    for name, value in settings.items():
        setattr(spec.acousticsConfig, name, value)
    spec.channelLayout.channelType = habitat.RLRAudioPropagationChannelLayoutType[kind]
    spec.channelLayout.channelCount = {"Mono": 1, "Binaural": 2}[kind]
    return spec


def simulator(agents: int = 1, scene_id: str = "box.glb") -> stand_in.Simulator:
    """With one camera on each agent, `color`, `color1`, … of another uuid."""
    bodies = [
        stand_in.AgentConfiguration([stand_in.CameraSensorSpec(f"color{i or ''}")])
        for i in range(agents)
    ]
    return stand_in.Simulator(stand_in.Configuration(stand_in.SimulatorConfiguration(scene_id), bodies))


def own(spec: habitat.AudioSensorSpec, source: list[float], materials: str | None = None) -> Any:
    """The simulator of this package with such a sensor: what a pose (position, rotation) gives there."""
    sim = habitat.Simulator(habitat.Configuration(habitat.SimulatorConfiguration(box())))
    sim.add_sensor(spec)
    sensor = sim.get_agent(0).sensors[spec.uuid]
    sensor.setAudioSourceTransform(source)
    if materials is not None:
        sensor.setAudioMaterialsJSON(materials)

    def at(state: Any) -> np.ndarray:
        sim.get_agent(0).set_state(habitat.AgentState(state.position, state.rotation))
        return np.array(sim.get_sensor_observations()[spec.uuid])

    return at


def test_what_is_heard_is_that_of_our_own_simulator_to_the_bit(tmp_path: Path) -> None:
    """Beside pictures that stay what they were, at places and turns, with an offset of the sensor and materials."""
    spec = ears()
    spec.position, spec.orientation = [0.2, 1.4, -0.1], [0.1, 0.4, 0.0]
    database = write_database(tmp_path / "soft.json", material("Plaster", 0.6, labels=["wall"]))
    sim, alone = simulator(), simulator()
    sensor = habitat.attach(sim, spec, scene=box(), materials=database)
    sensor.setAudioSourceTransform(SOURCE)
    expected = own(spec, SOURCE, database)
    for position, rotation in POSES:
        for one in (sim, alone):
            one.get_agent(0).set_state(stand_in.AgentState(position, rotation))
        seen = sim.get_sensor_observations()
        np.testing.assert_array_equal(seen["color"], alone.get_sensor_observations()["color"])
        np.testing.assert_array_equal(seen["ears"], expected(sim.get_agent(0).get_state()))
        assert seen["ears"] is sensor.getIR() and seen["ears"].any()
    assert list(seen) == ["color", "ears"]


def test_the_ear_is_where_the_body_carries_it() -> None:
    """Turned left by 90 degrees an agent looks along -x: what is ahead of it by .3 m is there, what is on its right by
    .2 m is at -z. A source at half a metre from that place has the level of half a metre."""
    spec = ears(kind="Mono", indirect=False)
    spec.position = [0.2, 1.4, -0.3]
    sim = simulator()
    sensor = habitat.attach(sim, spec, scene=box())
    sim.get_agent(0).set_state(stand_in.AgentState([3.0, 0.1, -2.0], stand_in.yaw(90.0)))
    ear = np.array([3.0 - 0.3, 0.1 + 1.4, -2.0 - 0.2])
    for way in np.eye(3):
        sensor.setAudioSourceTransform(ear + 0.5 * way)
        ir = sim.get_sensor_observations()["ears"]
        spectrum = np.abs(np.fft.rfft(ir[0], 8192))
        middle = spectrum[slice(*np.searchsorted(np.fft.rfftfreq(8192, 1 / 16000), [300.0, 3000.0]))]
        np.testing.assert_allclose(middle, 0.25 * np.sqrt(1.0 / (4.0 * np.pi)) / 0.5, rtol=0.02)


def test_steps_and_resets_are_heard() -> None:
    """Walking and turning, as `step` has it; `reset` is where it began, and sounds so, to the bit."""
    sim = simulator()
    sensor = habitat.attach(sim, ears(indirect=False), scene=box())
    sensor.setAudioSourceTransform([3.0, 1.5, -0.5])  # behind an agent that looks along -z
    sim.initialize_agent(0, stand_in.AgentState([3.0, 0.0, -2.5], stand_in.yaw(0.0)))
    first = sim.reset()
    level = [float((first["ears"] ** 2).sum())]
    for _ in range(4):
        seen = sim.step("move_forward")
        level.append(float((seen["ears"] ** 2).sum()))
    assert set(seen) == {"color", "ears", "collided"}
    assert level == sorted(level, reverse=True)
    sim.reset()
    for _ in range(9):
        seen = sim.step("turn_left")  # by 90 degrees in all: what was behind is on the left
    left, right = (seen["ears"] ** 2).sum(axis=1)
    assert left > 4.0 * right
    assert np.array_equal(sim.reset()["ears"], first["ears"])


@pytest.mark.parametrize("by_name", [False, True], ids=["by-agent", "by-name"])
def test_each_of_several_agents_hears_for_itself(by_name: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """By number, by list and by `step` of a mapping, in either way of habitat-sim to keep its sensors; an agent
    without ears hears nothing."""
    monkeypatch.setattr(stand_in.Simulator, "BY_NAME", by_name)
    sim = simulator(agents=3)
    for i, (position, rotation) in enumerate(POSES):
        sim.get_agent(i).set_state(stand_in.AgentState(position, rotation))
    specs = {0: ears(), 2: ears("more", kind="Mono")}
    for i, spec in specs.items():
        sensor = habitat.attach(sim, spec, agent_id=i, scene=box() if i == 0 else None)
        sensor.setAudioSourceTransform(SOURCE)
    seen = sim.get_sensor_observations([0, 1, 2])
    assert [list(seen[i]) for i in range(3)] == [["color", "ears"], ["color1"], ["color2", "more"]]
    for i, spec in specs.items():
        state = sim.get_agent(i).get_state()
        np.testing.assert_array_equal(seen[i][spec.uuid], own(spec, SOURCE)(state))
        np.testing.assert_array_equal(sim.get_sensor_observations(i)[spec.uuid], seen[i][spec.uuid])
    walked = sim.step({2: "move_forward", 1: "turn_left"})
    assert {i: set(o) for i, o in walked.items()} == {
        1: {"color1", "collided"},
        2: {"color2", "more", "collided"},
    }
    assert not np.array_equal(walked[2]["more"], seen[2]["more"])


def test_pictures_that_were_begun_before_come_with_sound() -> None:
    sim = simulator(agents=2)
    habitat.attach(sim, ears(), agent_id=1, scene=box()).setAudioSourceTransform(SOURCE)
    sim.get_agent(1).set_state(stand_in.AgentState(*POSES[0]))
    expected = sim.get_sensor_observations(1)
    for agent_ids in (1, [0, 1]):
        sim.start_async_render(agent_ids)
        seen = sim.get_sensor_observations_async_finish()
        one = seen if agent_ids == 1 else seen[1]
        assert {k: v.tolist() for k, v in one.items()} == {k: v.tolist() for k, v in expected.items()}
    with pytest.raises(RuntimeError, match="nothing was begun"):
        sim.get_sensor_observations_async_finish()


def _stage(path: Path, size: tuple[float, float, float]) -> str:
    """A box as a GLB file, Y up, from the origin to (x, y, -z): what habitat-sim would draw."""
    x, y, z = size
    trimesh.creation.box(bounds=[[0.0, 0.0, -z], [x, y, 0.0]]).export(path)
    return str(path)


def test_the_stage_is_the_simulators_and_changes_with_it(tmp_path: Path) -> None:
    small, large = (
        _stage(tmp_path / f"{name}.glb", size)
        for name, size in (("small", (6.0, 2.7, 5.0)), ("large", (9.0, 4.0, 8.0)))
    )
    sim = simulator(scene_id=small)
    habitat.attach(sim, ears(direct=False)).setAudioSourceTransform(SOURCE)
    sim.get_agent(0).set_state(stand_in.AgentState(*POSES[0]))
    heard = {small: sim.get_sensor_observations()["ears"]}
    for scene_id in (large, small):
        config = stand_in.Configuration(stand_in.SimulatorConfiguration(scene_id), sim.config.agents)
        sim.reconfigure(config)
        sim.get_agent(0).set_state(stand_in.AgentState(*POSES[0]))
        heard[scene_id + " later"] = sim.get_sensor_observations()["ears"]
    assert np.array_equal(heard[small], heard[small + " later"])
    loud, quiet = ((ir**2).sum() for ir in (heard[small], heard[large + " later"]))
    assert loud > 1.5 * quiet

    other = simulator(scene_id=small)
    habitat.attach(other, ears(), scene=box()).setAudioSourceTransform(SOURCE)
    other.reconfigure(stand_in.Configuration(stand_in.SimulatorConfiguration(large), sim.config.agents))
    with pytest.raises(RlrError, match=r"went from .*small\.glb' to .*large\.glb'.*detach"):
        other.get_sensor_observations()
    habitat.detach(other)
    assert list(other.get_sensor_observations()) == ["color"]
    habitat.attach(other, ears(), scene=box()).setAudioSourceTransform(SOURCE)
    assert set(other.get_sensor_observations()) == {"color", "ears"}


def test_what_cannot_be_attached_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    sim = simulator()
    before = dict(vars(sim))
    quad = ears()
    quad.channelLayout.channelType = habitat.RLRAudioPropagationChannelLayoutType.Quad
    broken = tmp_path / "broken.glb"
    broken.write_bytes(b"no mesh")
    for spec, more, kind, said in (
        (stand_in.AudioSensorSpec(), {}, TypeError, r"expected a soundspaces_rlr\.habitat\.AudioSensorSpec"),
        (ears("color"), {"scene": box()}, RlrError, "agent 0 has a sensor 'color'"),
        (ears(), {}, RlrError, r"scene_id 'box\.glb' is no file: give attach a scene"),
        (ears(), {"scene": broken}, RlrError, "broken"),
        (ears(), {"scene": box(), "agent_id": 1}, RlrError, "agent 1 is not among the 1"),
        (quad, {"scene": box()}, RlrError, "got Quad"),
    ):  # fmt: skip
        with pytest.raises(kind, match=said):
            habitat.attach(sim, spec, **more)  # type: ignore[arg-type]
        assert vars(sim) == before
    sensor = habitat.attach(sim, ears(), scene=box())
    with pytest.raises(RlrError, match="has a sensor 'ears'"):
        habitat.attach(sim, ears())
    with pytest.raises(RlrError, match="setAudioSourceTransform first"):
        sim.get_sensor_observations()
    sensor.setAudioSourceTransform(SOURCE)
    sim.add_sensor(stand_in.CameraSensorSpec("ears"))
    with pytest.raises(RlrError, match="two sensors of the same uuid: ears"):
        sim.get_sensor_observations()


def test_a_simulator_with_ears_goes_with_its_last_reference() -> None:
    """As habitat-sim closes then, which frees its graphics."""
    sim = simulator()
    sensor = habitat.attach(sim, ears(), scene=box())
    sensor.setAudioSourceTransform(SOURCE)
    sim.get_sensor_observations()
    gone = weakref.ref(sim)
    gc.disable()
    try:
        del sim
        assert gone() is None
    finally:
        gc.enable()
    assert sensor.getIR().any()


@pytest.fixture
def genuine() -> Iterator[ModuleType]:
    """habitat-sim itself, not what other tests have put under its name."""
    present = sys.modules.get("habitat_sim")
    if present is not None and present.__spec__ is None:
        pytest.skip("another module has the name habitat_sim in this process")
    if importlib.util.find_spec("habitat_sim") is None:
        pytest.skip(
            "habitat-sim is not installed: pip finds no wheel of it (conda install -c aihabitat habitat-sim)"
        )
    yield importlib.import_module("habitat_sim")


def test_in_habitat_sim_itself(genuine: Any, tmp_path: Path) -> None:
    """Without cameras, which want a graphics driver: sound at poses is that of our own simulator."""
    scene_id = _stage(tmp_path / "box.glb", (6.0, 2.7, 5.0))
    backend = genuine.SimulatorConfiguration()
    backend.scene_id, backend.enable_physics = scene_id, False
    with genuine.Simulator(genuine.Configuration(backend, [genuine.agent.AgentConfiguration()])) as sim:
        spec = ears()
        habitat.attach(sim, spec).setAudioSourceTransform(SOURCE)
        mine = habitat.Simulator(habitat.Configuration(habitat.SimulatorConfiguration(scene_id)))
        mine.add_sensor(spec)
        mine.get_agent(0).sensors["ears"].setAudioSourceTransform(SOURCE)
        for position, turn in POSES:
            state = genuine.AgentState()
            state.position, state.rotation = np.array(position), [turn.x, turn.y, turn.z, turn.w]
            sim.get_agent(0).set_state(state)
            now = sim.get_agent(0).get_state()
            np.testing.assert_allclose(now.position, position, atol=1e-6)
            mine.get_agent(0).set_state(habitat.AgentState(now.position, now.rotation))
            np.testing.assert_array_equal(
                sim.get_sensor_observations()["ears"], mine.get_sensor_observations()["ears"]
            )
        assert set(sim.step("turn_left")) == {"ears", "collided"}
