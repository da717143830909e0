"""A dataset as an agent meets it that may be anywhere on its floors."""

from __future__ import annotations

import math

import numpy as np

from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.nav.cache import BlockCache
from soundspaces_sim.nav.continuous.distances import CELL
from soundspaces_sim.nav.continuous.episodes import ContinuousEpisode, SoundSource
from soundspaces_sim.nav.continuous.floor import Floor
from soundspaces_sim.nav.continuous.sound_field import Place, SoundField
from soundspaces_sim.nav.continuous.step_renderer import StepRenderer
from soundspaces_sim.nav.continuous.task import ContinuousOptions
from soundspaces_sim.nav.depth.draw import check_scene
from soundspaces_sim.nav.errors import EpisodeError
from soundspaces_sim.nav.navigation_graph import NavigationGraph
from soundspaces_sim.scene.scene import Scene


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
