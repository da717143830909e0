"""The audio sensor of habitat-sim (SoundSpaces 2) over this engine, without habitat-sim.

    import soundspaces_rlr.habitat
    soundspaces_rlr.habitat.install()      # from here on `import habitat_sim` is this
    import habitat_sim

A `Simulator` here has agents that walk, audio sensors, cameras of depth and labels, and a pathfinder; no renderer
and no physics: what concerns those can be imported, and says so when it is used (`refused.py`). Axes are
habitat's: x right, y up, -z ahead. README.md says what differs. `attach` gives our
audio sensor to a simulator of habitat-sim itself.
"""

from __future__ import annotations

import importlib.util
import logging
import sys
from types import ModuleType
from typing import Any

import numpy as np

from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat import magnum, profiling
from soundspaces_rlr.habitat.agent import Agent, AgentConfiguration, AgentState, SixDOFPose
from soundspaces_rlr.habitat.attachment import attach, detach
from soundspaces_rlr.habitat.camera import CameraSensor, CameraSensorSpec
from soundspaces_rlr.habitat.colors import d3_40_colors_rgb
from soundspaces_rlr.habitat.controls import ActionSpec, ActuationSpec
from soundspaces_rlr.habitat.floor import NavMeshSettings
from soundspaces_rlr.habitat.follower import GreedyFollowerError, GreedyGeodesicFollower
from soundspaces_rlr.habitat.magnum import orthonormalize_rotation_shear, quat_to_magnum
from soundspaces_rlr.habitat.motion import (
    JointType,
    MotionType,
    RigidConstraintType,
    RigidState,
    VelocityControl,
)
from soundspaces_rlr.habitat.pathfinder import MultiGoalShortestPath, PathFinder, ShortestPath
from soundspaces_rlr.habitat.records import (
    AudioSensorSpec,
    FisheyeSensorModelType,
    RLRAudioPropagationChannelLayout,
    RLRAudioPropagationChannelLayoutType,
    RLRAudioPropagationConfiguration,
    SensorSpec,
    SensorSubType,
    SensorType,
)
from soundspaces_rlr.habitat.refused import CORRADE, refuse_in, refused_names
from soundspaces_rlr.habitat.rotations import (
    Quaternion,
    angle_between_quats,
    quat_from_angle_axis,
    quat_from_coeffs,
    quat_from_magnum,
    quat_from_two_vectors,
    quat_rotate_vector,
    quat_to_angle_axis,
    quat_to_coeffs,
    random_quaternion,
)
from soundspaces_rlr.habitat.semantic import SemanticScene
from soundspaces_rlr.habitat.sensor import AudioSensor
from soundspaces_rlr.habitat.simulator import (
    Configuration,
    Simulator,
    SimulatorBackend,
    SimulatorConfiguration,
)

#: Version of habitat-sim whose names these are: the one that SoundSpaces 2 was released for.
__version__ = "0.2.2"
audio_enabled = True
built_with_bullet = cuda_enabled = vhacd_enabled = False

__all__ = [
    "ActionSpec",
    "ActuationSpec",
    "Agent",
    "AgentConfiguration",
    "AgentState",
    "AudioSensor",
    "AudioSensorSpec",
    "CameraSensor",
    "CameraSensorSpec",
    "Configuration",
    "FisheyeSensorModelType",
    "GreedyFollowerError",
    "GreedyGeodesicFollower",
    "JointType",
    "MotionType",
    "MultiGoalShortestPath",
    "NavMeshSettings",
    "PathFinder",
    "Quaternion",
    "RLRAudioPropagationChannelLayout",
    "RLRAudioPropagationChannelLayoutType",
    "RLRAudioPropagationConfiguration",
    "RigidConstraintType",
    "RigidState",
    "SemanticScene",
    "SensorSpec",
    "SensorSubType",
    "SensorType",
    "ShortestPath",
    "Simulator",
    "SimulatorBackend",
    "SimulatorConfiguration",
    "SixDOFPose",
    "VelocityControl",
    "angle_between_quats",
    "attach",
    "audio_enabled",
    "built_with_bullet",
    "cuda_enabled",
    "d3_40_colors_rgb",
    "detach",
    "install",
    "orthonormalize_rotation_shear",
    "quat_from_angle_axis",
    "quat_from_coeffs",
    "quat_from_magnum",
    "quat_from_two_vectors",
    "quat_rotate_vector",
    "quat_to_angle_axis",
    "quat_to_coeffs",
    "quat_to_magnum",
    "random_quaternion",
    "vhacd_enabled",
]

NAME = "habitat_sim"
_OURS = ("attach", "detach", "install")  # no names of habitat-sim's
#: Modules of habitat-sim in which its clients look for these names.
_MODULES = (
    "",
    ".agent",
    ".agent.controls",
    ".agent.agent",
    ".bindings",
    ".errors",
    ".nav",
    ".physics",
    ".sensor",
    ".sim",
    ".simulator",
    ".utils",
    ".utils.common",
    "._ext.habitat_sim_bindings",
)
#: What single modules have beside them.
_GEO = {
    name: np.array(axis, float)
    for name, axis in {
        "UP": (0, 1, 0), "GRAVITY": (0, -1, 0), "FRONT": (0, 0, -1), "BACK": (0, 0, 1), "LEFT": (-1, 0, 0),
        "RIGHT": (1, 0, 0),
    }.items()
}  # fmt: skip
_MORE: dict[str, dict[str, Any]] = {
    "geo": _GEO,
    "logging": {"logger": logging.getLogger(NAME)},
    "utils.profiling_utils": vars(profiling),
}


def install() -> None:
    """Put these names under `habitat_sim` and those of its modules that clients take them from; and as much of
    `magnum` as they use, where that is not installed.

    Raises `RlrError` (a RuntimeError) if habitat-sim itself is installed or imported: it has cameras and more,
    and is not to be hidden.
    """
    present = sys.modules.get(NAME)
    if present is not None and getattr(present, "AudioSensor", None) is AudioSensor:
        return
    if present is not None or importlib.util.find_spec(NAME) is not None:
        raise RlrError(
            f"{NAME} is installed; take the names from soundspaces_rlr.habitat instead, give its simulator our "
            "sensor by soundspaces_rlr.habitat.attach, or remove it"
        )
    shared = {name: globals()[name] for name in __all__ if name not in _OURS}
    shared["__version__"] = __version__
    contents: dict[str, dict[str, Any]] = {part.lstrip("."): dict(shared) for part in _MODULES}
    for more in (refused_names(NAME), _MORE):
        for part, found in more.items():
            contents.setdefault(part, {}).update(found)
    contents[""].update(contents["sensor"])  # names of all sensors stand at the top too
    for part in sorted((*contents, "_ext")):  # parents first
        full = f"{NAME}.{part}" if part else NAME
        module = ModuleType(full, "soundspaces_rlr.habitat")
        module.__path__ = []
        vars(module).update(
            {
                k: v
                for k, v in contents.get(part, {}).items()
                if not k.startswith("__") or k == "__version__"
            }
        )
        sys.modules[full] = module
        parent, _, child = full.rpartition(".")
        if parent:
            setattr(sys.modules[parent], child, module)
    if "magnum" not in sys.modules and importlib.util.find_spec("magnum") is None:
        sys.modules["magnum"] = magnum
    if "corrade" not in sys.modules and importlib.util.find_spec("corrade") is None:
        sys.modules["corrade"] = corrade = ModuleType("corrade", "soundspaces_rlr.habitat")
        refuse_in(corrade, "corrade", CORRADE)
