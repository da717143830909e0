"""Random rooms for speech: a scene, one to four talkers and a small array of microphones, of one generator.

Rooms are shoeboxes, prisms on convex polygons, and the furnished scenes ``room-<n>``. Surfaces are drawn from
sets of those materials of `materials/materials.toml` that such a surface has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from soundspaces_sim.core.errors import ConfigError, SimulationError
from soundspaces_sim.echogram.endpoints import Source
from soundspaces_sim.rendering.directivity.talker import Talker
from soundspaces_sim.rendering.microphones import MicrophoneArray
from soundspaces_sim.scene.build import shoebox
from soundspaces_sim.scene.enclosure import closedness
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.scene.scene import Scene

RoomKind = Literal["shoebox", "polygon", "furnished"]
KINDS: tuple[RoomKind, ...] = get_args(RoomKind)

#: What surfaces may be made of, each as likely as the next.
MATERIALS: Mapping[str, Sequence[str]] = {
    "floor": (
        "carpet",
        "carpet-thin",
        "wood-floor",
        "parquet",
        "linoleum",
        "ceramic-tile",
        "concrete-floor",
    ),
    "wall": (
        "plaster",
        "gypsum-board",
        "brick-painted",
        "concrete",
        "wood-panel",
        "acoustic-plaster",
        "curtain-cotton",
    ),
    "ceiling": (
        "plaster",
        "plasterboard-ceiling",
        "mineral-wool-ceiling",
        "perforated-gypsum-ceiling",
        "concrete",
    ),
}
_LENGTH, _HEIGHT = (2.5, 10.0), (2.3, 4.0)  # m
_MOUTH, _MICROPHONE = (
    (1.1, 1.8),
    (0.6, 1.8),
)  # m above the floor: seated and standing people; tables and shelves
_MARGIN = 0.4  # m from any surface
_LEAST = 0.5  # m between a mouth and the array
_RADIUS = (0.02, 0.10)  # m, of arrays
_FURNISHED = 100_000  # numbers of scenes to choose from
_TRIES = 2000


@dataclass(frozen=True)
class RandomRoom:
    """`sources` are talkers with headings; the centre of the `array` is at `place` (3,) m."""

    kind: RoomKind
    scene: Scene
    sources: tuple[Source, ...]
    array: MicrophoneArray
    place: np.ndarray


def draw_room(
    rng: np.random.Generator,
    name: str,
    kinds: Sequence[RoomKind] = KINDS,
    sources: tuple[int, int] = (1, 4),
    microphones: tuple[int, int] = (2, 8),
) -> RandomRoom:
    """A room, with numbers of talkers and microphones between the two given, both included. Raises
    `ConfigError`, and `SimulationError` if nothing that was drawn has room for all."""
    check_numbers(kinds, sources, microphones)
    kind = kinds[int(rng.integers(len(kinds)))]
    scene = _SCENES[kind](rng, name)
    array = _array(rng, int(rng.integers(microphones[0], microphones[1] + 1)))
    count = int(rng.integers(sources[0], sources[1] + 1))
    place = _places(rng, scene, 1, _MICROPHONE, np.empty((0, 3)))[0]
    mouths = _places(rng, scene, count, _MOUTH, place[None])
    ends = tuple(
        Source(tuple(mouth), Talker(), heading_deg=float(rng.uniform(0.0, 360.0))) for mouth in mouths
    )
    return RandomRoom(kind, scene, ends, array, place)


def check_numbers(kinds: Sequence[str], sources: tuple[int, int], microphones: tuple[int, int]) -> None:
    """Raises `ConfigError` for what `draw_room` does not take."""
    if not kinds or not set(kinds) <= set(KINDS):
        raise ConfigError(f"kinds: expected some of {', '.join(KINDS)}, got {tuple(kinds)!r}")
    for what, (low, high), least, most in (
        ("sources", sources, 1, 4),
        ("microphones", microphones, 1, 8),
    ):
        if not least <= low <= high <= most:
            raise ConfigError(f"{what}: expected least and most, {least} to {most}, got {(low, high)}")


def _surface(rng: np.random.Generator, what: str) -> str:
    return str(rng.choice(MATERIALS[what]))


def _shoebox(rng: np.random.Generator, name: str) -> Scene:
    size = (*rng.uniform(*_LENGTH, 2), rng.uniform(*_HEIGHT))
    walls = {wall: _surface(rng, "wall") for wall in ("west", "east", "south", "north")}
    walls |= {what: _surface(rng, what) for what in ("floor", "ceiling")}
    return shoebox(size, walls, name=name)


def _polygon(rng: np.random.Generator, name: str) -> Scene:
    """A prism on a convex polygon of four to eight corners on an ellipse."""
    corners = int(rng.integers(4, 9))
    angle = 2.0 * np.pi * (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) / corners
    across = 0.5 * rng.uniform(3.5, _LENGTH[1], 2)
    base = across * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    height = float(rng.uniform(*_HEIGHT))
    floor, ceiling = (np.column_stack([base, np.full(corners, z)]) for z in (0.0, height))
    rows = np.arange(corners)
    beyond = (rows + 1) % corners
    walls = [
        [a, b, c]
        for i, j in zip(rows, beyond, strict=True)
        for a, b, c in ((i, i + corners, j), (j, i + corners, j + corners))
    ]
    ground = [[0, k, k + 1] for k in range(1, corners - 1)]
    faces = [*walls, *ground, *([corners, corners + k + 1, corners + k] for k in range(1, corners - 1))]
    stuff: list[str] = [m for _ in rows for m in (_surface(rng, "wall"),) * 2]
    stuff += [_surface(rng, "floor")] * (corners - 2) + [_surface(rng, "ceiling")] * (corners - 2)
    return Scene.from_arrays(np.vstack([floor, ceiling]), np.array(faces), stuff, name=name)


def _furnished(rng: np.random.Generator, _name: str) -> Scene:
    return load_scene(f"room-{int(rng.integers(_FURNISHED))}")


_SCENES = {"shoebox": _shoebox, "polygon": _polygon, "furnished": _furnished}


def _array(rng: np.random.Generator, count: int) -> MicrophoneArray:
    """Capsules on a circle, on a line, or anywhere on a sphere, turned at random about the vertical."""
    radius, shape = rng.uniform(*_RADIUS), int(rng.integers(3))
    if shape == 0:
        angle = 2.0 * np.pi * np.arange(count) / count
        offsets = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    elif shape == 1:
        offsets = np.zeros((count, 3))
        offsets[:, 1] = np.linspace(-1.0, 1.0, count) if count > 1 else 0.0
    else:
        offsets = rng.normal(size=(count, 3))
        offsets /= np.linalg.norm(offsets, axis=1, keepdims=True)
    return MicrophoneArray(radius * offsets, heading_deg=float(rng.uniform(0.0, 360.0)))


def _places(
    rng: np.random.Generator, scene: Scene, count: int, heights: tuple[float, float], taken: np.ndarray
) -> np.ndarray:
    """(count, 3) places in the room, `_MARGIN` from surfaces and `_LEAST` from what is taken."""
    low, high = scene.bounds
    found = np.empty((0, 3))
    for _ in range(_TRIES // 50):
        some = rng.uniform((*low[:2], low[2] + heights[0]), (*high[:2], low[2] + heights[1]), (50, 3))
        closed, clearance = closedness(scene, some, 64, 8)
        free = (closed > 0.99) & (clearance > _MARGIN)
        for place in some[free]:
            near = np.linalg.norm(np.vstack([taken, found]) - place, axis=1)
            if near.min(initial=np.inf) >= _LEAST and len(found) < count:
                found = np.vstack([found, place])
        if len(found) == count:
            return found
    raise SimulationError(f"{scene.name}: no room for {count} places {_MARGIN} m from all surfaces")
