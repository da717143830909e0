"""The records of the interface: configuration, channel layout, materials of a box, ray.

They are mutable, as clients expect, and check types when a field is set, as the original's bindings do.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from soundspaces_rlr.arguments import vector3
from soundspaces_rlr.errors import RlrError
from soundspaces_sim.parts import DEFAULT_BANDS, LONGEST_RESPONSE as LONGEST, MOST_BANDS

# The bands of RLR are equally wide in octaves between these; four of them are those of SoundSpaces.
_LOWEST, _HIGHEST = 40.0, 15000.0
_MOST_CHANNELS = 1024  # order 31


@dataclass(slots=True)
class Config:
    """Settings of a `Context`; the defaults are those of `rlr_audio_propagation` 0.0.1.

    Flags are ints. README.md lists what each field does here, and which do nothing.
    """

    size: int = 146
    frequency_bands: int = 4
    direct_sh_order: int = 3
    indirect_sh_order: int = 1
    direct_ray_count: int = 500
    indirect_ray_count: int = 5000
    indirect_ray_depth: int = 200
    source_ray_count: int = 200
    source_ray_depth: int = 10
    max_diffraction_order: int = 10
    thread_count: int = 1
    sample_rate: float = 44100.0  # Hz
    max_ir_length: float = 4.0  # s
    unit_scale: float = 1.0  # m per unit of length of meshes and positions
    global_volume: float = 1.0  # amplitude
    hrtf_right: list[float] = field(default_factory=lambda: [1.0, 0.0, 0.0])
    hrtf_up: list[float] = field(default_factory=lambda: [0.0, 1.0, 0.0])
    hrtf_back: list[float] = field(default_factory=lambda: [0.0, 0.0, 1.0])
    direct: int = 1
    indirect: int = 1
    diffraction: int = 1
    transmission: int = 1
    mesh_simplification: int = 0
    temporal_coherence: int = 0

    def __setattr__(self, name: str, value: Any) -> None:
        kind = self.__dataclass_fields__[name].type if name in self.__dataclass_fields__ else None
        try:
            if kind == "int":
                value = int(operator.index(value))  # True is 1
            elif kind == "float":
                value = float(value)
            elif kind == "list[float]":
                value = vector3(value, name)
        except (TypeError, ValueError):
            raise TypeError(f"Config.{name}: expected {kind}, got {value!r}") from None
        object.__setattr__(self, name, value)


# Least and most of what a context is given; of counts and depths that do nothing here, any will do.
_LIMITS = {
    "frequency_bands": (1, MOST_BANDS),
    "indirect_ray_count": (0, 5_000_000),
    "indirect_ray_depth": (0, 1_000_000),
    "sample_rate": (8000.0, 192_000.0),
    "max_ir_length": (1e-3, LONGEST),
    "unit_scale": (1e-6, 1e6),
    "global_volume": (-1e6, 1e6),
}


def check_config(config: Config) -> None:
    """Raise `RlrError` for settings that are not finite or out of range."""
    for name, (least, most) in _LIMITS.items():
        value = getattr(config, name)
        if not least <= value <= most:
            raise RlrError(f"Config.{name}: expected {least:g} to {most:g}, got {value}")


def band_edges(bands: int) -> tuple[float, ...]:
    """Edges in Hz of RLR's bands: equally wide in octaves; four are 176, 775 and 3409 Hz between 0 and 20 kHz."""
    if bands == len(DEFAULT_BANDS) - 1:
        return DEFAULT_BANDS
    inner = _LOWEST * (_HIGHEST / _LOWEST) ** (np.arange(1, bands) / bands)
    return (0.0, *(float(edge) for edge in inner), DEFAULT_BANDS[-1])


class ChannelLayoutType(IntEnum):
    """What a listener hears with."""

    Unknown = 0
    Mono = 1
    Binaural = 3
    Ambisonics = 7


@dataclass(slots=True)
class ChannelLayout:
    """Kind of a listener and how many channels it has.

    Mono has one and binaural two (left, right), whatever `channel_count` says; ambisonics have
    `channel_count` in ACN order, N3D, world axes.
    """

    type: ChannelLayoutType
    channel_count: int

    def __post_init__(self) -> None:
        if not isinstance(self.type, ChannelLayoutType):
            raise TypeError(f"ChannelLayout: expected a ChannelLayoutType, got {self.type!r}")
        self.channel_count = operator.index(self.channel_count)

    @property
    def channels(self) -> int:
        """Channels of the responses. Raises `RlrError` for a layout that no listener can have."""
        if self.type is ChannelLayoutType.Unknown or not 1 <= self.channel_count <= _MOST_CHANNELS:
            raise RlrError(
                f"ChannelLayout: expected Mono, Binaural or Ambisonics and 1 to {_MOST_CHANNELS} channels, got "
                f"{self.type.name} and {self.channel_count}"
            )
        fixed = {ChannelLayoutType.Mono: 1, ChannelLayoutType.Binaural: 2}
        return fixed.get(self.type, self.channel_count)


@dataclass(slots=True)
class BoxMaterialCategories:
    """Material category of each side of a box; None is the default material."""

    x_min: str | None = None
    x_max: str | None = None
    y_min: str | None = None
    y_max: str | None = None
    z_min: str | None = None
    z_max: str | None = None


@dataclass(slots=True)
class Ray:
    """A ray from `origin` along `direction`, between `t_min` and `t_max` in lengths of `direction`."""

    origin: Sequence[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    direction: Sequence[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    t_min: float = 0.0
    t_max: float = 0.0
    hit: bool = False
    normal: Sequence[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
