"""A technique: a way of making paths, with all that it needs of a scene, a side and a tile.

    prepare(scene, config)                each made once per scene; `PreparedScene.part(prepare)` gives it
    mark(facets, prepared, duration)      facets on which subpaths leave paths to it
    trace(own, other)                     a function that traces subpaths of some rows of `own`: it fills `tables`
                                          of what they deposit at points of `other` and `vertices` for connections,
                                          and returns first reflections for radiance transfer
    connect(tile)                         what arrives discretely, which is made of pairs of points alone
    join(tile, of_a, of_b, sums)          what is made of pairs of walks, added to the sums of a tile
    settle(model, points)                 the config with what it leaves to a job of so many points decided
    describe(model)                       a line for the log: whether it takes part, and why

`Side.once` keeps what depends on the points of a side, `Model.once` what depends on duration and seed. Every path
is made by one technique or by several whose weights sum to one (`paths.mis`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.transport.model import Model, Prepare, PreparedScene
from soundspaces_sim.transport.radiance_transfer.patches import Patches
from soundspaces_sim.transport.state import ReflectionBlock, Tables, Vertices
from soundspaces_sim.transport.tile import Arrived, Side, Sums, Tile, Walks


class Facets(NamedTuple):
    """The triangles as subpaths see them: the specular plane (`geometry.plane`) and the patch of each."""

    geometry: Geometry
    patches: Patches


Mark = Callable[[Facets, PreparedScene, float], Facets]
TraceRows = Callable[[slice, Tables, Vertices], ReflectionBlock | None]
Trace = Callable[[Side, Side], TraceRows]
Connect = Callable[[Tile], Arrived]
Join = Callable[[Tile, Walks, Walks, Sums], None]


@dataclass(frozen=True)
class Technique:
    """`paths`: those it makes, for people. `requires`: names of techniques whose results it takes; they run before
    it."""

    name: str
    paths: str
    prepare: tuple[Prepare, ...] = ()
    mark: Mark | None = None
    trace: Trace | None = None
    connect: Connect | None = None
    join: Join | None = None
    requires: tuple[str, ...] = ()
    settle: Callable[[Model, int], SimulationConfig] | None = None
    describe: Callable[[Model], str] | None = None


def check_requirements(techniques: Sequence[Technique]) -> None:
    """Raise `ConfigError` unless every technique comes after those that it requires."""
    before: set[str] = set()
    for technique in techniques:
        missing = [name for name in technique.requires if name not in before]
        if missing:
            raise ConfigError(
                f"technique {technique.name}: needs {', '.join(missing)} before it, among "
                f"{', '.join(t.name for t in techniques)}"
            )
        before.add(technique.name)
