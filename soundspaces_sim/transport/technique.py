"""A technique: a way of making paths, with all that it needs of a scene, a side and a tile.

    prepare(scene, config)                each made once per scene; `PreparedScene.part(prepare)` gives it
    mark(facets, prepared, duration)      facets on which subpaths leave paths to it
    trace(tile, own, other, rows, tables, left)
                                          subpaths of some points of a side: what they deposit at points of the
                                          other goes into `tables`, what they leave for others into `left`
    connect(tile)                         what is made of pairs of points alone; returns discrete paths, if any
    join(tile, of_a, of_b)                what is made of pairs of walks: of what subpaths of both sides left
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
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.radiance_transfer.patches import Patches
from soundspaces_sim.transport.state import Tables
from soundspaces_sim.transport.tile import Left, Side, Tile, Walks


class Facets(NamedTuple):
    """The triangles as subpaths see them: the specular plane (`geometry.plane`) and the patch of each."""

    geometry: Geometry
    patches: Patches


Mark = Callable[[Facets, PreparedScene, float], Facets]
Trace = Callable[[Tile, Side, Side, slice, Tables, Left], None]
Connect = Callable[[Tile], PathTable | None]
Join = Callable[[Tile, Walks, Walks], None]


@dataclass(frozen=True)
class Technique:
    """`paths`: those it makes, for people. `requires`: names of techniques whose results it takes; they run before
    it. `deposits`: it adds to a tile's tables, not to its discrete paths."""

    name: str
    paths: str
    prepare: tuple[Prepare, ...] = ()
    mark: Mark | None = None
    trace: Trace | None = None
    connect: Connect | None = None
    join: Join | None = None
    requires: tuple[str, ...] = ()
    deposits: bool = False
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
