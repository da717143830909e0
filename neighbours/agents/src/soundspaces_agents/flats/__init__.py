"""Scenes for agents to learn in: furnished flats on a lattice of 1 m, made by code from their number.

On grids of 1 m and of 0.5 m one can walk from every free place to every other, which homes of the core do not
promise: their doors lie between points.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from soundspaces_agents.flats.apartment import apartment_mesh
from soundspaces_agents.flats.boxes import flat_mesh
from soundspaces_sim import Scene, SceneError, load_scene
from soundspaces_sim.parts import LabelledMesh

#: ``flat-<n>`` are all of the same materials, ``apartment-<n>`` have finishes and heights of their own.
KINDS: Mapping[str, Callable[[int], LabelledMesh]] = {"flat": flat_mesh, "apartment": apartment_mesh}


def load_flat(name: str) -> Scene:
    """The scene ``flat-<number>`` or ``apartment-<number>``. Raises `SceneError`."""
    match = re.fullmatch(r"([a-z]+)-(\d{1,9})", name)
    if match is None or match[1] not in KINDS:
        raise SceneError(
            f"flats: expected {' or '.join(f'{kind}-<number>' for kind in KINDS)}, got {name!r}"
        )
    return load_scene(KINDS[match[1]](int(match[2])))
