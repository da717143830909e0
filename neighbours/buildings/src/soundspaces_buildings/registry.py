"""Types of buildings: a new one is a function here that makes solids of random numbers, and a row of the table.

A number gives the same mesh for ever within a version of its type; a change of a mesh is a new version.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from soundspaces_buildings import homes, large, single
from soundspaces_buildings.data import own_materials
from soundspaces_buildings.shell import Building, Room
from soundspaces_buildings.solids import solids_mesh
from soundspaces_sim import SceneError
from soundspaces_sim.parts import LabelledMesh

_STREAM = 0xB01D  # keeps buildings apart from other uses of the same seed
_TRIES = 200


@dataclass(frozen=True)
class BuildingType:
    """`make` draws a building, or None if what was drawn does not fit together; `number` keeps its random numbers
    apart from those of other types, `version` says which drawing this is."""

    make: Callable[[np.random.Generator], Building | None]
    number: int
    version: int = 1


#: By name: the scenes ``<name>-<number>``.
BUILDINGS: Mapping[str, BuildingType] = {
    "home": BuildingType(homes.make_home, 6, version=2),
    "room": BuildingType(single.make_room, 1, version=2),
    "office": BuildingType(single.make_office, 2),
    "classroom": BuildingType(single.make_classroom, 3),
    "hall": BuildingType(large.make_hall, 4, version=2),
    "church": BuildingType(large.make_church, 5),
}


def building_of(source: object) -> tuple[str, int] | None:
    """Type and number of ``<type>-<number>``, or None for other scenes."""
    match = re.fullmatch(r"([a-z]+)-(\d{1,9})", str(source))
    return (match[1], int(match[2])) if match is not None and match[1] in BUILDINGS else None


def building_mesh(kind: str, number: int) -> LabelledMesh:
    """Building `number` of a type as a labelled mesh. Raises `SceneError` for numbers that are out of range."""
    mesh = solids_mesh(_drawn(kind, number).solids, f"{kind}-{number}")
    table = own_materials()
    own = {label: table for label in mesh.labels for name in table.names if label.endswith(f"-{name}")}
    return replace(mesh, materials=own)


def building_rooms(kind: str, number: int) -> list[Room]:
    """The rooms of building `number` of a type of `BUILDINGS`, where the mesh has them. Raises `SceneError`."""
    return _drawn(kind, number).rooms


@lru_cache(maxsize=8)
def _drawn(kind: str, number: int) -> Building:
    if not 0 <= number < 10**9:
        raise SceneError(f"{kind}: expected a number from 0 to 999999999, got {number}")
    found = BUILDINGS[kind]
    rng = np.random.default_rng((_STREAM, found.number, found.version, number))
    for _ in range(_TRIES):
        building = found.make(rng)
        if building is not None:
            return building
    raise SceneError(
        f"{kind}-{number}: nothing that was drawn in {_TRIES} tries fits together; take another"
    )


def read_building(source: str) -> LabelledMesh:
    """The building that a name says, ``home-7``. Raises `SceneError`."""
    found = building_of(source)
    if found is None:
        raise SceneError(f"{source}: expected <type>-<number> with a type of {', '.join(BUILDINGS)}")
    return building_mesh(*found)
