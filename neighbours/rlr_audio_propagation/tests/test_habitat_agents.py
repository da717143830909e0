"""What habitat-sim's clients do besides listening: turn, walk, look, follow ways, ask for versions."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from soundspaces_rlr import habitat
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat import magnum, rotations

from neighbours.rlr_audio_propagation.tests.test_habitat import box, listening, stand
from soundspaces_sim.scene.scene import Scene
from tests.ply import write_ply

UP = [0.0, 1.0, 0.0]


def camera(
    kind: str, scene: Scene, **settings: object
) -> tuple[habitat.Simulator, habitat.CameraSensorSpec]:
    spec = habitat.CameraSensorSpec(uuid=kind.lower(), sensor_type=habitat.SensorType[kind])
    for name, value in settings.items():
        setattr(spec, name, value)
    agent = habitat.AgentConfiguration(sensor_specifications=[spec])
    return habitat.Simulator(habitat.Configuration(habitat.SimulatorConfiguration(scene), [agent])), spec


def test_rotations_are_those_of_their_matrices() -> None:
    """Products, inverses and vectors turned, against Rodrigues' matrices of random rotations."""
    draw = np.random.default_rng(5)

    def rodrigues(angle: float, axis: np.ndarray) -> np.ndarray:
        k = np.cross(np.eye(3), axis / np.linalg.norm(axis))  # k @ v is axis × v
        return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k)

    for _ in range(20):
        (a, b), (u, v), w = draw.uniform(0, np.pi, 2), draw.normal(size=(2, 3)), draw.normal(size=3)
        p, q = (habitat.quat_from_angle_axis(t, x) for t, x in ((a, u), (b, v)))
        expected = rodrigues(a, u) @ rodrigues(b, v)
        np.testing.assert_allclose(rotations.matrix(p * q), expected, atol=1e-12)
        np.testing.assert_allclose(rotations.matrix((p * q).inverse()), expected.T, atol=1e-12)
        np.testing.assert_allclose(habitat.quat_rotate_vector(p, w), rodrigues(a, u) @ w, atol=1e-12)
        angle, axis = habitat.quat_to_angle_axis(p)
        np.testing.assert_allclose([angle, *axis], [a, *(u / np.linalg.norm(u))], atol=1e-9)
        np.testing.assert_allclose(
            habitat.quat_to_coeffs(habitat.quat_from_coeffs([0, 0, 3, 4])), [0, 0, 3, 4]
        )
        assert habitat.angle_between_quats(p, p * habitat.quat_from_angle_axis(b, v)) == pytest.approx(b)
        onto = habitat.quat_rotate_vector(habitat.quat_from_two_vectors(u, v), u / np.linalg.norm(u))
        np.testing.assert_allclose(onto, v / np.linalg.norm(v), atol=1e-9)
    back = habitat.quat_from_two_vectors([1, 0, 0], [-2, 0, 0])
    np.testing.assert_allclose(habitat.quat_rotate_vector(back, [1, 0, 0]), [-1, 0, 0], atol=1e-12)
    with pytest.raises(RlrError, match="axis"):
        habitat.quat_from_angle_axis(1.0, [0, 0, 0])


def test_magnums_angles_and_quaternions_are_taken() -> None:
    assert float(magnum.Deg(magnum.Rad(np.pi))) == pytest.approx(180.0)
    assert float(magnum.Rad(magnum.Deg(90.0))) == pytest.approx(0.5 * np.pi)
    assert list(magnum.Vector3(1, 2, 3) + np.array([1, 0, 0])) == [2, 2, 3]
    turn = magnum.Quaternion.rotation(magnum.Deg(90.0), magnum.Vector3(*UP))
    ours = habitat.quat_from_angle_axis(0.5 * np.pi, UP)
    np.testing.assert_allclose(
        habitat.quat_to_coeffs(habitat.quat_from_magnum(turn * turn)),
        habitat.quat_to_coeffs(ours * ours),
    )


def test_depth_is_the_distance_of_the_wall_along_the_view() -> None:
    """A room 6 × 2.7 × 5 m. Straight ahead depth is that of the wall over the whole of it, not the slant; of the
    floor, height over the tangent below the horizon; the rows are the top ones first."""
    sim, _ = camera("DEPTH", box(), resolution=[60, 80], hfov=90.0)
    stand(sim, [3.0, 0.0, -2.0])  # the wall 3 m ahead, 1.2 m up to the ceiling, 1.5 m down to the floor
    depth = sim.get_sensor_observations()["depth"]
    assert (depth.dtype.name, depth.shape) == ("float32", (60, 80))
    slope = (60 / 80) * (1.0 - (2.0 * np.arange(60) + 1.0) / 60)  # upwards
    expected = np.where(slope > 0.4, 1.2 / slope, np.where(slope < -0.5, -1.5 / slope, 3.0))
    for column in (35, 40, 45):
        np.testing.assert_allclose(depth[:, column], expected, rtol=1e-5)
    left = habitat.quat_from_angle_axis(np.radians(90.0), UP)
    stand(sim, [1.0, 0.0, -3.0], left)
    np.testing.assert_allclose(sim.get_sensor_observations()["depth"][30, 38:42], 1.0, rtol=1e-5)
    sim, _ = camera("DEPTH", box(), resolution=[9, 9], orientation=[-0.5 * np.pi, 0.0, 0.0], far=1.4)
    stand(sim, [3.0, 0.0, -3.0])
    assert not sim.get_sensor_observations()["depth"].any()  # the floor is 1.5 m down, beyond `far`
    sim.config.agents[0].sensor_specifications[0].far = 1.6
    np.testing.assert_allclose(sim.get_sensor_observations()["depth"], 1.5, rtol=1e-5)


def furnished() -> Scene:
    """The room with two boxes of label "chair", and one without a label."""
    room = box()
    boxes = [[0.5, 0.5, 0.0], [3.0, 2.5, 0.0], [5.0, 4.0, 0.0]]
    meshes = [trimesh.creation.box(bounds=np.array([b, np.array(b) + 0.8])) for b in boxes]
    vertices = [np.asarray(room.vertices), *(m.vertices for m in meshes)]
    first = np.cumsum([0, *(len(v) for v in vertices)])
    faces = [np.asarray(room.faces), *(m.faces + n for m, n in zip(meshes, first[1:], strict=False))]
    row = np.repeat([0, 1, 1, -1], [len(f) for f in faces])
    zeros = np.zeros(len(row), int)
    return Scene(
        np.concatenate(vertices), np.concatenate(faces), zeros, room.materials, ("wall", "chair"), row
    )


def test_semantic_pictures_have_the_rows_of_the_scenes_objects() -> None:
    sim, _ = camera("SEMANTIC", furnished(), resolution=[40, 40], position=[0.0, 0.4, 0.0])
    objects = sim.semantic_scene.objects
    assert [o.category.name() for o in objects] == ["void", "wall", "chair", "chair"]
    assert [int(o.id.split("_")[-1]) for o in objects] == [0, 1, 2, 3]
    centers = sorted(o.aabb.center.tolist() for o in objects[2:])
    np.testing.assert_allclose(centers, [[0.9, 0.4, -0.9], [3.4, 0.4, -2.9]])
    np.testing.assert_allclose(objects[1].aabb.sizes, [6.0, 2.7, 5.0])
    stand(sim, [3.4, 0.0, -1.0])  # before the second chair, looking along -z
    seen = sim.get_sensor_observations()["semantic"]
    assert (seen.dtype.name, seen.shape) == ("uint32", (40, 40))
    middle = objects[int(seen[20, 20])]
    np.testing.assert_allclose(middle.aabb.center, [3.4, 0.4, -2.9])
    assert objects[int(seen[0, 0])].category.name() == "wall"


def test_colours_are_the_vertices_of_the_file(tmp_path: Path) -> None:
    """A box whose corners' red grows along x: between them it is linear, as barycentric weights have it. Without
    colours a label has one."""
    mesh = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [6.0, 5.0, 2.7]])
    kinds = [(a, "f4") for a in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")]
    rows = [(*v, round(40.0 * v[0]), 7, 9) for v in mesh.vertices]
    faces = np.array([(f,) for f in mesh.faces], [("vertex_indices", "i4", (3,))])
    path = tmp_path / "room.ply"
    write_ply(path, np.array(rows, kinds), faces)
    sim, _ = camera("COLOR", str(path), resolution=[20, 30])  # type: ignore[arg-type]
    stand(sim, [3.0, 0.0, -3.0])
    picture = sim.get_sensor_observations()["color"]
    assert (picture.dtype.name, picture.shape) == ("uint8", (20, 30, 4))
    across = 3.0 + 2.0 * ((2.0 * np.arange(30) + 1.0) / 30 - 1.0)  # x on the wall 2 m ahead
    np.testing.assert_allclose(picture[10, :, 0], 40.0 * across, atol=1.0)
    assert (picture[10, :, 1:] == [7, 9, 255]).all()
    sim, _ = camera("COLOR", furnished(), resolution=[20, 20], position=[0.0, 0.4, 0.0])
    stand(sim, [3.4, 0.0, -1.0])
    plain = sim.get_sensor_observations()["color"].astype(int)
    assert np.abs(plain[10, 10] - plain[0, 10]).max() > 30


def test_cameras_that_cannot_be_drawn_are_refused() -> None:
    for settings, message in (
        ({"resolution": [0, 4]}, "resolution"),
        ({"resolution": 4}, "resolution"),
        ({"hfov": 180.0}, "hfov"),
        ({"hfov": np.nan}, "hfov"),
        ({"sensor_subtype": habitat.SensorSubType.ORTHOGRAPHIC}, "PINHOLE"),
        ({"noise_model": "RedwoodDepthNoiseModel"}, "noise_model"),
    ):
        with pytest.raises(RlrError, match=message):
            camera("DEPTH", box(), **settings)
    with pytest.raises(TypeError, match="CameraSensorSpec"):
        habitat.Agent().add_sensor("a camera")


def test_steps_end_at_walls_and_slide_along_them() -> None:
    sim = habitat.Simulator(habitat.Configuration(habitat.SimulatorConfiguration(box())))
    agent = sim.get_agent(0)
    stand(sim, [3.0, 0.0, -2.0])
    assert sim.step("move_forward") == {"collided": False}
    np.testing.assert_allclose(agent.state.position, [3.0, 0.0, -2.25], atol=1e-9)
    assert not agent.act("turn_left")
    agent.act("move_forward")
    turned = [3.0 - 0.25 * np.sin(np.radians(10.0)), 0.0, -2.25 - 0.25 * np.cos(np.radians(10.0))]
    np.testing.assert_allclose(agent.state.position, turned, atol=1e-9)
    # At the wall x = 0 (0.1 m is the agent's radius), looking 60 degrees to the left of -z: along it -z is left.
    for sliding, gets in ((True, 0.125), (False, 0.0)):
        sim.config.sim_cfg.allow_sliding = sliding
        paths = sim.pathfinder
        corner = paths.snap_point([0.0, 0.0, -2.5])
        stand(sim, corner, habitat.quat_from_angle_axis(np.radians(60.0), UP))
        assert sim.step("move_forward")["collided"]
        np.testing.assert_allclose(agent.state.position[0], corner[0], atol=0.06)
        assert corner[2] - agent.state.position[2] == pytest.approx(gets, abs=0.05)
    with pytest.raises(RlrError, match="no action 'fly'"):
        agent.act("fly")


def test_looking_up_and_down_moves_the_sensors_within_their_constraint() -> None:
    sim, _ = camera("DEPTH", box(), resolution=[3, 3])
    agent = sim.get_agent(0)
    actuation = habitat.ActuationSpec(20.0, constraint=50.0)
    agent.agent_config.action_space["look_down"] = habitat.ActionSpec("look_down", actuation)
    stand(sim, [3.0, 0.0, -4.0])
    for expected in (20.0, 40.0, 50.0, 50.0):
        sim.step("look_down")
        front = -agent.sensors["depth"].node.axes[:, 2]
        assert np.degrees(np.arcsin(-front[1])) == pytest.approx(expected)
    np.testing.assert_allclose(agent.state.rotation.components, [1, 0, 0, 0])
    down = 1.5 / np.tan(np.radians(50.0))  # to the floor: 1.26 m ahead, beyond the wall 1 m ahead
    assert down > 1.0
    depth = sim.get_sensor_observations()["depth"][1, 1]
    assert depth == pytest.approx(1.0 / np.cos(np.radians(50.0)), rel=1e-5)


def test_a_greedy_follower_gets_there_around_a_wall() -> None:
    mesh: Any = trimesh.util.concatenate(
        [
            trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [6.0, 5.0, 2.7]]),
            trimesh.creation.box(bounds=[[2.9, -0.1, 0.0], [3.1, 3.5, 2.8]]),
        ]
    )
    scene = Scene.from_arrays(mesh.vertices, mesh.faces, 0.3)
    sim = habitat.Simulator(habitat.Configuration(habitat.SimulatorConfiguration(scene)))
    goal = np.array([5.0, 0.0, -1.0])
    follower = sim.make_greedy_follower(goal_radius=0.25, stop_key="stop")
    for turn in (2.0,):
        stand(sim, [1.0, 0.0, -1.0], habitat.quat_from_angle_axis(turn, UP))
        path = habitat.ShortestPath(sim.get_agent(0).state.position, goal)
        assert sim.pathfinder.find_path(path)
        actions, travelled = follower.find_path(goal), 0.0
        assert actions[-1] == "stop"
        for i, action in enumerate(actions[:-1]):
            if i % 10 == 0:
                assert follower.next_action_along(goal) == action
            before = sim.get_agent(0).state.position
            sim.step(action)
            travelled += float(np.linalg.norm(sim.get_agent(0).state.position - before))
        assert np.linalg.norm(sim.get_agent(0).state.position - goal) < 0.3
        assert travelled < 1.1 * path.geodesic_distance + 0.25
    with pytest.raises(habitat.GreedyFollowerError, match="no way"):
        closed: Any = trimesh.util.concatenate(
            [mesh, trimesh.creation.box(bounds=[[2.9, -0.1, 0.0], [3.1, 5.1, 2.8]])]
        )
        scene = Scene.from_arrays(closed.vertices, closed.faces, 0.3)
        shut = habitat.Simulator(habitat.Configuration(habitat.SimulatorConfiguration(scene)))
        stand(shut, [1.0, 0.0, -1.0])
        shut.make_greedy_follower().find_path(goal)


def test_the_view_from_above_is_the_floor() -> None:
    sim = habitat.Simulator(habitat.Configuration(habitat.SimulatorConfiguration(furnished())))
    paths = sim.pathfinder
    view = paths.get_topdown_view(0.1, 0.0)
    low, high = paths.get_bounds()
    assert view.dtype == bool
    assert view.shape == (int((high - low)[2] / 0.1), int((high - low)[0] / 0.1))
    assert view.mean() * np.prod((high - low)[[0, 2]]) == pytest.approx(paths.navigable_area, rel=0.05)
    chair = ((np.array([3.4, -2.9]) - low[[0, 2]]) / 0.1).astype(int)
    assert not view[chair[1], chair[0]]
    assert not paths.get_topdown_view(0.1, 5.0).any()
    for bad in (0.0, -1.0, np.nan, 1e-9, 100.0):
        with pytest.raises(RlrError, match="meters_per_pixel"):
            paths.get_topdown_view(bad, 0.0)
    settings, area = habitat.NavMeshSettings(), paths.navigable_area
    settings.agent_radius = 0.5
    assert sim.recompute_navmesh(paths, settings)
    assert paths.navigable_area < area - 0.4 * 2 * (6 + 5 - 2)
    near = [paths.get_random_navigable_point_near([3.0, 0.0, -1.0], 0.5) for _ in range(50)]
    assert np.linalg.norm(np.array(near) - [3.0, 0.0, -1.0], axis=1).max() <= 0.5
    assert np.isnan(paths.get_random_navigable_point_near([30.0, 0.0, 0.0], 1.0)).all()


def test_reset_brings_agents_back_and_seeds_draw_the_same_start() -> None:
    def start(seed: int) -> np.ndarray:
        sim = habitat.Simulator(
            habitat.Configuration(habitat.SimulatorConfiguration(box(), random_seed=seed))
        )
        agent = sim.initialize_agent(0)
        first = np.append(agent.state.position, habitat.quat_to_coeffs(agent.state.rotation))
        sim.step("move_forward")
        assert sim.reset() == {}
        again = np.append(agent.state.position, habitat.quat_to_coeffs(agent.state.rotation))
        np.testing.assert_array_equal(again, first)
        return first

    np.testing.assert_array_equal(start(3), start(3))
    assert not np.array_equal(start(3), start(4))


def test_what_a_sensor_says_of_its_last_simulation(tmp_path: Path) -> None:
    """A source behind a box is not visible; a closed room keeps its rays, an open one does not; files are those of
    the context."""
    import soundfile

    sim, sensor = listening(scene=furnished())
    sensor.specification().acousticsConfig.maxIRLength = 0.1
    assert sensor.specification().acousticsConfig.irTime == 0.1
    for name in ("sourceIsVisible", "getRayEfficiency"):
        with pytest.raises(RlrError, match="runSimulation first"):
            getattr(sensor, name)()
    for source, visible in (([3.4, 0.4, -4.5], False), ([3.4, 2.0, -4.5], True)):
        stand(sim, [3.4, -1.1, -1.0])  # the ear 0.4 m above the floor
        sensor.setAudioSourceTransform(source)
        ir = sim.get_sensor_observations()["audio_sensor"]
        assert sensor.sourceIsVisible() is visible
    assert sensor.getRayEfficiency() > 0.99
    assert sensor.writeIRWave(str(tmp_path / "ir.wav")) is True
    np.testing.assert_array_equal(soundfile.read(tmp_path / "ir.wav", dtype="float32")[0], ir[0])
    assert sensor.writeSceneMeshOBJ(str(tmp_path / "scene.obj")) is True
    written = trimesh.load(tmp_path / "scene.obj")
    np.testing.assert_allclose(written.bounds, [[0.0, 0.0, -5.0], [6.0, 2.7, 0.0]], atol=1e-6)
    with pytest.raises(RlrError, match="nowhere"):
        sensor.writeSceneMeshOBJ(str(tmp_path / "nowhere" / "scene.obj"))
    with pytest.raises(RlrError, match=r"no\.sofa"):
        sensor.setListenerHRTF(str(tmp_path / "no.sofa"))


NAMES = """
import sys
import soundspaces_rlr, soundspaces_rlr.habitat
soundspaces_rlr.install(); soundspaces_rlr.habitat.install()
import rlr_audio_propagation, rlr_audio_propagation.core, habitat_sim, habitat_sim.utils
import magnum as mn
assert rlr_audio_propagation.__version__ == "0.0.1+soundspaces"
assert rlr_audio_propagation.core.Context is rlr_audio_propagation.Context
assert habitat_sim.__version__ and habitat_sim.utils.quat_from_angle_axis is habitat_sim.utils.common.quat_from_angle_axis
assert float(mn.Deg(20)) == 20.0 and habitat_sim.errors.GreedyFollowerError
assert habitat_sim.agent.AgentConfiguration().action_space["turn_left"].actuation.amount == 10.0
"""


def test_names_are_where_clients_look_for_them() -> None:
    subprocess.run([sys.executable, "-c", NAMES], check=True)


def test_what_is_not_finite_is_refused_at_every_door() -> None:
    sim, spec = camera("DEPTH", box())
    agent, finder, nan = sim.get_agent(0), sim.pathfinder, float("nan")
    step = agent.agent_config.action_space["move_forward"]
    here = finder.get_random_navigable_point()

    def act(amount: float) -> None:
        step.actuation = habitat.ActuationSpec(amount)
        try:
            agent.act("move_forward")
        finally:
            step.actuation = habitat.ActuationSpec(0.25)

    def see(far: float) -> None:
        spec.far = far
        sim.get_sensor_observations()

    for call in (
        lambda: act(nan),
        lambda: see(nan),
        lambda: finder.get_random_navigable_point_near(here, nan),
        lambda: finder.is_navigable(here, nan),
        lambda: finder.get_topdown_view(0.1, nan),
        lambda: finder.get_topdown_view(0.1, 0.0, nan),
        lambda: sim.make_greedy_follower(0, nan),
        lambda: habitat.angle_between_quats([0, 0, 0, nan], [0, 0, 0, 1]),
        lambda: habitat.quat_from_coeffs([nan, 0, 0, 1]),
    ):
        with pytest.raises(RlrError):
            call()


def test_a_start_is_kept_where_a_client_changes_its_state_in_place() -> None:
    sim, _ = camera("DEPTH", box())
    state = habitat.AgentState(np.array([1.0, 0.0, -1.0]))
    agent = sim.initialize_agent(0, state)
    state.position += 0.5
    agent.set_state(state)
    sim.reset()
    np.testing.assert_array_equal(agent.get_state().position, [1.0, 0.0, -1.0])
