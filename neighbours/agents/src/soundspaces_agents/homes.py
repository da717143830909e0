"""Homes in which agents of a study learn and are tested: the largest piece of floor of ``home-<n>``.

Doors of homes lie anywhere, at any angle, and no line of a coarse grid passes through some of them: the walking
graph falls into pieces. A dataset of a study has the points of the largest piece alone. Homes are taken by growing
number, those whose piece is at least `LEAST_FLOOR` large.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path

import msgspec
import numpy as np

from soundspaces_sim import ConfigError, GridConfig, Scene, load_scene, make_graph, make_grid
from soundspaces_sim.parts import publish_file as publish, read_json

LEAST_FLOOR = 25.0  # m², points times the square of their spacing


@dataclass(frozen=True)
class Seen:
    """A home that was looked at: points of its largest piece, and whether it was taken."""

    home: str
    points: int
    taken: bool


@dataclass(frozen=True)
class Choice:
    """Homes that were looked at on a grid of `spacing` m, in order."""

    spacing: float
    least_floor: float
    seen: tuple[Seen, ...] = ()

    @property
    def taken(self) -> tuple[str, ...]:
        """Names of those that were taken."""
        return tuple(one.home for one in self.seen if one.taken)


def largest_piece(scene: Scene, grid: GridConfig) -> np.ndarray:
    """(n, 3) m, the points of the largest piece of a scene's walking graph."""
    placed = make_grid(scene, config=grid)
    return np.asarray(placed.points[make_graph(scene, placed).component == 0])


def choose_homes(number: int, grid: GridConfig, path: Path) -> tuple[str, ...]:
    """The first `number` homes that are taken. What was looked at before is read from the file `path`, and kept
    there. Raises `ConfigError` if that file is of another grid."""
    choice = read_choice(path) if path.exists() else Choice(grid.spacing, LEAST_FLOOR)
    if (choice.spacing, choice.least_floor) != (grid.spacing, LEAST_FLOOR):
        raise ConfigError(
            f"{path}: homes chosen on a grid of {choice.spacing:g} m by {choice.least_floor:g} m², now "
            f"{grid.spacing:g} m and {LEAST_FLOOR:g} m²; take another folder"
        )
    seen = list(choice.seen)
    for k in count(len(seen)):
        if sum(one.taken for one in seen) >= number:
            break
        points = len(largest_piece(load_scene(f"home-{k}"), grid))
        seen.append(Seen(f"home-{k}", points, points * grid.spacing**2 >= LEAST_FLOOR))
        path.parent.mkdir(parents=True, exist_ok=True)
        publish(path, msgspec.json.encode(asdict(Choice(grid.spacing, LEAST_FLOOR, tuple(seen)))))
    return Choice(grid.spacing, LEAST_FLOOR, tuple(seen)).taken[:number]


def read_choice(path: Path) -> Choice:
    """What `choose_homes` has kept. Raises `ConfigError`."""
    try:
        return msgspec.convert(read_json(path, ConfigError, "record of homes"), Choice)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path}: not a record of homes ({error})") from error
