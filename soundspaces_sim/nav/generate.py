"""Making episodes: pairs of points far enough apart, not in a straight line, that can be heard.

The paper: 100,000 training and 1,000 test episodes for Replica, 2,000,000 and 1,000 for Matterport3D.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soundspaces_sim.core.errors import ConfigError, EpisodeError
from soundspaces_sim.nav.audio_sensor import MEMORY, RMS_AT_1_M, AudioSensor
from soundspaces_sim.nav.cache import BlockCache
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episodes import Episode, Layout, make_episode, write_episodes
from soundspaces_sim.nav.navigation_graph import NavigationGraph
from soundspaces_sim.nav.sounds import SoundBank

_TRIES = 2000  # draws that may be too quiet before a scene is given up


@dataclass(frozen=True)
class Rules:
    """A pair is kept if it is connected, `min_distance` m apart on foot, at least `min_ratio` times as far on
    foot as through the air, and if the first second is heard at most -`audible_db` below the dry sound at 1 m
    in the open. `goals`: points per scene at which sounds may stand, drawn at random; None: all."""

    min_distance: float = 4.0
    min_ratio: float = 1.1
    audible_db: float = -60.0
    goals: int | None = None


def eligible_pairs(graph: NavigationGraph, rules: Rules, goals: np.ndarray | None = None) -> np.ndarray:
    """(P, 2) start and goal that `rules` allow, loudness apart. Raises `EpisodeError` saying what each rule
    removed if there is none."""
    ends = graph.nodes if goals is None else goals
    start, goal = (a.ravel() for a in np.meshgrid(graph.nodes, ends, indexing="ij"))
    apart = start != goal
    start, goal = start[apart], goal[apart]
    hops = graph.hops[start, goal]
    walk = hops * graph.spacing
    straight = np.linalg.norm(graph.points[start] - graph.points[goal], axis=1)
    connected = hops > 0
    far = connected & (walk >= rules.min_distance - 1e-9)
    round_about = far & (walk >= rules.min_ratio * straight - 1e-9)
    if not round_about.any():
        longest = float(walk.max(initial=0.0))
        raise EpisodeError(
            f"{graph.scene}: no pair of {len(start)} is left for episodes: {int((~connected).sum())} are not "
            f"connected, {int((connected & ~far).sum())} closer than {rules.min_distance:g} m (the longest way is "
            f"{longest:g} m), "
            f"{int((far & ~round_about).sum())} on ways less than {rules.min_ratio:g} times the straight line; "
            "lower min_distance or min_ratio, or build the dataset on a grid that passes the doors"
        )
    return np.stack([start[round_about], goal[round_about]], axis=1)


class EpisodeMaker:
    """Draws episodes of a split's scenes. `sounds`: names, one per episode at random."""

    def __init__(
        self,
        data: NavData,
        split: str,
        bank: SoundBank,
        sounds: Sequence[str],
        rules: Rules | None = None,
        seed: int = 0,
        layout: Layout = "replica",
    ) -> None:
        self.data, self.bank, self.sounds, self.layout = data, bank, tuple(sounds), layout
        self.scenes, self.rules, self.seed = data.scenes(split), rules or Rules(), seed
        if not self.sounds:
            raise ConfigError("sounds: expected at least one")
        for sound in self.sounds:
            bank.check(sound)
        self._pairs: dict[str, np.ndarray] = {}
        self._audio: dict[str, AudioSensor] = {}
        self._memory = BlockCache(MEMORY // 4)

    def goals(self, scene: str) -> np.ndarray:
        """Points at which sounds may stand in a scene: the same for the same seed."""
        nodes = self.data.graph(scene).nodes
        count = self.rules.goals
        if count is None or count >= len(nodes):
            return nodes
        row = sorted(self.data.names).index(scene)
        return np.sort(np.random.default_rng((self.seed, row)).choice(nodes, count, replace=False))

    def draw(self, rng: np.random.Generator, episode_id: str, scene: str | None = None) -> Episode:
        """One episode, in a random scene unless it is named. Raises `EpisodeError`."""
        scene = scene or self.scenes[int(rng.integers(len(self.scenes)))]
        graph = self.data.graph(scene)
        if scene not in self._pairs:
            self._pairs[scene] = eligible_pairs(graph, self.rules, self.goals(scene))
        pairs = self._pairs[scene]
        for _ in range(_TRIES):
            start, goal = (int(n) for n in pairs[int(rng.integers(len(pairs)))])
            heading = 90 * int(rng.integers(4))
            sound = self.sounds[int(rng.integers(len(self.sounds)))]
            if self.level(scene, sound, goal, start, heading) >= self.rules.audible_db:
                return make_episode(graph, episode_id, start, heading, goal, sound, self.layout)
        raise EpisodeError(
            f"{scene}: no pair of {len(pairs)} is left for episodes: {_TRIES} of {_TRIES} draws are more than "
            f"{-self.rules.audible_db:g} dB below the dry sound at 1 m; lower audible_db"
        )

    def level(self, scene: str, sound: str, goal: int, node: int, heading: int) -> float:
        """dB of the first observation re the dry sound at 1 m in the open; both ears."""
        if scene not in self._audio:
            ds = self.data.dataset(scene)
            self._audio[scene] = AudioSensor(
                ds, self.bank, frozenset(("intensity",)), "memory", self._memory
            )
        ears = self._audio[scene].block(sound, goal, node)["intensity"][heading // 90].astype(float)
        dry = self.bank[sound][: self.bank.rate].astype(float)
        reference = RMS_AT_1_M * float(np.sqrt(np.mean(dry**2)))
        level = float(np.sqrt(np.mean(ears**2)))
        return float(20.0 * np.log10(max(level, 1e-30) / max(reference, 1e-30)))


def make_episodes(
    data: NavData | str | Path,
    split: str,
    count: int,
    seed: int = 0,
    min_distance: float = 4.0,
    min_ratio: float = 1.1,
    audible_db: float = -60.0,
    *,
    sounds: Sequence[str] = ("telephone",),
    bank: SoundBank | None = None,
    goals: int | None = None,
    layout: Layout = "replica",
    progress: Callable[[int, int], None] | None = None,
) -> list[Episode]:
    """`count` episodes of a split, its scenes in turn; pairs, headings and sounds uniformly by `seed`.

    See `Rules` for what is kept. Raises `EpisodeError` if a scene has no such pair.
    """
    if count < 1:
        raise ConfigError(f"count: expected at least 1 episode, got {count}")
    data = data if isinstance(data, NavData) else NavData(data)
    scenes = data.scenes(split)
    bank = bank or SoundBank(data.dataset(scenes[0]).rate)
    rules = Rules(min_distance, min_ratio, audible_db, goals)
    maker = EpisodeMaker(data, split, bank, sounds, rules, seed, layout)
    rng = np.random.default_rng((seed, sorted(data.splits).index(split)))
    out = []
    for k in range(count):
        out.append(maker.draw(rng, str(k), scenes[k % len(scenes)]))
        if progress is not None:
            progress(k + 1, count)
    return out


def write_splits_episodes(
    root: str | Path,
    out: str | Path,
    layout: Layout = "replica",
    count: int = 1000,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """`count` episodes of every split of a folder of datasets, where SoundSpaces looks for them beside its
    `binaural_rirs` and `metadata`: ``<out>/audionav/<layout>/v1/<split>/``. Returns the files to open."""
    data = NavData(root)
    return [
        write_episodes(
            make_episodes(data, split, count, layout=layout, progress=progress),
            Path(out) / "audionav" / layout / "v1" / split,
        )
        for split in data.splits
    ]
