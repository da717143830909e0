"""Names, shapes and bounds of what an agent in continuous space perceives."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from soundspaces_sim.nav.sensor_table import POINTGOAL

_N_FFT, _HOP_S = 512, 0.01
_FARTHEST = 1000.0  # m


@dataclass(frozen=True)
class ContinuousSensor:
    """`shape(rate, block, depth_size)` of its float32 observation; `low`, `high`: bounds of all elements, or of
    each. `heard`: it is made of what is heard in a step."""

    shape: Callable[[int, int, int], tuple[int, ...]]
    low: tuple[float, ...]
    high: tuple[float, ...]
    heard: bool = False


def spectrogram_frames(block: int) -> int:
    """Columns of the spectrogram of a step (`auralise.spectrogram`): means of four, every 160 samples."""
    return -(-(block // 160 + 1) // 4)


def interaural_frames(rate: int, block: int) -> int:
    """Columns of `interaural`: every 10 ms, both ends included."""
    return block // round(_HOP_S * rate) + 1


CONTINUOUS_SENSORS: Mapping[str, ContinuousSensor] = {
    "audiogoal": ContinuousSensor(lambda _, block, __: (2, block), (-1000.0,), (1000.0,), True),
    "spectrogram": ContinuousSensor(
        lambda _, block, __: (65, spectrogram_frames(block), 2), (0.0,), (20.0,), True
    ),
    "interaural": ContinuousSensor(
        lambda rate, block, _: (4, _N_FFT // 2, interaural_frames(rate, block)),
        (-4.0,),
        (100_000.0,),
        True,
    ),
    "intensity": ContinuousSensor(lambda *_: (2,), (0.0,), (1000.0,), True),
    "depth": ContinuousSensor(lambda _, __, size: (size, size, 1), (0.0,), (1.0,)),
    POINTGOAL: ContinuousSensor(lambda *_: (2,), (0.0, -math.pi), (_FARTHEST, math.pi)),
    "pose": ContinuousSensor(
        lambda *_: (4,), (-_FARTHEST, -_FARTHEST, -math.pi, 0.0), (_FARTHEST, _FARTHEST, math.pi, 1e7)
    ),
    "collision": ContinuousSensor(lambda *_: (1,), (0.0,), (1.0,)),
}
