"""What one gives an audio sensor: configuration, channel layout, specification; and rotations.

Names, defaults and meanings are those of habitat-sim (docs/AUDIO.md there).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Any

import numpy as np

from soundspaces_sim.rlr.arguments import vector3
from soundspaces_sim.rlr.errors import RlrError
from soundspaces_sim.rlr.records import ChannelLayout, ChannelLayoutType, Config


class SensorType(Enum):
    """Kinds of sensors; of these there is one here."""

    AUDIO = "audio"


class SensorSubType(Enum):
    """What an audio sensor gives."""

    IMPULSERESPONSE = "impulse response"


class RLRAudioPropagationChannelLayoutType(IntEnum):
    """What a sensor hears with; loudspeaker layouts can be named but not simulated."""

    Unknown = 0
    Mono = 1
    Stereo = 2
    Binaural = 3
    Quad = 4
    Surround_5_1 = 5
    Surround_7_1 = 6
    Ambisonics = 7


@dataclass(slots=True)
class RLRAudioPropagationChannelLayout:
    """Kind and number of channels; `type` is another name of `channelType`."""

    channelType: RLRAudioPropagationChannelLayoutType = RLRAudioPropagationChannelLayoutType.Binaural  # noqa: N815
    channelCount: int = 2  # noqa: N815

    def layout(self) -> ChannelLayout:
        """The layout of a listener. Raises `RlrError` for one that cannot be simulated."""
        kinds = {t.name: t for t in ChannelLayoutType}
        name = getattr(self.channelType, "name", repr(self.channelType))
        if name not in kinds:
            raise RlrError(f"channelLayout: expected Mono, Binaural or Ambisonics, got {name}")
        layout = ChannelLayout(kinds[name], self.channelCount)
        _ = layout.channels
        return layout


def _set_kind(
    layout: RLRAudioPropagationChannelLayout, kind: RLRAudioPropagationChannelLayoutType
) -> None:
    layout.channelType = kind


# What later versions of habitat-sim call `channelType`; set here for the name is a builtin's.
setattr(  # noqa: B010
    RLRAudioPropagationChannelLayout,
    "type",
    property(lambda layout: layout.channelType, _set_kind),
)


@dataclass(slots=True)
class RLRAudioPropagationConfiguration:
    """Settings of the simulation; docs/rlr.md lists those that do nothing here. Other names are an
    AttributeError."""

    sampleRate: int = 44100  # noqa: N815
    frequencyBands: int = 4  # noqa: N815
    directSHOrder: int = 3  # noqa: N815
    indirectSHOrder: int = 1  # noqa: N815
    threadCount: int = 1  # noqa: N815
    updateDt: float = 0.02  # noqa: N815
    irTime: float = 4.0  # noqa: N815 # s
    unitScale: float = 1.0  # noqa: N815
    globalVolume: float = 0.25  # noqa: N815
    indirectRayCount: int = 5000  # noqa: N815
    indirectRayDepth: int = 200  # noqa: N815
    sourceRayCount: int = 200  # noqa: N815
    sourceRayDepth: int = 10  # noqa: N815
    maxDiffractionOrder: int = 10  # noqa: N815
    direct: bool = True
    indirect: bool = True
    diffraction: bool = True
    transmission: bool = False
    meshSimplification: bool = False  # noqa: N815
    temporalCoherence: bool = False  # noqa: N815
    dumpWaveFiles: bool = False  # noqa: N815
    enableMaterials: bool = True  # noqa: N815
    writeIrToFile: bool = False  # noqa: N815

    def config(self) -> Config:
        """These settings for a `Context`."""
        return Config(
            frequency_bands=self.frequencyBands,
            direct_sh_order=self.directSHOrder,
            indirect_sh_order=self.indirectSHOrder,
            thread_count=self.threadCount,
            sample_rate=self.sampleRate,
            max_ir_length=self.irTime,
            unit_scale=self.unitScale,
            global_volume=self.globalVolume,
            indirect_ray_count=self.indirectRayCount,
            indirect_ray_depth=self.indirectRayDepth,
            source_ray_count=self.sourceRayCount,
            source_ray_depth=self.sourceRayDepth,
            max_diffraction_order=self.maxDiffractionOrder,
            direct=self.direct,
            indirect=self.indirect,
            diffraction=self.diffraction,
            transmission=self.transmission,
            mesh_simplification=self.meshSimplification,
            temporal_coherence=self.temporalCoherence,
        )


@dataclass
class AudioSensorSpec:
    """An audio sensor to be. `position` (3,) m is in the agent's frame. `enableMaterials` counts where later
    versions of habitat-sim have it, beside `acousticsConfig.enableMaterials`: either switches materials off."""

    uuid: str = "audio"
    sensor_type: SensorType = SensorType.AUDIO
    sensor_subtype: SensorSubType = SensorSubType.IMPULSERESPONSE
    position: Sequence[float] = field(default_factory=lambda: [0.0, 1.5, 0.0])
    orientation: Sequence[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    outputDirectory: str = ""  # noqa: N815
    acousticsConfig: RLRAudioPropagationConfiguration = field(  # noqa: N815
        default_factory=RLRAudioPropagationConfiguration
    )
    channelLayout: RLRAudioPropagationChannelLayout = field(  # noqa: N815
        default_factory=RLRAudioPropagationChannelLayout
    )
    enableMaterials: bool = True  # noqa: N815


@dataclass(frozen=True)
class Quaternion:
    """w + x i + y j + z k."""

    w: float = 1.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


def quat_from_angle_axis(theta: float, axis: Sequence[float]) -> Quaternion:
    """The rotation by `theta` rad about `axis` (3,)."""
    direction = np.array(vector3(axis, "quat_from_angle_axis"))
    x, y, z = math.sin(0.5 * theta) * direction / np.linalg.norm(direction)
    return Quaternion(math.cos(0.5 * theta), float(x), float(y), float(z))


def as_wxyz(rotation: Any, what: str) -> list[float]:
    """[w, x, y, z] of a rotation: anything with w, x, y and z, with a scalar and a vector (Magnum), or
    [x, y, z, w], as habitat takes lists. Raises TypeError."""
    if all(hasattr(rotation, name) for name in "wxyz"):
        return [float(getattr(rotation, name)) for name in "wxyz"]
    if hasattr(rotation, "scalar") and hasattr(rotation, "vector"):
        return [float(rotation.scalar), *vector3(rotation.vector, what)]
    try:
        x, y, z, w = (float(v) for v in rotation)
    except (TypeError, ValueError):
        raise TypeError(f"{what}: expected a quaternion or [x, y, z, w], got {rotation!r}") from None
    return [w, x, y, z]


def to_habitat(points: np.ndarray) -> np.ndarray:
    """Scene axes (z up) to habitat's (y up, -z is the scene's y); (…, 3)."""
    return np.asarray(points[..., [0, 2, 1]] * [1.0, 1.0, -1.0])


def from_habitat(points: np.ndarray) -> np.ndarray:
    """Habitat's axes to a scene's; (…, 3)."""
    return np.asarray(points[..., [0, 2, 1]] * [1.0, -1.0, 1.0])
