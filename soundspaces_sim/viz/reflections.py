"""Discrete arrivals of a pair with names: when, how loud, from where, and by way of which surfaces.

Of a path with one corner, length L and direction of arrival d from the receiver, the corner lies at the distance

    a = (L² - |w|²) / (2 (L - d · w)),   w from the receiver to the source,

and the surface's normal halves the angle between its legs. So first-order reflections tell where the planes are
whose numbers the dataset stores, and reflections by two of them are named by what others tell. No scene is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from soundspaces_sim.echogram.echogram import EDGE, KINDS, MIRRORS, Arrival, Echogram

_AT_10_M = 1.0 / (4.0 * np.pi * 100.0)
_LEVEL = 0.95  # least component of a normal that names an axis
_NAMES = ("x", "y", "z")


class Plane(NamedTuple):
    """A mirror that reflections tell of: unit normal towards the room, and a point on it, m."""

    normal: np.ndarray
    point: np.ndarray

    def __str__(self) -> str:
        axis = int(np.abs(self.normal).argmax())
        if abs(self.normal[axis]) < _LEVEL:
            azimuth = np.degrees(np.arctan2(self.normal[1], self.normal[0]))
            elevation = np.degrees(np.arcsin(np.clip(self.normal[2], -1.0, 1.0)))
            facing, tilted = round(azimuth) % 360, round(elevation)
            return f"surface facing {facing}°, tilted {tilted}°, at {_place(self.point)}"
        towards = ("-" if self.normal[axis] < 0.0 else "+") + _NAMES[axis]
        facing = {"+z": "up", "-z": "down"}.get(towards, towards)
        return f"surface facing {facing} at {_NAMES[axis]} = {_metres(self.point[axis])} m"


class Reflection(NamedTuple):
    """An arrival, numbered through. `delay` s since emission; `level` dB re the direct sound at 10 m in the open,
    in one band; `azimuth` (positive: left of the source), `elevation`, degrees; `surfaces` from the source on."""

    number: int
    delay: float
    level: float
    azimuth: float
    elevation: float
    surfaces: str


def _metres(x: float) -> str:
    return f"{round(float(x), 2) + 0.0:.2f}"  # no minus before nothing


def _place(point: np.ndarray) -> str:
    return f"({', '.join(_metres(x) for x in point)}) m"


def corner(
    arrival: Arrival, source: np.ndarray, listener: np.ndarray, speed_of_sound: float
) -> np.ndarray:
    """(3,) where a path with one corner turns, m."""
    w, length = source - listener, arrival.delay * speed_of_sound
    away = (length**2 - w @ w) / (2.0 * (length - arrival.direction @ w))
    return np.asarray(listener + away * arrival.direction)


def planes_told(
    echograms: Iterable[tuple[Echogram, np.ndarray, np.ndarray]], speed_of_sound: float
) -> dict[int, Plane]:
    """Planes by their numbers, from first-order reflections of (echogram, source, listener)."""
    found: dict[int, Plane] = {}
    for echogram, source, listener in echograms:
        for arrival in echogram.early:
            if arrival.kind != KINDS[MIRRORS] or len(arrival.planes) != 1 or arrival.planes[0] in found:
                continue
            point = corner(arrival, source, listener, speed_of_sound)
            legs = [
                (end - point) / max(float(np.linalg.norm(end - point)), 1e-9)
                for end in (source, listener)
            ]
            normal = legs[0] + legs[1]
            if np.linalg.norm(normal) > 1e-6:  # grazing: nothing is told
                found[arrival.planes[0]] = Plane(normal / np.linalg.norm(normal), point)
    return found


def edges_told(
    echograms: Iterable[tuple[Echogram, np.ndarray, np.ndarray]], speed_of_sound: float
) -> dict[int, np.ndarray]:
    """A point on edges by their numbers, m, from sound that bent round one of them alone."""
    found: dict[int, np.ndarray] = {}
    for echogram, source, listener in echograms:
        for arrival in echogram.early:
            if arrival.kind == KINDS[EDGE] and arrival.edges[0] not in found:
                found[arrival.edges[0]] = corner(arrival, source, listener, speed_of_sound)
    return found


def _surfaces(
    arrival: Arrival,
    source: np.ndarray,
    listener: np.ndarray,
    planes: Mapping[int, Plane],
    bends: Mapping[int, np.ndarray],
    speed_of_sound: float,
) -> str:
    if arrival.kind == KINDS[EDGE]:
        return f"edge at {_place(corner(arrival, source, listener, speed_of_sound))}"
    mirrors = [str(planes.get(p, "a surface that no other path tells of")) for p in arrival.planes]
    edges = [
        f"edge through {_place(bends[e])}" if e in bends else "an edge that no other path tells of"
        for e in arrival.edges
    ]
    both = [*edges, *mirrors] if arrival.kind.startswith("edge") else [*mirrors, *edges]
    return ", then ".join(both)


def reflections(
    echogram: Echogram,
    source: np.ndarray,
    listener: np.ndarray,
    planes: Mapping[int, Plane],
    bends: Mapping[int, np.ndarray],
    band: int,
    speed_of_sound: float,
) -> list[Reflection]:
    """All discrete arrivals with energy in a band, by time; the direct sound, if any, is number 0."""
    towards = source - listener
    facing = np.arctan2(towards[1], towards[0])
    out = []
    heard = [a for a in sorted(echogram.early, key=lambda a: a.delay) if float(a.energy[band]) > 0.0]
    named = [
        (k, a, _surfaces(a, source, listener, planes, bends, speed_of_sound))
        for k, a in enumerate(heard, 1)
    ]
    if echogram.direct is not None and float(echogram.direct.energy[band]) > 0.0:
        named.insert(0, (0, echogram.direct, "direct sound"))
    for number, arrival, surfaces in named:
        energy = float(arrival.energy[band])
        x, y, z = arrival.direction
        azimuth = np.degrees((np.arctan2(y, x) - facing + np.pi) % (2.0 * np.pi) - np.pi)
        level = 10.0 * np.log10(energy / _AT_10_M)
        elevation = np.degrees(np.arcsin(np.clip(z, -1.0, 1.0)))
        out.append(
            Reflection(number, arrival.delay, float(level), float(azimuth), float(elevation), surfaces)
        )
    return out
