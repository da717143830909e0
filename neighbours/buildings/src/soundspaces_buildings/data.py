"""The tables of furniture, programmes and finishes, and draws from them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from soundspaces_buildings.solids import Solid, box
from soundspaces_sim import MaterialTable
from soundspaces_sim.parts import load_materials

OPEN_HEAD = 1.53  # m: what begins higher is walked under
STEP = 0.2  # m: what ends lower is stepped on


@dataclass(frozen=True)
class Piece:
    """A piece of furniture; its fields are those of furniture.toml."""

    size: tuple[float, float]
    boxes: tuple[tuple[str, float, float, float, float, float, float], ...]
    stretch: tuple[float, float] = (1.0, 1.0)
    tall: bool = False
    high: bool = False
    middle: bool = False
    under: bool = False
    front: float = 0.0

    def solids(self, width: float, finishes: dict[str, str]) -> list[Solid]:
        """In the piece's frame, `width` times as wide; labels are replaced by those of `finishes`."""
        return [
            box(finishes.get(label, label), width * x0, y0, z0, width * x1, y1, z1)
            for label, x0, y0, z0, x1, y1, z1 in self.boxes
        ]


@dataclass(frozen=True)
class Programme:
    """What belongs into a room; its fields are those of programmes.toml."""

    area: tuple[float, float, float]
    narrow: float
    need: tuple[tuple[str, ...], ...]
    likes: tuple[tuple[str, ...], ...]
    walls: tuple[str, ...]


@cache
def _table(name: str) -> dict[str, Any]:
    return tomllib.loads(files(__package__).joinpath(name).read_text("utf-8"))


@cache
def furniture() -> dict[str, Piece]:
    """Pieces by name."""
    return msgspec.convert(_table("furniture.toml"), dict[str, Piece])


@cache
def programmes() -> dict[str, Programme]:
    """Programmes by use of the room."""
    return msgspec.convert(_table("programmes.toml"), dict[str, Programme])


@cache
def own_materials() -> MaterialTable:
    """Materials of buildings that the built-in database does not have."""
    return load_materials(Path(str(files(__package__).joinpath("materials.toml"))))


def draw_finishes(
    use: str, rng: np.random.Generator, base: dict[str, str] | None = None
) -> dict[str, str]:
    """Labels such as ``wall-plaster`` by thing, drawn for a use of finishes.toml; the rest as in `base`."""
    out = dict(base or {})
    for thing, weights in _table("finishes.toml")[use].items():
        names, parts = list(weights), np.array(list(weights.values()), float)
        k = int(np.searchsorted(np.cumsum(parts / parts.sum()), rng.random()))
        out[thing] = f"{thing}-{names[min(k, len(names) - 1)]}"
    return out


def draw_area(programme: Programme, rng: np.random.Generator) -> float:
    """m²: log-normal about the median, within the bounds."""
    low, median, high = programme.area
    spread = 0.5 * np.log(high / median) if median < high else 0.0
    return float(np.clip(median * np.exp(spread * rng.standard_normal()), low, high))
