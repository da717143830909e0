"""The audio sensor of habitat-sim (SoundSpaces 2) over this engine, without habitat-sim.

    import soundspaces_rlr.habitat
    soundspaces_rlr.habitat.install()      # from here on `import habitat_sim` is this
    import habitat_sim

A `Simulator` here has agents that walk, audio sensors, cameras of depth and labels, and a pathfinder; no renderer
and no physics. Axes are habitat's: x right, y up, -z ahead. README.md says what differs. `attach` gives our
audio sensor to a simulator of habitat-sim itself.
"""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat import magnum
from soundspaces_rlr.habitat.agent import Agent, AgentConfiguration, AgentState, SixDOFPose
from soundspaces_rlr.habitat.attachment import attach, detach
from soundspaces_rlr.habitat.camera import CameraSensor, CameraSensorSpec
from soundspaces_rlr.habitat.controls import ActionSpec, ActuationSpec
from soundspaces_rlr.habitat.floor import NavMeshSettings
from soundspaces_rlr.habitat.follower import GreedyFollowerError, GreedyGeodesicFollower
from soundspaces_rlr.habitat.pathfinder import PathFinder, ShortestPath
from soundspaces_rlr.habitat.records import (
    AudioSensorSpec,
    RLRAudioPropagationChannelLayout,
    RLRAudioPropagationChannelLayoutType,
    RLRAudioPropagationConfiguration,
    SensorSubType,
    SensorType,
)
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
)
from soundspaces_rlr.habitat.semantic import SemanticScene
from soundspaces_rlr.habitat.sensor import AudioSensor
from soundspaces_rlr.habitat.simulator import Configuration, Simulator, SimulatorConfiguration

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
    "GreedyFollowerError",
    "GreedyGeodesicFollower",
    "NavMeshSettings",
    "PathFinder",
    "Quaternion",
    "RLRAudioPropagationChannelLayout",
    "RLRAudioPropagationChannelLayoutType",
    "RLRAudioPropagationConfiguration",
    "SemanticScene",
    "SensorSubType",
    "SensorType",
    "ShortestPath",
    "Simulator",
    "SimulatorConfiguration",
    "SixDOFPose",
    "angle_between_quats",
    "attach",
    "audio_enabled",
    "built_with_bullet",
    "cuda_enabled",
    "detach",
    "install",
    "quat_from_angle_axis",
    "quat_from_coeffs",
    "quat_from_magnum",
    "quat_from_two_vectors",
    "quat_rotate_vector",
    "quat_to_angle_axis",
    "quat_to_coeffs",
    "vhacd_enabled",
]

NAME = "habitat_sim"
_OURS = ("attach", "detach", "install")  # no names of habitat-sim's
#: Modules of habitat-sim in which its clients look for these names.
_MODULES = (
    "",
    ".agent",
    ".agent.controls",
    ".bindings",
    ".errors",
    ".nav",
    ".sensor",
    ".sim",
    ".simulator",
    ".utils",
    ".utils.common",
    "._ext.habitat_sim_bindings",
)


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
    names = {name: globals()[name] for name in __all__ if name not in _OURS}
    for part in sorted((*_MODULES, "._ext")):  # parents first
        module = ModuleType(NAME + part, "soundspaces_rlr.habitat")
        module.__path__ = []
        vars(module).update({**names, "__version__": __version__} if part in _MODULES else {})
        sys.modules[NAME + part] = module
        parent, _, child = (NAME + part).rpartition(".")
        if parent:
            setattr(sys.modules[parent], child, module)
    if "magnum" not in sys.modules and importlib.util.find_spec("magnum") is None:
        sys.modules["magnum"] = magnum
