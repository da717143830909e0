"""Generated buildings, ``<type>-<number>``, which a neighbour draws: without it they are refused by name."""

from __future__ import annotations

import re

from soundspaces_sim.core.errors import ConfigError, SceneError
from soundspaces_sim.core.registry import Entry, of_neighbour
from soundspaces_sim.scene.labelled import LabelledMesh, SceneFormat

#: As ``home-7``.
TYPES = ("home", "room", "office", "classroom", "hall", "church")
_READER = Entry("soundspaces_buildings.registry:read_building", "a generated building", "buildings")


def _read(source: str) -> LabelledMesh:
    try:
        read = of_neighbour(f"{source}: a generated building", _READER)
    except ConfigError as error:
        raise SceneError(str(error)) from None
    mesh: LabelledMesh = read(source)
    return mesh


FORMAT = SceneFormat(
    ", ".join(f"'{name}-<number>'" for name in TYPES) + " (by neighbours/buildings)",
    lambda source: re.fullmatch(rf"({'|'.join(TYPES)})-\d{{1,9}}", source) is not None,
    _read,
)
