"""The audio sensor of habitat-sim (SoundSpaces 2) over this engine, without habitat-sim.

    import soundspaces_sim.rlr.habitat
    soundspaces_sim.rlr.habitat.install()      # from here on `import habitat_sim` is this
    import habitat_sim

Sound only: a `Simulator` here has agents that can be placed, audio sensors and a pathfinder, no pictures or
physics. Axes are habitat's: x right, y up, -z ahead. docs/rlr.md says what differs.
"""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

from soundspaces_sim.rlr.errors import RlrError
from soundspaces_sim.rlr.habitat.agent import Agent, AgentConfiguration, AgentState, SixDOFPose
from soundspaces_sim.rlr.habitat.pathfinder import PathFinder, ShortestPath
from soundspaces_sim.rlr.habitat.records import (
    AudioSensorSpec,
    Quaternion,
    RLRAudioPropagationChannelLayout,
    RLRAudioPropagationChannelLayoutType,
    RLRAudioPropagationConfiguration,
    SensorSubType,
    SensorType,
    quat_from_angle_axis,
)
from soundspaces_sim.rlr.habitat.sensor import AudioSensor
from soundspaces_sim.rlr.habitat.simulator import Configuration, Simulator, SimulatorConfiguration

__all__ = [
    "Agent",
    "AgentConfiguration",
    "AgentState",
    "AudioSensor",
    "AudioSensorSpec",
    "Configuration",
    "PathFinder",
    "Quaternion",
    "RLRAudioPropagationChannelLayout",
    "RLRAudioPropagationChannelLayoutType",
    "RLRAudioPropagationConfiguration",
    "SensorSubType",
    "SensorType",
    "ShortestPath",
    "Simulator",
    "SimulatorConfiguration",
    "SixDOFPose",
    "install",
    "quat_from_angle_axis",
]

NAME = "habitat_sim"
#: Modules of habitat-sim in which its clients look for these names.
_MODULES = (
    "",
    ".agent",
    ".bindings",
    ".nav",
    ".sensor",
    ".sim",
    ".simulator",
    ".utils.common",
    "._ext.habitat_sim_bindings",
)


def install() -> None:
    """Put these names under `habitat_sim` and those of its modules that clients take them from.

    Raises `RlrError` (a RuntimeError) if habitat-sim itself is installed or imported: it has cameras and more,
    and is not to be hidden.
    """
    present = sys.modules.get(NAME)
    if present is not None and getattr(present, "AudioSensor", None) is AudioSensor:
        return
    if present is not None or importlib.util.find_spec(NAME) is not None:
        raise RlrError(
            f"{NAME} is installed; take the names from soundspaces_sim.rlr.habitat instead, or remove it"
        )
    names = {name: globals()[name] for name in __all__ if name != "install"}
    for part in sorted((*_MODULES, "._ext", ".utils")):  # parents first
        module = ModuleType(NAME + part, "soundspaces_sim.rlr.habitat")
        module.__path__ = []
        vars(module).update(names if part in _MODULES else {})
        sys.modules[NAME + part] = module
        parent, _, child = (NAME + part).rpartition(".")
        if parent:
            setattr(sys.modules[parent], child, module)
