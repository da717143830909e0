"""A scene in the kernels' form, under one config and seed.

`PreparedScene` depends on scene and config alone, `Model` adds seed and duration. Techniques keep on either what
they make of it: `owner.once(make)` is `make(owner)`, made when it is first asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.errors import PointError
from soundspaces_sim.core.limits import LONGEST
from soundspaces_sim.echogram.reflection_counts import MaterialGroups
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.bsdf.surface import Surfaces
from soundspaces_sim.transport.state import World

EARLY_S = 0.08  # end of the early window after the direct sound's time (ISO 3382-1: C80)
AIR_STEP = 0.1  # m, between entries of tables of air
_FAR, _APART = 2000.0, 100  # m, steps: see `air_table`

Prepare = Callable[[Scene, SimulationConfig], Any]
_Made = TypeVar("_Made")


@dataclass(frozen=True)
class Once:
    """Keeps what is made of it, under the function that makes it; a copy by `dataclasses.replace` starts empty."""

    _made: dict[Callable[..., Any], Any] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def once(self, make: Callable[..., _Made]) -> _Made:
        """`make(self)`, made when it is first asked for."""
        if make not in self._made:
            self._made[make] = make(self)
        found: _Made = self._made[make]
        return found


@dataclass(frozen=True)
class PreparedScene(Once):
    """A scene under a config: how its surfaces answer, and what techniques have prepared (`Technique.prepare`)."""

    scene: Scene
    config: SimulationConfig
    geometry: Geometry  # of which `material` are rows of `surfaces`
    surfaces: Surfaces
    parts: Mapping[Prepare, Any]  # by the function that prepared them
    groups: MaterialGroups  # whose reflections are counted; none, if the config does not want counts
    thin: np.ndarray  # (F,) which faces are of closed thin bodies, see `windings.Sides`

    def part(self, prepare: Callable[[Scene, SimulationConfig], _Made]) -> _Made:
        """What `prepare` has made of the scene."""
        found: _Made = self.parts[prepare]
        return found


@dataclass(frozen=True)
class Model(Once):
    """A prepared scene under a seed, for echograms of `duration` s."""

    prepared: PreparedScene
    seed: int
    duration: float
    time_edges: np.ndarray  # (bins + 1,) s
    world: World
    notes: tuple[str, ...] = ()  # on what was left to the job
    points: int = 0  # of the job
    asked: SimulationConfig | None = None  # the config before what it leaves to the job was decided
    earlier: Model | None = None  # that of the first round, of a later one

    @property
    def first(self) -> Model:
        """Of the first round: keeps what is the same in all of them."""
        return self.earlier or self

    @property
    def scene(self) -> Scene:
        return self.prepared.scene

    @property
    def config(self) -> SimulationConfig:
        return self.prepared.config

    @property
    def windows(self) -> int:
        """Number of windows of time in which error bars are kept."""
        return int(self.world.window_of_bin[-1]) + 1


def time_bins(config: SimulationConfig, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Edges (bins + 1,) that cover `duration`, and the bin of each step of the first width."""
    first = config.time_grid[0][1]
    edges = [0.0]
    for k, (_, width) in enumerate(config.time_grid):
        last = config.time_grid[k + 1][0] if k + 1 < len(config.time_grid) else np.inf
        while edges[-1] < min(last, duration) - 1e-9:
            edges.append(round((edges[-1] + width) / first) * first)
    array = np.array(edges)
    steps = np.rint(np.diff(array) / first).astype(np.int64)
    return array, np.repeat(np.arange(len(steps)), steps)


def late_from(config: SimulationConfig, edges: np.ndarray) -> float:
    """The first edge of a bin, s, from which on nothing is connected any more; the last one if there is none."""
    later = edges[edges > config.connections.window - 1e-9]
    return float(later.min(initial=edges[-1]))


def air_transmission(config: SimulationConfig, lengths: np.ndarray) -> np.ndarray:
    """(…, b) share of every band's energy that air leaves after paths of `lengths` (…) m: between the same lengths
    that kernels interpolate between."""
    longest = float(lengths.max(initial=0.0))
    if not longest <= LONGEST * config.c:
        raise PointError(
            f"sound goes {longest:,.0f} m between two points, in {longest / config.c:,.0f} s, where {LONGEST:g} s "
            "is the most; check the unit"
        )
    table = _kept_table(config, int(longest / AIR_STEP))
    at = np.arange(len(table)) * AIR_STEP
    return np.stack([np.interp(lengths, at, column) for column in table.T], axis=-1)


@lru_cache(maxsize=256)  # single places ask for one length at a time
def _kept_table(config: SimulationConfig, steps: int) -> np.ndarray:
    """`air_table` of so many steps of `AIR_STEP`, not to be written to."""
    table = air_table(config, (steps + 0.5) * AIR_STEP, AIR_STEP)
    table.flags.writeable = False
    return table


def air_table(config: SimulationConfig, longest: float, step: float) -> np.ndarray:
    """(steps, b) what air leaves after every `step` m, a little past `longest` m.

    From `_FAR` on exponential between some steps: a band's rate of loss hardly changes there, for the frequencies
    that air takes most of are gone; within 10^-5 of the band's own (a test compares).
    """
    near, count = math.ceil(_FAR / step), int(longest / step) + 3
    if count > near:  # the same after a length, whatever is the longest
        count = near + 1 - (near - count) // _APART * _APART
    lengths = np.arange(count) * step
    if config.air is None:
        return np.ones((len(lengths), len(config.bands) - 1))
    if count <= near:
        return config.air.transmission(config.bands, lengths)
    chosen = np.arange(near, count, _APART)
    left = np.maximum(config.air.transmission(config.bands, lengths[chosen]), np.finfo(float).tiny)
    far = [np.exp(np.interp(lengths[near:], lengths[chosen], np.log(column))) for column in left.T]
    return np.concatenate(
        [config.air.transmission(config.bands, lengths[:near]), np.stack(far, axis=-1)]
    )
