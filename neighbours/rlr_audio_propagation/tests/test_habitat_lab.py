"""Names by which habitat-lab and its forks start: what they mean, or that they are refused when used."""

import math
import subprocess
import sys

import matplotlib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from soundspaces_rlr import habitat
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat import magnum, profiling
from soundspaces_rlr.habitat.refused import NAMES, RefusedObject, refused_names

from neighbours.rlr_audio_propagation.tests.test_habitat import box
from neighbours.rlr_audio_propagation.tests.test_habitat_agents import camera

#: The imports of habitat-lab 0.2.2 and 0.3.4 and of what forks add, in their words.
IMPORTS = """
import soundspaces_rlr.habitat
soundspaces_rlr.habitat.install()
import corrade as cr
import magnum as mn
import habitat_sim
import habitat_sim.utils.datasets_download as data_downloader
from habitat_sim import ReplayRenderer, ReplayRendererConfiguration, RigidState, bindings as hsim
from habitat_sim.agent.agent import AgentState, SixDOFPose
from habitat_sim.errors import GreedyFollowerError
from habitat_sim.logging import logger
from habitat_sim.nav import NavMeshSettings
from habitat_sim.physics import (
    CollisionGroupHelper, CollisionGroups, JointMotorSettings, ManagedArticulatedObject,
    ManagedBulletArticulatedObject, ManagedRigidObject, MotionType, RigidConstraintSettings, RigidConstraintType,
    VelocityControl,
)
from habitat_sim.robots import FetchRobot, FetchRobotNoWheels
from habitat_sim.sensor import SensorSpec as BackendSensorSpec
from habitat_sim.sim import SimulatorBackend
from habitat_sim.simulator import Simulator
from habitat_sim.utils import profiling_utils, viz_utils as vut
from habitat_sim.utils.common import d3_40_colors_rgb, orthonormalize_rotation_shear, quat_from_magnum, quat_to_magnum
assert issubclass(SimulatorBackend, Simulator) and MotionType.KINEMATIC and habitat_sim.geo.UP[1] == 1
assert habitat_sim.FisheyeSensorModelType.DOUBLE_SPHERE and habitat_sim.SensorSubType.EQUIRECTANGULAR
class Robot(ManagedRigidObject):
    def at(self, ray: habitat_sim.geo.Ray, line: habitat_sim.gfx.DebugLineRender) -> mn.Matrix4: ...
manager = mn.trade.ImporterManager()
for use in (
    lambda: Robot(), lambda: JointMotorSettings(0.1), lambda: data_downloader.main([]), lambda: vut.make_video(),
    lambda: habitat_sim.EquirectangularSensorSpec(), lambda: CollisionGroups.Robot, lambda: manager.load("a.glb"),
    lambda: cr.containers.StridedArrayView1D, lambda: mn.gl.Buffer,
):
    try:
        use()
    except RuntimeError as error:
        assert " here" in str(error) or "no " in str(error), error
    else:
        raise AssertionError("not refused")
"""


def test_the_imports_of_habitat_lab_work_and_what_means_nothing_is_refused_when_used() -> None:
    subprocess.run([sys.executable, "-c", IMPORTS], check=True)


def test_a_refusal_names_what_was_used_and_why() -> None:
    ours = refused_names("habitat_sim")
    assert set(ours) == set(NAMES)
    with pytest.raises(RlrError, match=r"habitat_sim\.physics\.ManagedRigidObject: there is no physics"):
        ours["physics"]["ManagedRigidObject"]()
    with pytest.raises(RlrError, match=r"habitat_sim\.physics\.CollisionGroups\.Robot"):
        _ = ours["physics"]["CollisionGroups"].Robot
    with pytest.raises(RlrError, match=r"manager\.load: there is no physics"):
        RefusedObject("manager").load("a")
    sim, _ = camera("DEPTH", box())
    with pytest.raises(RlrError, match=r"get_rigid_object_manager\(\)\.add_object"):
        sim.get_rigid_object_manager().add_object("chair")
    backend = habitat.SimulatorConfiguration(box(), enable_gfx_replay_save=True)
    with pytest.raises(RlrError, match="enable_gfx_replay_save"):
        habitat.Simulator(habitat.Configuration(backend))
    with pytest.raises(RlrError, match="enable_batch_renderer"):
        habitat.Simulator(
            habitat.Configuration(habitat.SimulatorConfiguration(box()), enable_batch_renderer=True)
        )


def test_the_forty_colours_are_those_of_matplotlibs_tables() -> None:
    """Matplotlib's tab20 and tab20b are D3's categories 20 and 20b."""
    tables = [matplotlib.colormaps[name].colors for name in ("tab20", "tab20b")]  # type: ignore[attr-defined]
    expected = np.round(255.0 * np.concatenate(tables))
    np.testing.assert_array_equal(habitat.d3_40_colors_rgb, expected)
    assert habitat.d3_40_colors_rgb.dtype == np.uint8


def test_magnums_transformations_are_those_of_scipy() -> None:
    draw = np.random.default_rng(2)
    for _ in range(10):
        turn, place, point = (
            Rotation.from_rotvec(draw.normal(size=3)),
            draw.normal(size=3),
            draw.normal(size=3),
        )
        made = magnum.Matrix4.from_(turn.as_matrix(), place)
        np.testing.assert_allclose(made.transform_point(point), turn.apply(point) + place, atol=1e-12)
        np.testing.assert_allclose(
            made.inverted().transform_point(turn.apply(point) + place), point, atol=1e-12
        )
        np.testing.assert_allclose((made @ made.inverted()).rows, np.eye(4), atol=1e-12)
        np.testing.assert_allclose(made.translation, place)
        np.testing.assert_allclose(made.rotation().rows, turn.as_matrix(), atol=1e-12)
        back = magnum.Quaternion.from_matrix(turn.as_matrix())
        np.testing.assert_allclose(back.to_matrix().rows, turn.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(back.transform_vector(point), turn.apply(point), atol=1e-12)
        sheared = magnum.Matrix4.from_(turn.as_matrix() @ np.diag([1.0, 1.0, 1.0 + 1e-3]), place)
        whole = habitat.orthonormalize_rotation_shear(sheared).rotation_scaling().rows
        np.testing.assert_allclose(whole @ whole.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(whole, turn.as_matrix(), atol=1e-12)
    by_class = magnum.Matrix4.rotation(magnum.Deg(90.0), [0.0, 1.0, 0.0])
    np.testing.assert_allclose(by_class.transform_vector([1, 0, 0]), [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(by_class.rows, magnum.Matrix4.rotation_y(magnum.Deg(90.0)).rows)
    np.testing.assert_allclose(
        magnum.Matrix4.translation([1, 2, 3]).transform_point([0, 0, 1]), [1, 2, 4]
    )
    with pytest.raises(RlrError, match="rotation"):
        magnum.Quaternion.from_matrix(np.full((3, 3), math.nan))
    window = magnum.Range2D.from_size([1.0, 2.0], [4.0, 2.0])
    np.testing.assert_array_equal([window.min, window.max], [[1, 2], [5, 4]])
    np.testing.assert_array_equal(window.center(), [3, 3])
    assert window.contains([1.0, 2.0]) and not window.contains([5.0, 3.0])
    np.testing.assert_array_equal(magnum.Color4.green(0.5), [0, 0.5, 0, 1])


def test_a_velocity_takes_a_body_where_the_circle_is() -> None:
    """1 m/s ahead while turning by 90 degrees a second, in small steps: a circle of radius 2 / pi."""
    control = habitat.VelocityControl(
        [0, 0, -1], [0, 0.5 * math.pi, 0], True, True, lin_vel_is_local=True, ang_vel_is_local=True
    )
    state, steps = habitat.RigidState(), 4000
    for _ in range(steps):
        state = control.integrate_transform(1.0 / steps, state)
    radius = 2.0 / math.pi
    np.testing.assert_allclose(state.translation, [-radius, 0.0, -radius], atol=1e-3)
    np.testing.assert_allclose(state.rotation.transform_vector([0, 0, -1]), [-1, 0, 0], atol=1e-9)
    still = habitat.VelocityControl([1, 2, 3], [1, 0, 0])  # what is not controlled does nothing
    np.testing.assert_array_equal(still.integrate_transform(1.0, state).translation, state.translation)
    with pytest.raises(RlrError, match="dt"):
        control.integrate_transform(math.nan, state)


def test_random_rotations_are_even_and_the_global_seeds() -> None:
    """The images of an axis under even rotations have no mean, and each coordinate the variance 1 / 3."""
    np.random.seed(4)  # noqa: NPY002 # what clients seed
    turned = np.array(
        [habitat.quat_rotate_vector(habitat.random_quaternion(), [1, 0, 0]) for _ in range(4000)]
    )
    assert np.abs(turned.mean(axis=0) / np.sqrt(1.0 / 3.0 / len(turned))).max() < 4.0
    np.testing.assert_allclose(
        (turned**2).mean(axis=0), 1.0 / 3.0, atol=4.0 * np.sqrt(4.0 / 45.0 / len(turned))
    )
    np.random.seed(4)  # noqa: NPY002
    np.testing.assert_array_equal(
        habitat.quat_rotate_vector(habitat.random_quaternion(), [1, 0, 0]), turned[0]
    )


def test_profiles_are_refused_where_they_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HABITAT_PROFILING", raising=False)
    profiling.configure(1, 2)
    with profiling.RangeContext("part"):
        profiling.on_start_step()
    monkeypatch.setenv("HABITAT_PROFILING", "1")
    with pytest.raises(RlrError, match="HABITAT_PROFILING"):
        profiling.configure()


def test_a_simulator_goes_to_another_scene_and_takes_its_settings() -> None:
    sim, spec = camera("DEPTH", box())
    first, area = sim.scene, sim.pathfinder.navigable_area
    settings = habitat.NavMeshSettings(agent_radius=0.5)
    backend = habitat.SimulatorConfiguration(box(), navmesh_settings=settings)
    sim.reconfigure(
        habitat.Configuration(backend, [habitat.AgentConfiguration(sensor_specifications=[spec])])
    )
    assert sim.scene is not first and sim.pathfinder.navigable_area < area
    assert sim.pathfinder.nav_mesh_settings.agent_radius == 0.5
    assert sim.get_sensor("depth") is sim.sensors["depth"] is sim.get_agent(0).sensors["depth"]
    sim.step_physics(1.0)
    sim.remove_sensor("depth")
    assert sim.get_sensor_observations() == {}
    with pytest.raises(RlrError, match="no sensor 'depth'"):
        sim.get_sensor("depth")
