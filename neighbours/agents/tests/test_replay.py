"""The field behind a replay's map, from echograms and from stored waveforms alone."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from soundspaces_pictures.episode_map import goal_field

import soundspaces_sim as ss
from soundspaces_sim.nav.agents import Observation
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.env import AudioNavEnv
from soundspaces_sim.nav.episode_state import EpisodeState
from soundspaces_sim.nav.generate import make_episodes
from soundspaces_sim.nav.task import POINTGOAL
from tests.nav.conftest import T_CORRIDOR

GOAL = T_CORRIDOR.index((0, 3))


def test_the_field_of_a_goal(data: NavData) -> None:
    """In a corridor of 1 m cells the direct sound at the neighbour is 0 dB, with or without echograms."""
    ds = ss.open_dataset(data.dataset("tee").path)
    with_echograms = goal_field(ds, GOAL)
    config = ds.manifest.config
    alone = msgspec.structs.replace(config.dataset, store="waveform")
    ds.manifest = msgspec.structs.replace(
        ds.manifest, config=msgspec.structs.replace(config, dataset=alone)
    )
    from_waveforms = goal_field(ds, GOAL)
    assert with_echograms.band == "775 to 3409 Hz" and from_waveforms.band == "all frequencies"
    for field in (with_echograms, from_waveforms):
        assert len(field.points) == len(ds.points) - 1  # not the goal's own
        np.testing.assert_array_equal(field.source, ds.points[GOAL])
        away = np.linalg.norm(field.points - field.source, axis=1)
        near = int(away.argmin())
        assert away[near] == pytest.approx(1.0) and field.visible[near]
        assert field.direct[near] == pytest.approx(1.0, abs=0.02)  # air
    np.testing.assert_array_equal(with_echograms.visible, from_waveforms.visible)
    rows = [n for n in range(len(ds.points)) if n != GOAL]
    away = np.linalg.norm(from_waveforms.points - from_waveforms.source, axis=1)
    for k, n in enumerate(rows):
        energy = 4.0 * np.pi * float(np.square(ds.ambisonic(GOAL, n)[0], dtype=float).sum())
        found = from_waveforms.direct[k] / away[k] ** 2 + from_waveforms.rest[k]
        assert found == pytest.approx(max(energy, from_waveforms.direct[k] / away[k] ** 2), rel=1e-6)


def test_which_sensor_decides(data: NavData) -> None:
    """Of an agent whose logits are its loudness alone; its direction to the goal counts for nothing: the shares are
    softmax of what replacing the loudness does to the action's probability, and of 0."""
    from soundspaces_agents.pictures.impact import impact_along, mean_observation

    class Listener:
        def reset(self, state: EpisodeState, seed: int) -> None:
            self.state = state
            self.rng = np.random.default_rng(seed)

        def chances(self, observation: Observation) -> np.ndarray:
            logits = np.array([-5.0, 2.0 * np.log(observation["intensity"].mean() / 0.02), 0.0, 0.3])
            return np.asarray(np.exp(logits) / np.exp(logits).sum())

        def act(self, observation: Observation) -> int:
            return int(self.rng.choice(4, p=self.chances(observation)))

    episodes = make_episodes(data, "test", 4)
    env = AudioNavEnv(
        data, split="test", sensors=("intensity", POINTGOAL), episodes=episodes, max_steps=12
    )
    means = mean_observation(env, episodes)
    first = np.mean([env.reset(options={"episode": e})[0]["intensity"] for e in episodes], axis=0)
    np.testing.assert_allclose(means["intensity"], first, rtol=1e-6)
    agent = Listener()
    poses, sensors, shares = impact_along(agent, env, episodes[0], means)
    assert len(poses) == len(shares) > 3 and set(sensors) == {"intensity", POINTGOAL}
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    loud = shares[:, sensors.index("intensity")]
    assert (loud >= 0.5).all() and loud.max() > 0.5
    observation, _ = env.reset(seed=0, options={"episode": episodes[0]})
    agent.reset(env.state, 0)  # type: ignore[arg-type]
    whole, without = agent.chances(observation), agent.chances(means)
    change = abs(whole - without)[agent.act(observation)]
    assert loud[0] == pytest.approx(1.0 / (1.0 + np.exp(-change)))
