"""Echograms between points: from anywhere to anywhere on the floor, by what was simulated at the points around.

Discrete arrivals are ``simulated``: the engine's own at the very place, which takes no walks (`discrete_paths`).
Or they are ``moved``, which is faster: those of the points around, with their images, tested by rays
(`moved_paths`). Then a path that the points do not have, as one by a piece of wall that none of them sees, is not
found, and levels beside edges are those of the points.

Reverberation is the mean of the points' energies. The weights are Shepard's, of compact support: ((R - d) / (R d))²
at distance d below R, the spacing of the points (Franke & Nielson 1980), among the points that a place sees; so
they are continuous where nothing cuts the view, and at a point they give that point. Of a place that sees none
within R the nearest that it sees counts, or the nearest of all.

A source is at a point, or on a straight way between two: then its reverberation is the mean of theirs by distance;
moved paths are those of the nearer, with the source itself moved.
"""

from __future__ import annotations

from functools import cached_property
from typing import Literal, NamedTuple, get_args

import numpy as np

from soundspaces_continuous.moved_paths import (
    DIRECT,
    THROUGH_WALLS,
    Moved,
    Paths,
    Surroundings,
    make_moved,
    move_paths,
    paths_of,
)
from soundspaces_sim import (
    Arrival,
    Arrivals,
    ConfigError,
    Echogram,
    PointError,
    RirDataset,
    Scene,
)
from soundspaces_sim.parts import (
    LEAST_DISTANCE,
    BlockCache,
    Geometry,
    SimulatedPaths,
    air_left,
    direct_arrival,
    kernel,
    point_distance as distance,
    prepare_planes,
    prepare_wedges,
    unoccluded,
    vector_row as row,
    without_arrivals,
)

PathsName = Literal["simulated", "moved"]

_CANDIDATES = 16  # points that are looked at, if none is within reach
_MEMORY = 200_000_000  # bytes of paths and echograms
_AT = 1e-9  # m


class Place(NamedTuple):
    """Somewhere, by the points that stand for its reverberation: their rows, the heaviest first, and their
    shares."""

    position: np.ndarray  # (3,) m
    points: tuple[int, ...]
    shares: tuple[float, ...]


class Heard(NamedTuple):
    """k paths as they reach a listener, those of each pair of points together."""

    pairs: list[tuple[int, int]]  # source and listener, rows of the dataset's points
    ends: list[int]  # where each pair's paths end
    rows: np.ndarray  # (k,) of the pair's paths
    gain: np.ndarray  # (k,) amplitude relative to that at the point
    length: np.ndarray  # (k,) m
    direction: np.ndarray  # (k, 3) unit
    further: np.ndarray  # (k,) m, than at the point: so much more air


class SoundField:
    """What is heard anywhere in the scene of a dataset. `scene`: that of which it was made.

    `reach`: distance within which points count, m; by default the grid's spacing. `paths`: how discrete arrivals
    are had, ``simulated`` or ``moved``. Raises `ConfigError`, also for simulated ones of a dataset that was opened
    with other materials than it was made with.
    """

    def __init__(
        self,
        ds: RirDataset,
        scene: Scene,
        reach: float | None = None,
        paths: PathsName = "simulated",
    ) -> None:
        if paths not in get_args(PathsName):
            raise ConfigError(f"paths: expected one of {', '.join(get_args(PathsName))}, got {paths!r}")
        if paths == "simulated" and ds.chosen_materials:
            raise ConfigError(
                f"{ds}: it was opened with other materials, and paths would be simulated with those of the scene: "
                "expected paths='moved'"
            )
        config, self.paths = ds.manifest.config, paths
        self.ds, self.scene, self.c = ds, scene, config.simulation.c
        self._config = config.simulation
        self.reach = float(config.grid.spacing) if reach is None else reach
        planes = prepare_planes(scene, config.simulation)
        self.around = Surroundings(
            scene.geometry._replace(plane=planes.of_face),
            planes,
            prepare_wedges(scene, config.simulation).wedges,
            LEAST_DISTANCE,
        )
        self.points = np.ascontiguousarray(ds.points - scene.center)
        self._near, self._share = np.empty(len(self.points), np.int64), np.empty(len(self.points))
        self._memory = BlockCache(_MEMORY)
        self._room: Moved = make_moved(64)

    def at_point(self, point: int) -> Place:
        """A point of the dataset."""
        return Place(self.ds.points[point], (int(point),), (1.0,))

    def between(self, a: int, b: int, share: float) -> Place:
        """On the straight way from point a to b, `share` of it done."""
        if share <= 0.0 or a == b:
            return self.at_point(a)
        if share >= 1.0:
            return self.at_point(b)
        position = (1.0 - share) * self.ds.points[a] + share * self.ds.points[b]
        if share <= 0.5:
            return Place(position, (int(a), int(b)), (1.0 - share, share))
        return Place(position, (int(b), int(a)), (share, 1.0 - share))

    def place(self, position: np.ndarray) -> Place:
        """Anywhere, (3,) m, by Shepard's weights. Raises `PointError` for what is not finite."""
        position = np.asarray(position, float)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise PointError(f"position: expected three finite coordinates in m, got {position}")
        near, share = self._near, self._share
        there = position - self.scene.center
        n = int(_weigh(self.around.geometry, self.points, there, self.reach, near, share))
        if n == 0:
            distance = np.linalg.norm(self.ds.points - position, axis=1)
            near = np.argsort(distance, kind="stable")[:_CANDIDATES]
            seen = np.empty(len(near), np.bool_)
            _see(self.around.geometry, self.points, near, there, seen)
            return Place(position, (int(near[int(seen.argmax())]),), (1.0,))
        return Place(position, tuple(near[:n].tolist()), tuple(share[:n].tolist()))

    def pair(self, s: int, l: int) -> tuple[Echogram, Paths]:
        """The echogram between two points, and its discrete paths."""
        found = self._memory.get((s, l), lambda: self._read(s, l))
        echogram, paths = found["echogram"].item(), found["paths"].item()
        assert isinstance(echogram, Echogram) and isinstance(paths, Paths)
        return echogram, paths

    def _read(self, s: int, l: int) -> dict[str, np.ndarray]:
        echogram = self.ds.echogram(s, l)
        paths = paths_of(echogram, self.points[s], self.points[l], self.around, self._config)
        record = {name: np.empty((), object) for name in ("echogram", "paths")}
        record["echogram"][()], record["paths"][()] = echogram, paths
        # What the memory counts: the bytes behind these two.
        return {**record, "bytes": np.empty(echogram.energy.nbytes + 200 * len(paths.kind), np.uint8)}

    def heard(self, source: Place, listener: Place) -> Heard:
        """Discrete paths from one place to another, each from the heaviest of the listener's points that has it."""
        pairs = [(source.points[0], l) for l in listener.points]
        paths = [self.pair(*pair)[1] for pair in pairs]
        most = sum(len(p.kind) for p in paths)
        if most > len(self._room.row):
            self._room = make_moved(2 * most)
        room, center, ends, n = self._room, self.scene.center, [], 0
        ways = source.position - center, listener.position - center
        for of_pair in paths:
            n = int(move_paths(self.around, of_pair, *ways, room, n))
            ends.append(n)
        rest = room.gain, room.length, room.direction, room.further
        return Heard(pairs, ends, *(column[:n].copy() for column in (room.row, *rest)))

    @cached_property
    def simulated(self) -> SimulatedPaths:
        """Discrete paths as the engine has them."""
        return SimulatedPaths(self.scene, self._config, self.ds.manifest.config.dataset.seed)

    def echogram(self, source: Place, listener: Place) -> Echogram:
        """The echogram from one place to another; error bars are those of the heaviest points."""
        first, _ = self.pair(source.points[0], listener.points[0])
        energy = np.zeros(first.energy.shape)
        for s, of_s in zip(source.points, source.shares, strict=True):
            for l, of_l in zip(listener.points, listener.shares, strict=True):
                energy += np.multiply(of_s * of_l, self.pair(s, l)[0].energy, dtype=float)
        arrivals = self._simulated if self.paths == "simulated" else self._moved
        direct, early, visible = arrivals(source, listener)
        return Echogram(
            first.bands,
            first.time_edges,
            energy.astype(first.energy.dtype),
            direct,
            early,
            first.relative_error,
            visible,
            air=first.air,
        )

    def _simulated(self, source: Place, listener: Place) -> tuple[Arrival | None, Arrivals, bool]:
        """(Direct sound, other arrivals, whether one place sees the other)."""
        found = self.simulated.between(source.position, listener.position)
        offset, paths = source.position - listener.position, found.paths
        direct = direct_arrival(offset, found.distance, found.direct, self.c)
        early = Arrivals(
            paths.length / self.c, paths.energy, paths.at_b, paths.planes, paths.kind, paths.wedges
        )
        return direct, early, found.walls == 0

    def _moved(self, source: Place, listener: Place) -> tuple[Arrival | None, Arrivals, bool]:
        """As `_simulated`, by paths of the points around."""
        direct, columns = None, []
        heard, first = self.heard(source, listener), 0
        for pair, end in zip(heard.pairs, heard.ends, strict=True):
            echogram, paths = self.pair(*pair)
            own = slice(first, end)
            rows, length = heard.rows[own], heard.length[own]
            energy = heard.gain[own, None] ** 2 * paths.energy[rows]
            if echogram.air is not None:
                times = length / self.c, (length - heard.further[own]) / self.c
                here, there = (air_left(echogram.air, echogram.bands, d) for d in times)
                energy *= np.divide(here, there, out=np.zeros(here.shape), where=there > 0.0)
            for k, i in enumerate(rows):
                arrival = length[k] / self.c, energy[k], heard.direction[first + k]
                if paths.kind[i] in (DIRECT, THROUGH_WALLS):
                    direct = Arrival(*arrival)
                else:
                    columns.append((*arrival, paths.name[i]))
            first = end
        columns.sort(key=lambda column: column[0])
        early = without_arrivals(self.pair(source.points[0], listener.points[0])[0]).early
        if columns:
            delay, arrived, way, name = (np.array(column) for column in zip(*columns, strict=True))
            early = Arrivals(delay, arrived, way, name[:, 1:3], name[:, 0], name[:, 3:5])
        return direct, early, self.sees(source, listener)

    def sees(self, source: Place, listener: Place) -> bool:
        """Whether nothing is between two places."""
        out = np.empty(1, np.bool_)
        start = (source.position - self.scene.center)[None]
        _see(
            self.around.geometry,
            start,
            np.zeros(1, np.int64),
            listener.position - self.scene.center,
            out,
        )
        return bool(out[0])


@kernel
def _see(
    geometry: Geometry, points: np.ndarray, rows: np.ndarray, place: np.ndarray, out: np.ndarray
) -> None:
    """Fill `out` (k,): whether points (N, 3) of `rows` (k,) see a place (3,)."""
    p = place[0], place[1], place[2]
    for k in range(len(rows)):
        out[k] = unoccluded(geometry, p, row(points, rows[k]))


@kernel
def _weigh(
    geometry: Geometry,
    points: np.ndarray,
    place: np.ndarray,
    reach: float,
    near: np.ndarray,
    share: np.ndarray,
) -> int:
    """Fill `near` (N,) and `share` (N,) with rows of points (N, 3), the heaviest first, and their parts of the sum
    of Shepard's weights at a place (3,): none beyond `reach` or out of sight, a point itself alone. How many
    there are."""
    p = place[0], place[1], place[2]
    n, whole = 0, 0.0
    for k in range(len(points)):
        q = row(points, k)
        d = distance(p, q)
        if d < _AT:
            near[0], share[0] = k, 1.0
            return 1
        if d < reach and unoccluded(geometry, p, q):
            weight = ((reach - d) / (reach * d)) ** 2
            at = n
            while at > 0 and share[at - 1] < weight:
                near[at], share[at] = near[at - 1], share[at - 1]
                at -= 1
            near[at], share[at] = k, weight
            n, whole = n + 1, whole + weight
    for at in range(n):
        share[at] /= whole
    return n
