"""What one gives an audio sensor: configuration, channel layout, specification.

Names, defaults and meanings are those of habitat-sim (docs/AUDIO.md there).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum

import numpy as np

from soundspaces_rlr.arguments import vector3
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.records import ChannelLayout, ChannelLayoutType, Config


class SensorType(Enum):
    """Kinds of sensors."""

    NONE = "none"
    COLOR = "color"
    DEPTH = "depth"
    SEMANTIC = "semantic"
    AUDIO = "audio"


class SensorSubType(Enum):
    """What a camera projects by, or what an audio sensor gives; of cameras, only `PINHOLE` can be drawn."""

    NONE = "none"
    PINHOLE = "pinhole"
    ORTHOGRAPHIC = "orthographic"
    FISHEYE = "fisheye"
    EQUIRECTANGULAR = "equirectangular"
    IMPULSERESPONSE = "impulse response"


class FisheyeSensorModelType(Enum):
    """What a camera with a fisheye projects by; it can be named, not drawn."""

    DOUBLE_SPHERE = "double sphere"


class SensorSpec:
    """What the specifications of sensors have in common: `uuid`, `sensor_type`, `position`, `orientation`."""

    uuid: str
    sensor_type: SensorType
    sensor_subtype: SensorSubType
    position: Sequence[float]
    orientation: Sequence[float]


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
    """Settings of the simulation; README.md lists those that do nothing here. `maxIRLength` is what later
    versions of habitat-sim call `irTime`. Other names are an AttributeError."""

    sampleRate: int = 44100  # noqa: N815
    frequencyBands: int = 4  # noqa: N815
    directSHOrder: int = 3  # noqa: N815
    indirectSHOrder: int = 1  # noqa: N815
    threadCount: int = 1  # noqa: N815
    updateDt: float = 0.02  # noqa: N815
    irTime: float = 4.0  # noqa: N815 # s
    unitScale: float = 1.0  # noqa: N815
    globalVolume: float = 0.25  # noqa: N815
    directRayCount: int = 500  # noqa: N815
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
    hrtfRight: Sequence[float] = (1.0, 0.0, 0.0)  # noqa: N815 # axes of the HRTF in the head's frame
    hrtfUp: Sequence[float] = (0.0, 1.0, 0.0)  # noqa: N815
    hrtfBack: Sequence[float] = (0.0, 0.0, 1.0)  # noqa: N815

    @property
    def maxIRLength(self) -> float:  # noqa: N802
        """`irTime`, s."""
        return self.irTime

    @maxIRLength.setter
    def maxIRLength(self, seconds: float) -> None:  # noqa: N802
        self.irTime = seconds

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
            direct_ray_count=self.directRayCount,
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
            hrtf_right=vector3(self.hrtfRight, "hrtfRight"),
            hrtf_up=vector3(self.hrtfUp, "hrtfUp"),
            hrtf_back=vector3(self.hrtfBack, "hrtfBack"),
        )


@dataclass
class AudioSensorSpec(SensorSpec):
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


def to_habitat(points: np.ndarray) -> np.ndarray:
    """Scene axes (z up) to habitat's (y up, -z is the scene's y); (…, 3)."""
    return np.asarray(points[..., [0, 2, 1]] * [1.0, 1.0, -1.0])


def from_habitat(points: np.ndarray) -> np.ndarray:
    """Habitat's axes to a scene's; (…, 3)."""
    return np.asarray(points[..., [0, 2, 1]] * [1.0, -1.0, 1.0])
