"""Learning in continuous space: cues by hand, ears without delays, DAgger that goes on to the bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundspaces_continuous as continuous
from soundspaces_agents.hrtf_delays import without_delays, write_hrtf
from soundspaces_agents.learn.cues import BANDS, CUES, LAGS, ear_cues
from soundspaces_continuous.task import ContinuousOptions

import soundspaces_sim.nav as nav
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.rendering.hrtf import load_hrtf, onset_delays
from tests.nav.conftest import LADDER, T_CORRIDOR, lattice_scene

SCENES = {"ladder": lattice_scene(LADDER, "ladder"), "tee": lattice_scene(T_CORRIDOR, "tee")}


def test_cues_of_a_wave() -> None:
    """White noise that reaches the left ear 5 samples before the right one, and is twice as loud there."""
    wave = np.random.default_rng(0).standard_normal(4005)
    found = ear_cues(np.stack([2.0 * wave[5:], wave[:-5]]), 16000)
    assert found.shape == (CUES,) and found.dtype == np.float32
    for part in (found[:LAGS], found[LAGS : 2 * LAGS]):
        assert part.argmax() == LAGS // 2 + 5 and part.max() > 0.9
    level, difference = found[2 * LAGS : 2 * LAGS + BANDS], found[2 * LAGS + BANDS :]
    assert difference == pytest.approx(20.0 * np.log10(2.0) / 20.0, abs=0.03)
    # The bands from 100 Hz to 8 kHz hold 0.9875 of the power of white noise: level / 60 dB from -90 dB on.
    power = 10.0 ** (0.1 * (60.0 * level - 90.0))
    assert power.sum() == pytest.approx(2.0 * 0.9875, rel=0.03)  # geometric mean of 4 and 1
    assert (ear_cues(np.zeros((2, 4000)), 16000) == 0.0).all()


def test_ears_without_delays(tmp_path: Path) -> None:
    """The same magnitudes, and both ears at once."""
    own = load_hrtf()
    bare = without_delays(own)
    a, b = (np.abs(np.fft.rfft(h.ir, axis=2)) for h in (own, bare))
    assert (np.abs(b - a).max(axis=2) < 0.01 * a.max(axis=2)).all()  # what is cut off after 512 taps
    left, right = onset_delays(own).T
    assert np.abs(left - right).max() > 6e-4
    left, right = onset_delays(bare).T
    assert np.abs(left - right).max() < 3e-5
    write_hrtf(tmp_path / "ears.sofa", bare)
    read = load_hrtf(tmp_path / "ears.sofa")
    assert read.directions == pytest.approx(bare.directions, abs=1e-9) and read.rate == bare.rate
    assert np.array_equal(read.ir, bare.ir)


def test_dagger_goes_on_to_the_bit(data: nav.NavData, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from soundspaces_agents.learn.continuous_dagger import DaggerConfig, load_policy, train_continuous
    from soundspaces_agents.learn.continuous_policy import SENSORS, ContinuousAgent

    options = ContinuousOptions(
        data=data,
        scenes=SCENES,
        rules=continuous.Rules(min_distance=2.0, places=3),
        sensors=SENSORS,
        max_steps=6,
    )
    config = DaggerConfig(rounds=3, led=1, episodes=2, batches=2, batch=2)

    def stop(row: dict[str, Any]) -> None:
        if row["update"] == 2:
            raise KeyboardInterrupt

    train_continuous(options, tmp_path / "whole", tmp_path / "led", 4, config)
    with pytest.raises(KeyboardInterrupt):
        train_continuous(options, tmp_path / "halted", tmp_path / "led", 4, config, stop)
    train_continuous(options, tmp_path / "halted", tmp_path / "led", 4, config)
    whole, halted = (load_policy(tmp_path / name) for name in ("whole", "halted"))
    for a, b in zip(whole.state_dict().values(), halted.state_dict().values(), strict=True):
        assert bool((a == b).all())
    env = continuous.ContinuousNavEnv(
        data, scenes=SCENES, rules=options.rules, sensors=SENSORS, max_steps=6
    )
    env.reset(seed=1)
    assert env.state is not None
    result = nav.evaluate(ContinuousAgent(whole, "agent", 16000), env, [env.state.episode])
    assert "success_when_silent" in result.summary()


def test_sb3_learns_and_is_tested(
    data: nav.NavData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A glimpse: a row of the curve each 64 steps and one at the end, agent and follower in the same episodes, with
    the follower's success as `evaluate` has it; the stack holds the last steps in order. The network is tested once
    per row, and the page's last row is the last row of the curve."""
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
    from soundspaces_agents.learn import continuous_ppo
    from soundspaces_agents.learn.continuous_policy import INPUTS
    from soundspaces_agents.learn.continuous_ppo import SbConfig, Stack, run_sb3

    config = SbConfig(
        steps=128, every=64, agents=2, episodes=3, rollout=32, batch=32, epochs=1, max_steps=12, min_distance=2.0,
        places=3,
    )  # fmt: skip
    said: list[str] = []
    tested: list[str] = []

    def evaluate(agent: Any, *args: Any) -> nav.Result:
        tested.append(agent.name)
        return nav.evaluate(agent, *args)

    monkeypatch.setattr(continuous_ppo, "evaluate", evaluate)
    page = run_sb3(data, tmp_path, config, 1, said.append, SCENES)
    rows = [json.loads(line) for line in (tmp_path / "curve.jsonl").read_text().splitlines()]
    assert [row["steps"] for row in rows] == [64, 128] and (tmp_path / "continuous_ppo.png").exists()
    assert all(0.0 <= row["test_success"] <= 1.0 and row["processor_s"] > 0.0 for row in rows)
    assert tested == ["DirectionFollower", "PPO", "PPO"]
    assert f"| {rows[-1]['test_success']:.3f} " in page.read_text().split("SB3's PPO, at the end ")[1]
    follower = page.read_text().split("| DirectionFollower | ")[1].split()[0]
    assert f"success {follower}" in said[0]
    stack = Stack(2, 16000)
    ears = np.ones((2, 4000), np.float32)
    first = stack.add({"audiogoal": ears, "pose": np.zeros(4), "collision": np.zeros(1)})
    stack.took(3)
    second = stack.add({"audiogoal": ears, "pose": np.ones(4), "collision": np.zeros(1)})
    assert (first[:INPUTS] == 0.0).all() and (second[:INPUTS] == first[INPUTS:]).all()
    assert second[-6:].tolist() == [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]  # RIGHT


def test_places(data: nav.NavData) -> None:
    """Sounds stand at so many nodes of a scene, the same in all episodes."""
    env = continuous.ContinuousNavEnv(
        data, scenes=SCENES, rules=continuous.Rules(min_distance=1.0, places=2), sensors=("pose",)
    )
    found: dict[str, set[int]] = {}
    for seed in range(12):
        env.reset(seed=seed)
        assert env.state is not None
        episode = env.state.episode
        found.setdefault(episode.scene, set()).add(episode.goals[0].route[0])
    assert found and all(len(points) <= 2 for points in found.values())
    with pytest.raises(ConfigError, match="places"):
        continuous.Rules(goals=2, places=1)
