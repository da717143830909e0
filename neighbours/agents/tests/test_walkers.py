"""Agents by numbers against the vector environment and against a slow twin: the same to the bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from soundspaces_agents.learn.state_table import StateTable
from soundspaces_agents.learn.walkers import Walkers

import soundspaces_sim as ss
from soundspaces_sim.nav.agents import oracle_action
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.env import Setting
from soundspaces_sim.nav.env_options import EnvOptions
from soundspaces_sim.nav.episode_state import EpisodeState
from soundspaces_sim.nav.episodes import Semantic
from soundspaces_sim.nav.generate import make_episodes
from soundspaces_sim.nav.metrics import NAMES
from soundspaces_sim.nav.sounds import SoundBank
from soundspaces_sim.nav.task import POINTGOAL
from soundspaces_sim.nav.vector import AudioNavVectorEnv

SENSORS = ("spectrogram", "intensity", POINTGOAL, "depth", "collision")
OPTIONS: dict[str, Any] = {"sensors": SENSORS, "max_steps": 11, "depth_size": 16}


@pytest.mark.parametrize(
    "more",
    [{}, {"distance_reward": "step"}, {"success_radius": 1.0}, {"ears": "mono"}],
    ids=["plain", "steps", "radius", "mono"],
)
def test_walkers_are_the_vector_environment(seen_data: NavData, more: dict[str, Any]) -> None:
    """Rewards, ends, measures and observations of 60 steps of 7 agents, half of whose episodes are semantic."""
    episodes = make_episodes(seen_data, "train", 12, min_distance=1.0, min_ratio=1.0)
    spoken = Semantic("chair", 3)
    episodes = [replace(e, semantic=spoken) if k % 2 else e for k, e in enumerate(episodes)]
    options = {**OPTIONS, **more, "episodes": episodes}
    env = AudioNavVectorEnv(7, seen_data, autoreset_mode="SameStep", **options)
    table = StateTable(Setting(EnvOptions(data=seen_data, **options)))
    walkers = Walkers(7, table)
    seen, infos = env.reset(seed=3)
    walkers.reset(3)
    rng, ended = np.random.default_rng(0), 0
    for _ in range(60):
        assert [e.episode_id for e in walkers.episodes] == infos["episode_id"].tolist()
        numbers = table.state_numbers(walkers.source, walkers.pose, walkers.steps)
        for sensor in SENSORS[:3]:
            np.testing.assert_array_equal(table.observe(sensor, numbers), seen[sensor])
        for sensor in ("intensity", POINTGOAL):
            np.testing.assert_array_equal(table.vectors(sensor, numbers), seen[sensor])
        np.testing.assert_array_equal(table.observe("depth", walkers.numbers("depth")), seen["depth"])
        np.testing.assert_array_equal(walkers.collided, seen["collision"][:, 0] > 0.5)
        actions = rng.choice(4, 7, p=(0.1, 0.5, 0.2, 0.2))
        seen, rewards, terminated, truncated, infos = env.step(actions)
        step = walkers.step(actions)
        np.testing.assert_array_equal(step.rewards, rewards)
        np.testing.assert_array_equal(step.ends, terminated | truncated)
        np.testing.assert_array_equal(step.truncated, truncated)
        ended += len(step.ended)
        for row, (i, measures) in enumerate(zip(step.ended, step.measures, strict=True)):
            final = infos["final_info"]
            assert all(getattr(measures, name) == final[name][i] for name in NAMES)
            last = table.state_numbers(step.source, step.pose, step.steps)[[row]]
            np.testing.assert_array_equal(
                table.observe("spectrogram", last)[0], infos["final_obs"][i]["spectrogram"]
            )
    assert ended > 20


def test_sounds_of_several_seconds_have_states_of_their_own(data: NavData) -> None:
    """In step t the second t modulo length is heard."""
    rng = np.random.default_rng(0)
    bank = SoundBank(16000)
    bank._sounds["telephone"] = rng.standard_normal(3 * 16000).astype(np.float32)  # three seconds
    setting = Setting(
        EnvOptions(
            data=data, sensors=("intensity",), sounds=bank, episodes=make_episodes(data, "train", 3)
        )
    )
    table = StateTable(setting)
    assert (table.seconds == 3).all()
    walkers = Walkers(2, table)
    walkers.reset(0)
    env = AudioNavVectorEnv(2, data, sensors=("intensity",), sounds=bank, episodes=setting.episodes)
    seen, _ = env.reset(seed=0)
    levels = []
    for _ in range(7):
        found = table.vectors(
            "intensity", table.state_numbers(walkers.source, walkers.pose, walkers.steps)
        )
        np.testing.assert_array_equal(found, seen["intensity"])
        levels.append(found[0, 0])
        walkers.step(np.array([2, 2]))
        seen, *_ = env.step(np.array([2, 2]))
    assert len(set(levels)) > 4


def test_targets_are_those_of_the_state(data: NavData) -> None:
    """Direction and distance from coordinates, the oracle's action and a free step from the graph, one by one."""
    setting = Setting(
        EnvOptions(data=data, episodes=make_episodes(data, "train", 20, min_distance=1.0, min_ratio=1.0))
    )
    table = StateTable(setting)
    states = np.concatenate([table.block_of_source(k) for k in range(len(table))])
    assert table.targets_known(states).all() and len(np.unique(states)) == len(states) == table.states
    found = table.targets(states)
    graph = data.graph("ladder")
    rows = np.random.default_rng(0).choice(len(states), 60, replace=False)
    source, _, pose = table.place(states)
    for row in rows:
        episode = next(e for e in setting.episodes or () if table.source_of(e) == source[row])
        node, k = divmod(int(pose[row]), 4)
        dx, dy = graph.points[episode.goal, :2] - graph.points[node, :2]
        distance = float(np.hypot(dx, dy))
        turn = np.arctan2(dy, dx) - np.deg2rad(90.0 * k)
        if distance > 0.0:
            np.testing.assert_allclose(found.direction[row], [np.cos(turn), np.sin(turn)], atol=1e-9)
        assert found.distance[row] == pytest.approx(distance, abs=1e-9)
        assert found.ahead[row] == (graph.neighbour[node, k] >= 0)
        state = EpisodeState(graph, episode, setting.task)
        state.pose = int(pose[row])
        assert found.action[row] == oracle_action(state)


def test_drawn_episodes_add_sources(data: NavData) -> None:
    walkers = Walkers(3, StateTable(Setting(EnvOptions(data=data, max_steps=2, sensors=("intensity",)))))
    walkers.reset(0)
    first = len(walkers.table)
    for _ in range(30):
        walkers.step(np.array([2, 2, 2]))
        states = walkers.table.state_numbers(walkers.source, walkers.pose, walkers.steps)
        found = walkers.table.vectors("intensity", states)
        np.testing.assert_array_equal(found, walkers.table.observe("intensity", states))
    assert len(walkers.table) > first
    twin = Walkers(3, walkers.table)
    twin.restore(walkers.snapshot())
    for _ in range(10):
        a, b = walkers.step(np.array([1, 2, 3])), twin.step(np.array([1, 2, 3]))
        np.testing.assert_array_equal(a.rewards, b.rewards)
        assert [e.episode_id for e in walkers.episodes] == [e.episode_id for e in twin.episodes]


def test_noise_has_no_table(data: NavData) -> None:
    with pytest.raises(ss.ConfigError, match="a table of states, without noise"):
        StateTable(Setting(EnvOptions(data=data, snr_db=40.0)))
