"""Sensors by name. A new one is a module with its record, and its line in the table."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.nav.audio_sensor import frames
from soundspaces_sim.nav.episodes import Episode
from soundspaces_sim.nav.navigation_graph import NavigationGraph
from soundspaces_sim.nav.views import Views

# Half precision to single, by table: six times as fast as NumPy's cast.

#: Single-precision value of every half-precision number, by its bits.
SINGLE_OF_HALF = np.arange(65536, dtype=np.uint16).view(np.float16).astype(np.float32)


@kernel
def widen(table: np.ndarray, bits: np.ndarray, out: np.ndarray) -> None:
    """Half-precision numbers, as bits (n,), into single precision, by table."""
    for i in range(len(bits)):
        out[i] = table[bits[i]]


POINTGOAL = "pointgoal_with_gps_compass"


class Scenes(Protocol):
    """What sensors may ask of the environment (`sensors.SensorSuite`)."""

    gps_sigma: float

    def views(self, scene: str) -> Views: ...


class Walk(Protocol):
    """What sensors may ask of an episode under way (`episode_state.EpisodeState`)."""

    graph: NavigationGraph
    episode: Episode
    pose: int
    collided: bool

    @property
    def node(self) -> int: ...


Observe = Callable[[Scenes, Walk, np.random.Generator, np.ndarray], None]


@dataclass(frozen=True)
class Sensor:
    """`shape(rate, depth_size)` of its float32 observation; `low`, `high`: least and largest value, one for all
    elements or one per element. `observe(scenes, state, rng, into)` writes an observation; None for sensors that
    hear, whose observations `SensorSuite` renders together."""

    shape: Callable[[int, int], tuple[int, ...]]
    low: tuple[float, ...]
    high: tuple[float, ...]
    observe: Observe | None = None

    @property
    def heard(self) -> bool:
        return self.observe is None


def pointgoal(state: Walk, sigma: float, rng: np.random.Generator) -> tuple[float, float]:
    """(distance m, angle rad, left positive) of the goal, as Habitat's POLAR; `sigma`: of normal noise on both
    components of the displacement, m."""
    points = state.graph.points
    dx, dy = (float(v) for v in points[state.episode.goal, :2] - points[state.node, :2])
    if sigma > 0.0:
        noise = rng.standard_normal(2)
        dx, dy = dx + sigma * float(noise[0]), dy + sigma * float(noise[1])
    ahead, left = ((dx, dy), (dy, -dx), (-dx, -dy), (-dy, dx))[state.pose & 3]
    return min(math.hypot(dx, dy), 1000.0), math.atan2(left + 0.0, ahead + 0.0)


def _see(scenes: Scenes, state: Walk, _rng: np.random.Generator, into: np.ndarray) -> None:
    picture = scenes.views(state.episode.scene).at(state.node)[state.pose & 3]
    widen(SINGLE_OF_HALF, picture.view(np.uint16).reshape(-1), into.reshape(-1))


def _locate(scenes: Scenes, state: Walk, rng: np.random.Generator, into: np.ndarray) -> None:
    into[:] = pointgoal(state, scenes.gps_sigma, rng)


def _bump(_scenes: Scenes, state: Walk, _rng: np.random.Generator, into: np.ndarray) -> None:
    into[0] = state.collided


SENSOR_TABLE: Mapping[str, Sensor] = {
    "spectrogram": Sensor(lambda rate, _: (65, frames(rate), 2), (0.0,), (20.0,)),
    "audiogoal": Sensor(lambda rate, _: (2, rate), (-1000.0,), (1000.0,)),
    "intensity": Sensor(lambda *_: (2,), (0.0,), (1000.0,)),
    "depth": Sensor(lambda _, size: (size, size, 1), (0.0,), (1.0,), _see),
    POINTGOAL: Sensor(lambda *_: (2,), (0.0, -math.pi), (1000.0, math.pi), _locate),
    "collision": Sensor(lambda *_: (1,), (0.0,), (1.0,), _bump),
}
