"""Rooms as shells: floor, walls with openings, and a ceiling, of solids that touch and leave no gap.

A storey is a partition of the plane into cells, one for each room, whose outlines run in the middle of walls. Each
room has its own half of every wall, so that it has its own finishes and height. An opening is cut into
whichever walls lie along it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from soundspaces_buildings.solids import Solid, area, clip, inset, moved, prism, turned

HALF = 0.07  # m: half the thickness of a wall between rooms
_SLAB = 0.15  # m
_ON_LINE = 0.02  # m


@dataclass(frozen=True)
class Opening:
    """A hole in walls between `a` and `b` (2,), m in plan, from height `sill` to `head`."""

    a: np.ndarray
    b: np.ndarray
    sill: float
    head: float


@dataclass(frozen=True)
class Profile:
    """A ceiling that bends along lines parallel to `along`: heights `z` (n,) m at distances `at` (n,) m from
    `origin`, to the left of `along`. Two heights are a slope, three a gable, more a vault."""

    origin: np.ndarray  # (2,)
    along: np.ndarray  # (2,) unit vector
    at: np.ndarray
    z: np.ndarray

    @property
    def across(self) -> np.ndarray:
        return np.array([-self.along[1], self.along[0]])

    def height(self, points: np.ndarray) -> np.ndarray:
        """(n,) m above points (n, 2); the outer slopes go on beyond the ends."""
        v = (points - self.origin) @ self.across
        k = np.clip(np.searchsorted(self.at, v, "right") - 1, 0, len(self.at) - 2)
        slope = np.diff(self.z) / np.diff(self.at)
        return np.asarray(self.z[k] + slope[k] * (v - self.at[k]))

    def turned(self, along: np.ndarray) -> Profile:
        """With the plan's x axis along the unit vector `along`."""
        return replace(self, origin=turned(self.origin, along), along=turned(self.along, along))


@dataclass(frozen=True)
class Room:
    """`outline` (n, 2) of the cell; `floor` and `ceiling` heights, m; `finishes`: label of floor, wall, ceiling.

    `profile` replaces the level ceiling. `floor_outline`, `ceiling_outline`: of these where they do not fill the
    cell (stairs); an empty one leaves the floor or ceiling out.
    """

    kind: str
    outline: np.ndarray
    floor: float
    ceiling: float
    finishes: dict[str, str]
    profile: Profile | None = None
    floor_outline: np.ndarray | None = None
    ceiling_outline: np.ndarray | None = None

    @property
    def inner(self) -> np.ndarray:
        """(n, 2) where the walls' surfaces are."""
        return inset(self.outline, HALF)

    @property
    def area(self) -> float:
        """Of the floor, m²."""
        return area(self.inner)

    def height_at(self, points: np.ndarray) -> np.ndarray:
        """(n,) m of the ceiling above points (n, 2)."""
        if self.profile is None:
            return np.full(len(points), self.ceiling)
        return self.profile.height(points)

    def turned(self, along: np.ndarray) -> Room:
        """With the plan's x axis along the unit vector `along`."""
        floor, ceiling = self.floor_outline, self.ceiling_outline
        return replace(
            self,
            outline=turned(self.outline, along),
            profile=None if self.profile is None else self.profile.turned(along),
            floor_outline=None if floor is None else turned(floor, along),
            ceiling_outline=None if ceiling is None else turned(ceiling, along),
        )


@dataclass(frozen=True)
class Building:
    """What is drawn: solids, and the rooms that they are of."""

    solids: list[Solid]
    rooms: list[Room]

    def turned(self, along: np.ndarray) -> Building:
        """With the plan's x axis along the unit vector `along`."""
        solids = [moved(s, np.zeros(2), along) for s in self.solids]
        return Building(solids, [room.turned(along) for room in self.rooms])


def shell(room: Room, openings: Sequence[Opening]) -> Iterator[Solid]:
    """The solids of a room."""
    floor = room.outline if room.floor_outline is None else room.floor_outline
    if len(floor):
        yield prism(room.finishes["floor"], floor, room.floor - _SLAB, room.floor)
    yield from _ceiling(room)
    inner = room.inner
    for k in range(len(room.outline)):
        yield from _wall(room, k, inner, openings)


def _ceiling(room: Room) -> Iterator[Solid]:
    outline = room.outline if room.ceiling_outline is None else room.ceiling_outline
    label = room.finishes["ceiling"]
    if room.profile is None:
        if len(outline):
            yield prism(label, outline, room.ceiling, room.ceiling + _SLAB)
        return
    p = room.profile
    if len(p.at) == 2:
        z = p.height(outline)
        yield prism(label, outline, z, z + _SLAB)
        return
    offset = float(p.origin @ p.across)
    for k in range(len(p.at) - 1):
        strip = outline
        if k > 0:
            strip = clip(strip, p.across, offset + p.at[k])
        if k < len(p.at) - 2:
            strip = clip(strip, -p.across, -offset - p.at[k + 1])
        v = (strip - p.origin) @ p.across
        z = p.z[k] + (p.z[k + 1] - p.z[k]) / (p.at[k + 1] - p.at[k]) * (v - p.at[k])
        yield prism(label, strip, z, z + _SLAB)


def _wall(room: Room, k: int, inner: np.ndarray, openings: Sequence[Opening]) -> Iterator[Solid]:
    """The wall along edge `k`: between openings, below and above them."""
    j = (k + 1) % len(room.outline)
    a, b = room.outline[k], room.outline[j]
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    normal = np.array([-along[1], along[0]])
    holes = []
    for hole in openings:
        ends = np.array([hole.a, hole.b]) - a
        if np.abs(ends @ normal).max() < _ON_LINE:
            u0, u1 = sorted((ends @ along).tolist())
            if u1 > HALF and u0 < length - HALF:
                holes.append((max(u0, 0.0), min(u1, length), hole))
    cuts = {u for u0, u1, _ in holes for u in (u0, u1)}
    if room.profile is not None and len(room.profile.at) > 2:
        p = room.profile
        slope = float(along @ p.across)
        if abs(slope) > 1e-6:
            cuts |= {float(v - (a - p.origin) @ p.across) / slope for v in p.at[1:-1]}
    inside = sorted(u for u in cuts if HALF + 1e-6 < u < length - HALF - 1e-6)
    ends_in = (float((inner[k] - a) @ along), float((inner[j] - a) @ along))
    stops = [(0.0, ends_in[0]), *((u, u) for u in inside), (length, ends_in[1])]
    for (u0, v0), (u1, v1) in pairwise(stops):
        quad = np.array(
            [
                a + along * u0,
                a + along * u1,
                a + along * v1 + HALF * normal,
                a + along * v0 + HALF * normal,
            ]
        )
        middle = 0.5 * (max(u0, v0) + min(u1, v1))
        spans: list[tuple[float, float | None]] = [(room.floor, None)]
        for h0, h1, hole in holes:
            if h0 <= middle <= h1:
                spans = [s for span in spans for s in _around(span, hole, room)]
        top = room.height_at(quad)
        for low, high in spans:
            yield prism(room.finishes["wall"], quad, low, top if high is None else high)


def _around(
    span: tuple[float, float | None], hole: Opening, room: Room
) -> list[tuple[float, float | None]]:
    """What a hole leaves of a wall's height; None stands for the ceiling."""
    low, high = span
    end = room.ceiling if high is None else high
    out: list[tuple[float, float | None]] = []
    if hole.sill > low + 1e-6:
        out.append((low, min(hole.sill, end) if hole.sill < end else high))
    if hole.head < end - 1e-6:
        out.append((max(hole.head, low), high))
    return out
