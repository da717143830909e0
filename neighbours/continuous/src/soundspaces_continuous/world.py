"""A dataset as an agent meets it that may be anywhere on its floors."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from soundspaces_continuous.distances import CELL, DistanceField, Lattice, fill_distances
from soundspaces_continuous.episodes import ContinuousEpisode, SoundSource
from soundspaces_continuous.obstacles import SKIN, are_free, least_clearances, make_obstacles, move_disc
from soundspaces_continuous.oracle_walk import Gait, Ground, Walker, count_actions, has_ground
from soundspaces_continuous.sound_field import Place, SoundField
from soundspaces_continuous.step_renderer import StepRenderer
from soundspaces_continuous.task import ContinuousOptions
from soundspaces_sim import GraphConfig, PointError, RirDataset, Scene
from soundspaces_sim.nav import NavigationGraph
from soundspaces_sim.parts import BlockCache, EpisodeError, check_scene, kernel


class Floor:
    """A level floor at `height` m of a scene, for the agent of a `GraphConfig`: its radius, its height, the highest
    step it takes. What lies between that step and its height is an obstacle.

    An agent is a disc. `move` finds contacts exactly; a move whose end has no floor within a step below is refused.
    """

    def __init__(self, scene: Scene, height: float, agent: GraphConfig) -> None:
        self.scene, self.height, self.agent = scene, height, agent
        self.obstacles = make_obstacles(
            scene.corners, height + agent.step, height + agent.height, agent.radius
        )
        self.distances = lru_cache(maxsize=256)(self._distances)
        self._pose, self._way = np.empty(2), np.empty(2)
        x, y, z = scene.center.tolist()
        self.ground = Ground(scene.geometry, (x, y, z), height + agent.step, agent.step)

    def move(self, x: float, y: float, dx: float, dy: float, slide: bool) -> tuple[float, float, bool]:
        """Where a step by (dx, dy) m ends, and whether it touched something or lacked a floor."""
        self._pose[:], self._way[:] = (x, y), (dx, dy)
        collided = bool(move_disc(self.obstacles, self._pose, self._way, slide))
        if not self.is_floor(self._pose[None])[0]:
            return x, y, True
        return float(self._pose[0]), float(self._pose[1]), collided

    def is_floor(self, places: np.ndarray) -> np.ndarray:
        """(N,) whether there is a floor within a step of this one at (N, 2) m."""
        out = np.empty(len(places), np.bool_)
        _have_ground(self.ground, np.ascontiguousarray(places, float), out)
        return out

    def can_stand(self, places: np.ndarray) -> np.ndarray:
        """(N,) whether an agent can stand at (N, 2) m."""
        free = np.empty(len(places))
        least_clearances(self.obstacles, np.ascontiguousarray(places, float), free)
        return np.asarray((free >= self.agent.radius - SKIN) & self.is_floor(places))

    def check(self, x: float, y: float, what: str) -> None:
        """Raise `PointError` unless an agent can stand at (x, y)."""
        if not (math.isfinite(x) and math.isfinite(y)):
            raise PointError(f"{what}: expected finite coordinates in m, got ({x}, {y})")
        if not self.can_stand(np.array([[x, y]]))[0]:
            raise PointError(
                f"{what}: an agent of radius {self.agent.radius:g} m cannot stand at ({x:.3f}, {y:.3f}) m of "
                f"{self.scene.name}; choose a place farther from walls and furniture, on the floor at "
                f"{self.height:.2f} m"
            )

    def free_ways(self, ways: np.ndarray) -> np.ndarray:
        """(N,) whether an agent can walk straight along (N, 4) x0, y0, x1, y1, m."""
        out = np.empty(len(ways), np.bool_)
        are_free(self.obstacles, np.ascontiguousarray(ways, float), out)
        return out

    def _distances(self, x: float, y: float) -> DistanceField:
        """Walking distances to (x, y) from anywhere; kept for the last 256 places. Raises `PointError`."""
        self.check(x, y, "goal")
        return fill_distances(self.obstacles, self.lattice(), (x, y))

    def lattice(self) -> Lattice:
        """Where an agent can stand, in cells; made when first asked for."""
        if not hasattr(self, "_standing"):
            low, high = self.scene.bounds[:, :2]
            shape = np.ceil((high - low) / CELL).astype(int) + 1
            i, j = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
            places = low + CELL * np.stack([i.ravel(), j.ravel()], axis=1)
            self._standing = Lattice(low.copy(), self.can_stand(places).reshape(shape))
        return self._standing


@kernel
def _have_ground(ground: Ground, places: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (N,): whether there is a floor at places (N, 2) m."""
    for k in range(len(places)):
        out[k] = has_ground(ground, places[k, 0], places[k, 1])


class ContinuousWorld:
    """`scene` of a dataset: its `field` of sound, its floors, its `graph`. `points` (N, 3) m, where sources may be.
    Raises `DatasetError` for another scene's mesh."""

    def __init__(
        self, ds: RirDataset, graph: NavigationGraph, scene: Scene, options: ContinuousOptions
    ) -> None:
        check_scene(ds, scene)
        self.ds, self.graph, self.scene, self.options = ds, graph, scene, options
        self.points, self.ear_height = ds.points, float(ds.manifest.config.grid.height)
        self.field = SoundField(ds, scene, paths=options.paths)
        self._floors: dict[int, Floor] = {}
        self._standing: dict[int, np.ndarray] = {}

    def renderer(self, memory: BlockCache) -> StepRenderer:
        """What renders steps here."""
        rate = self.ds.rate
        block = round(self.options.step_time * rate)
        fade = max(round(self.options.fade * rate), 1)
        return StepRenderer(self.field, block, fade, memory)

    def floor_at(self, height: float) -> Floor:
        """The floor at a height, m; to a millimetre."""
        key = round(1000.0 * height)
        if key not in self._floors:
            self._floors[key] = Floor(self.scene, key / 1000.0, self.ds.manifest.config.graph)
        return self._floors[key]

    def floor_of(self, point: int) -> Floor:
        """The floor below a point."""
        return self.floor_at(float(self.points[point, 2]) - self.ear_height)

    def standing(self, floor: Floor) -> np.ndarray:
        """(n, 2) m: places on a floor, a lattice, on which an agent can stand."""
        key = round(1000.0 * floor.height)
        if key not in self._standing:
            lattice = floor.lattice()
            self._standing[key] = lattice.origin + CELL * np.argwhere(lattice.free)
        return self._standing[key]

    def place(self, x: float, y: float, floor: Floor) -> Place:
        """An agent's ears."""
        return self.field.place(np.array([x, y, floor.height + self.ear_height]))

    def source_at(self, source: SoundSource, time: float) -> Place:
        """Where a source is at a time, s: going to and fro along its route."""
        route = source.route
        if source.speed <= 0.0 or len(route) == 1:
            return self.field.at_point(route[0])
        legs = np.linalg.norm(np.diff(self.points[list(route)], axis=0), axis=1)
        ends = np.concatenate([[0.0], np.cumsum(legs)])
        total = float(ends[-1])
        done = math.fmod(source.speed * time, 2.0 * total)
        done = min(done, 2.0 * total - done)
        k = min(int(np.searchsorted(ends, done, "right")) - 1, len(legs) - 1)
        return self.field.between(route[k], route[k + 1], (done - float(ends[k])) / float(legs[k]))

    def way_to(self, source: Place, x: float, y: float, floor: Floor) -> tuple[float, float, float]:
        """(distance, x, y): the shortest way from (x, y) to a source, m, and where it first turns: over the points
        between which it is, or straight where nothing is in between. The distance is inf where no way leads."""
        sx, sy = source.position[:2].tolist()
        if len(source.points) == 1:
            return floor.distances(sx, sy).ahead(x, y)
        if floor.free_ways(np.array([[x, y, sx, sy]]))[0]:
            return math.hypot(sx - x, sy - y), sx, sy
        best = (math.inf, x, y)
        for p in source.points:
            px, py = self.points[p, :2].tolist()
            far, ahead_x, ahead_y = floor.distances(px, py).ahead(x, y)
            whole = far + math.hypot(px - sx, py - sy)
            if whole < best[0]:
                best = (whole, ahead_x, ahead_y)
        return best

    def oracle_actions(self, episode: ContinuousEpisode) -> int:
        """Actions of the oracle of an episode whose one goal rests, at most those that the options allow."""
        (goal,), options = episode.goals, self.options
        x, y, z = episode.start
        floor = self.floor_at(z)
        goal_x, goal_y = self.points[goal.route[0], :2].tolist()
        gait = Gait(
            options.forward, options.turn, options.slide, options.success_distance, options.max_steps
        )
        facing = math.radians(episode.heading) % (2.0 * math.pi)
        walker = Walker(np.array([x, y]), facing, np.empty(2), np.empty(3))
        return int(count_actions(floor.ground, floor.distances(goal_x, goal_y), gait, walker))

    def check(self, episode: ContinuousEpisode) -> None:
        """Raise `EpisodeError` or `PointError` unless an episode can be walked here."""
        n = len(self.points)
        for source in (*episode.goals, *episode.distractors):
            bad = [p for p in source.route if not 0 <= p < n]
            if bad:
                raise EpisodeError(
                    f"episode '{episode.episode_id}': source of '{source.sound}': point {bad[0]} is none "
                    f"of {n}"
                )
        x, y, z = episode.start
        self.floor_at(z).check(x, y, f"episode '{episode.episode_id}': start")
