"""A slow, obvious twin of the continuous environment: brute force over all segments, whole responses, plain
convolution.

It shares with the environment what has tests of its own: obstacles' segments, walking distances, the discrete
arrivals between points. Motion, weights, reverberation, signals, cross-fades, times and measures are written anew.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.signal
from soundspaces_continuous.env import ContinuousNavEnv
from soundspaces_continuous.episodes import ContinuousEpisode, SoundSource

from soundspaces_sim.echogram.echogram import without_arrivals
from soundspaces_sim.rendering.ambisonics import add_arrivals
from soundspaces_sim.rendering.binaural import binaural_rirs

RATE, STEP_S, FORWARD, TURN, RADIUS, SKIN = 16000, 0.25, 0.25, math.radians(15.0), 0.1, 1e-6
BLOCK, FADE = 4000, 192


def contact(segments: np.ndarray, p: np.ndarray, d: np.ndarray) -> tuple[float, np.ndarray]:
    """(share, normal) of the first contact of a disc at p with any segment, on its way by d."""
    best, normal = math.inf, np.zeros(2)
    for ax, ay, bx, by in segments:
        a, b = np.array([ax, ay]), np.array([bx, by])
        length = float(np.linalg.norm(b - a))
        if length > 1e-9:
            e = (b - a) / length
            n = np.array([-e[1], e[0]])
            if (p - a) @ n < 0.0:
                n = -n
            if d @ n < -1e-9 * np.abs(d).sum() and (p - a) @ n > 0.999 * RADIUS:
                t = max(((p - a) @ n - RADIUS) / -(d @ n), 0.0)
                if 0.0 <= (p + t * d - a) @ e <= length and t < best:
                    best, normal = t, n
        for end in (a, b):
            roots = np.roots([d @ d, 2.0 * (p - end) @ d, (p - end) @ (p - end) - RADIUS**2])
            if np.isreal(roots).all() and (p - end) @ d < 0.0:
                t = max(float(roots.real.min()), 0.0)
                if t < best:
                    best, normal = t, (p + t * d - end) / np.linalg.norm(p + t * d - end)
    return best, normal


def walk(segments: np.ndarray, p: np.ndarray, d: np.ndarray, slide: bool) -> tuple[np.ndarray, bool]:
    """Where a move by d ends, and whether it touched something."""
    first, collided = d, False
    for _ in range(4):
        if np.linalg.norm(d) < SKIN:
            break
        t, n = contact(segments, p, d)
        if t > 1.0:
            return p + d, collided
        collided = True
        t = max(t - SKIN / max(-(d @ n), 1e-3 * float(np.linalg.norm(d))), 0.0)
        p, d = p + t * d, (1.0 - t) * d
        if not slide:
            break
        d = d - min(d @ n, 0.0) * n
        if d @ first <= 0.0:
            break
    return p, collided


class Twin:
    """Walks an episode of an environment beside it."""

    def __init__(self, env: ContinuousNavEnv, episode: ContinuousEpisode) -> None:
        self.setting, self.episode = env.setting, episode
        self.world = self.setting.world(episode.scene)
        self.ds, self.field = self.world.ds, self.world.field
        self.floor = self.world.floor_at(episode.start[2])
        self.p, self.z = np.array(episode.start[:2]), episode.start[2] + 1.5
        self.heading, self.steps, self.path = math.radians(episode.heading), 0, 0.0
        self.collisions = 0
        self.before: np.ndarray | None = None
        self.stopped = False

    def place_of(self, source: SoundSource, time: float) -> np.ndarray:
        """Where a source is, walking to and fro, found in small steps."""
        points = self.ds.points[list(source.route)]
        if source.speed == 0.0 or len(points) == 1:
            return np.asarray(points[0])
        ways = np.concatenate([points, points[-2::-1]])
        left, k = source.speed * time, 0
        while True:
            a, b = ways[k % (len(ways) - 1)], ways[k % (len(ways) - 1) + 1]
            leg = float(np.linalg.norm(b - a))
            if left < leg:
                return np.asarray(a + (b - a) * left / leg)
            left, k = left - leg, k + 1

    def sources_points(self, source: SoundSource, time: float) -> dict[int, float]:
        """Shares of the points between which a source is."""
        place = self.place_of(source, time)
        far = np.linalg.norm(self.ds.points - place, axis=1)
        near = np.argsort(far, kind="stable")[:2]
        if far[near[0]] < 1e-9:
            return {int(near[0]): 1.0}
        leg = far[near].sum()
        return {int(near[0]): 1.0 - far[near[0]] / leg, int(near[1]): 1.0 - far[near[1]] / leg}

    def listener_points(self) -> dict[int, float]:
        """Shepard's shares of the points around."""
        here, weights = np.array([*self.p, self.z]), {}
        there = self.field.place(here)._replace(points=(0,), shares=(1.0,))
        for k, point in enumerate(self.ds.points):
            d = float(np.linalg.norm(point - here))
            if d < 1e-9:
                return {k: 1.0}
            if d < 1.0 and self.field.sees(self.field.at_point(k), there):
                weights[k] = ((1.0 - d) / d) ** 2
        if not weights:
            near = np.argsort(np.linalg.norm(self.ds.points - here, axis=1), kind="stable")[:16]
            seen = [int(k) for k in near if self.field.sees(self.field.at_point(int(k)), there)]
            return {(seen or [int(near[0])])[0]: 1.0}
        total = sum(weights.values())
        return {k: w / total for k, w in weights.items()}

    def response(self, source: SoundSource, time: float) -> np.ndarray:
        """(2, n) at the ears, whole."""
        parts = []
        for s, of_s in self.sources_points(source, time).items():
            for l, of_l in self.listener_points().items():
                late = self.ds.rendered(without_arrivals(self.ds.echogram(s, l)), s, l)
                parts.append(math.sqrt(of_s * of_l) * late)
        place = self.world.source_at(source, time)
        assert np.allclose(place.position, self.place_of(source, time), atol=1e-9)
        listener = self.field.place(np.array([*self.p, self.z]))
        echogram = self.field.echogram(place, listener)
        n = max(part.shape[1] for part in parts) + RATE // 5
        whole = np.zeros((9, n), np.float32)
        for part in parts:
            whole[:, : part.shape[1]] += part
        add_arrivals(whole, echogram, RATE)
        return np.asarray(binaural_rirs(whole, RATE, [(math.degrees(self.heading), 0.0, 0.0)])[0])

    def dry(self, source: SoundSource, samples: int) -> np.ndarray:
        clip = self.setting.bank[source.sound]
        out = np.zeros(samples)
        first = int(source.onset / STEP_S) * BLOCK
        last = (
            samples if math.isinf(source.offset) else min(int(source.offset / STEP_S) * BLOCK, samples)
        )
        for m in range(first, last, len(clip)):
            out[m : min(m + len(clip), last)] = clip[: min(len(clip), last - m)]
        return out

    def hear(self) -> np.ndarray:
        """(2, BLOCK) of this step: what both this pose and the one before give, cross-faded."""
        end = (self.steps + 1) * BLOCK + FADE
        here = np.zeros((2, end))
        for source in (*self.episode.goals, *self.episode.distractors):
            response = self.response(source, self.steps * STEP_S)
            signal = self.dry(source, end)
            here += np.stack([scipy.signal.fftconvolve(signal, ear)[:end] for ear in response])
        first = self.steps * BLOCK
        out = here[:, first : first + BLOCK].copy()
        if self.before is not None:
            share = (np.arange(FADE) + 0.5) / FADE
            out[:, :FADE] = (1.0 - share) * self.before[:, first : first + FADE] + share * out[:, :FADE]
        self.before = here
        return out

    def nearest_source(self) -> float:
        """m, straight."""
        here, time = np.array([*self.p, self.z]), self.steps * STEP_S
        sources = (*self.episode.goals, *self.episode.distractors)
        return min(float(np.linalg.norm(here - self.place_of(s, time))) for s in sources)

    def way(self, source: SoundSource) -> float:
        place = self.world.source_at(source, self.steps * STEP_S)
        return float(self.world.way_to(place, *self.p.tolist(), self.floor)[0])

    def act(self, action: int, slide: bool) -> None:
        self.steps += 1
        if action == 0:
            self.stopped = True
        elif action == 1:
            d = FORWARD * np.array([math.cos(self.heading), math.sin(self.heading)])
            after, collided = walk(self.floor.obstacles.segments, self.p, d, slide)
            self.path += float(np.linalg.norm(after - self.p))
            self.collisions += collided
            self.p = after
        else:
            self.heading += TURN if action == 2 else -TURN

    def measures(self) -> dict[str, float]:
        """What success, its path length and its silences come to."""
        far = min(self.way(goal) for goal in self.episode.goals)
        won = float(self.stopped and far < 1.0)
        silent = all(
            not int(g.onset / STEP_S)
            <= self.steps
            < (math.inf if math.isinf(g.offset) else int(g.offset / STEP_S))
            for g in self.episode.goals
        )
        misled = self.stopped and any(self.way(d) < 1.0 for d in self.episode.distractors)
        return {
            "success": won,
            "spl": won * self.episode.distance / max(self.episode.distance, self.path),
            "distance_to_goal": far,
            "collisions": float(self.collisions),
            "na": float(self.steps),
            "success_when_silent": won * silent,
            "distractor_success": float(misled),
        }


def below(signal: np.ndarray, frequency: float = 3000.0) -> np.ndarray:
    """What is below a frequency: near Nyquist's, paths differ by how fractional delays are windowed."""
    spectrum = np.fft.rfft(signal, axis=-1)
    spectrum[..., np.fft.rfftfreq(signal.shape[-1], 1.0 / RATE) > frequency] = 0.0
    return np.asarray(np.fft.irfft(spectrum, signal.shape[-1], axis=-1))
