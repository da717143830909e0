"""Which sensor decides: the figure of modalities of the seed paper (section 6), for agents of ours.

A sense is ablated by replacing its observation with the mean over training. Its impact on a step is the change of
the probability of the action that was taken; impacts are normalised over sensors by softmax.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure
from scipy.special import softmax
from soundspaces_pictures import draw_plan

from soundspaces_agents.experiments import LEARNT_IN, VARIANTS, Trial
from soundspaces_agents.pictures.order import in_turn
from soundspaces_agents.study import Study, episodes_path, open_test
from soundspaces_sim.nav import AudioNavEnv, Episode, read_episodes
from soundspaces_sim.parts import (
    POINTGOAL,
    EpisodeState,
    Observation,
    read_floorplan,
)

LABELS = {"spectrogram": "hearing", "depth": "sight", POINTGOAL: "GPS", "intensity": "loudness"}
_EPISODES = 2  # rows of the figure
_TRAINING = 200  # episodes whose first observations are averaged


class Decider(Protocol):
    """An agent that says how likely its actions are."""

    def reset(self, state: EpisodeState, seed: int) -> None: ...

    def act(self, observation: Observation) -> int: ...

    def chances(self, observation: Observation) -> np.ndarray: ...


def mean_observation(env: AudioNavEnv, episodes: Sequence[Episode]) -> Observation:
    """Means over the first observations of episodes."""
    seen = [env.reset(seed=k, options={"episode": e})[0] for k, e in enumerate(episodes)]
    return {name: np.mean([one[name] for one in seen], axis=0).astype(np.float32) for name in seen[0]}


def impact_along(
    agent: Decider, env: AudioNavEnv, episode: Episode, means: Mapping[str, np.ndarray], seed: int = 0
) -> tuple[list[int], list[str], np.ndarray]:
    """(poses before each step (t,), names of sensors (m,), shares (t, m), which sum to 1) of an episode."""
    observation, _ = env.reset(seed=seed, options={"episode": episode})
    assert env.state is not None
    agent.reset(env.state, seed)
    sensors = [name for name in LABELS if name in observation]
    poses, rows = [], []
    while not env.state.over:
        whole = agent.chances(observation)
        without = [agent.chances({**observation, name: means[name]}) for name in sensors]
        poses.append(env.state.pose)
        action = agent.act(observation)
        rows.append(softmax([abs(float(whole[action] - less[action])) for less in without]))
        observation, *_ = env.step(action)
    return poses, sensors, np.array(rows).reshape(-1, len(sensors))


def write_impact(plan: Study, out: Path, name: str, path: Path) -> None:
    """The figure of an agent of a study: two test episodes, a panel for each sense."""
    agent: Any
    agent, env, episodes = open_test(plan, out, Trial(name, 0))
    data = env.setting.data
    train = in_turn(read_episodes(episodes_path(out, LEARNT_IN), data))[:_TRAINING]
    variant = VARIANTS[name]
    before = AudioNavEnv(
        data,
        task=variant.task,
        sensors=variant.sensors,
        episodes=train,
        depth_size=env.setting.task.depth_size,
    )
    means = mean_observation(before, train)
    sensors = [s for s in LABELS if s in means]
    figure = Figure(figsize=(4.2 * len(sensors), 3.6 * _EPISODES), layout="constrained")
    panels = figure.subplots(_EPISODES, len(sensors), squeeze=False)
    for k, (row, episode) in enumerate(zip(panels, in_turn(episodes), strict=False)):
        ds = data.dataset(episode.scene)
        poses, _, shares = impact_along(agent, env, episode, means, k)
        places = ds.points[np.array(poses) >> 2, :2]
        for axes, sense, share in zip(row, sensors, shares.T, strict=True):
            draw_plan(axes, read_floorplan(ds.path), 0)
            dots = axes.scatter(*places.T, c=share, cmap="viridis", vmin=0.2, vmax=0.6, s=28, zorder=8)
            axes.plot(*places.T, color="#888888", lw=0.8, zorder=7)
            axes.plot(*places[0], "o", mfc="none", mec="black", ms=11, zorder=9)
            axes.plot(*ds.points[episode.goal, :2], "*", color="#D55E00", ms=12, zorder=9)
            axes.set_title(f"{LABELS[sense]}: {episode.scene}", fontsize=9)
    figure.colorbar(dots, ax=panels.ravel().tolist(), label="share of the decision")
    figure.savefig(path, dpi=70)
