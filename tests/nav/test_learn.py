"""Learning: sizes of networks, the loss against a slow twin, resumption, agents that are kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.nav.agents import oracle_action
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.env import AudioNavEnv
from soundspaces_sim.nav.evaluate import evaluate
from soundspaces_sim.nav.generate import make_episodes
from soundspaces_sim.nav.presets import NetConfig, TrainConfig, preset
from soundspaces_sim.nav.task import POINTGOAL
from soundspaces_sim.nav.trained import load_agent
from soundspaces_sim.nav.vector import AudioNavVectorEnv

torch = pytest.importorskip("torch", reason="the extra `train` is not installed")

TINY = replace(
    preset("small"), envs=4, steps=16, updates=2, max_steps=20, minibatches=2, epochs=2,
    net=NetConfig((4, 4, 4), (5, 3, 3), (2, 2, 1), 16, 16, moves=True, tidy=True, stop_bias=-3.0),
)  # fmt: skip


@pytest.mark.parametrize(("frames", "parameters"), [(26, 4_952_453), (69, 4_346_693)])
def test_the_papers_network_has_its_size(frames: int, parameters: int) -> None:
    from soundspaces_sim.nav.learn.net import Policy

    with torch.device("meta"):  # sizes alone
        policy = Policy({"spectrogram": (65, frames, 2), "depth": (128, 128, 1)}, preset("paper").net)
    assert sum(p.numel() for p in policy.parameters()) == parameters


def test_a_sequence_is_its_steps() -> None:
    from soundspaces_sim.nav.learn.net import MOVES, Policy

    torch.manual_seed(0)
    policy = Policy({"intensity": (2,), POINTGOAL: (2,)}, TINY.net)
    t, n = 7, 3
    seen = {"intensity": torch.rand(t, n, 2), POINTGOAL: torch.rand(t, n, 2)}
    moves, starts = torch.randint(MOVES, (t, n)), (torch.rand(t, n) < 0.3).float()
    hidden = torch.rand(n, 16)
    logits, values = policy.sequence(seen, moves, starts, hidden)
    for k in range(t):
        for i in range(n):
            if starts[k, i]:
                hidden[i] = 0.0
        step_logits, step_values, hidden = policy.step(
            {s: v[k] for s, v in seen.items()}, moves[k], hidden
        )
        torch.testing.assert_close(logits[k], step_logits)
        torch.testing.assert_close(values[k], step_values)
        hidden = hidden.detach().clone()


def test_pictures_met_again_are_encoded_once(data: NavData) -> None:
    """What a rollout keeps of pictures is what agents saw, and its replay has the values and the gradients of the
    whole sequence; a corridor has few places, so most are met again."""
    from soundspaces_sim.nav.learn.net import Policy
    from soundspaces_sim.nav.learn.rollout import Collector, sample

    torch.manual_seed(1)
    env = AudioNavVectorEnv(
        4, data, sensors=("spectrogram", "collision"), max_steps=9, autoreset_mode="SameStep"
    )
    policy = Policy(env.setting.sensor_suite.shapes, replace(TINY.net, stop_bias=0.0))
    collector = Collector(env, policy, 0)
    gen, seen, said = torch.Generator().manual_seed(0), [], []

    def choose(_: Any, logits: Any) -> Any:
        seen.append({name: values.clone() for name, values in collector.observations.items()})
        said.append(logits)
        actions = sample(logits, gen)
        return actions, actions

    rollout = collector.collect(40, choose)
    whole = {
        name: torch.stack([step[name] for step in seen]) for name in env.setting.sensor_suite.shapes
    }
    pictures, numbers = rollout.pictures["spectrogram"]
    assert torch.equal(pictures[numbers], whole["spectrogram"])
    assert len(pictures) == len({p.numpy().tobytes() for p in whole["spectrogram"].flatten(0, 1)}) < 120
    assert set(rollout.observations) == {"collision"}
    assert torch.equal(rollout.observations["collision"], whole["collision"])
    agents = torch.tensor([2, 0, 3])
    found = rollout.replay(policy, agents)
    torch.testing.assert_close(found[0], torch.stack(said)[:, agents])
    expected = policy.sequence(
        {name: values[:, agents] for name, values in whole.items()}, rollout.moves[:, agents],
        rollout.starts[:, agents], rollout.hidden[agents],
    )  # fmt: skip
    slopes = [
        torch.autograd.grad(
            logits[..., 1].square().mean() + values.square().mean(), [*policy.parameters()]
        )
        for logits, values in (found, expected)
    ]
    for a, b in zip(found, expected, strict=True):
        torch.testing.assert_close(a, b)
    for a, b in zip(*slopes, strict=True):
        torch.testing.assert_close(a, b)
    assert any(slope.abs().max() > 1e-6 for slope in slopes[0])


@pytest.mark.parametrize("bootstrap", [False, True])
def test_advantages_are_sums_of_discounted_errors(bootstrap: bool) -> None:
    """A_t = Σ_k (γ λ)^k δ_{t+k} within the episode, written out; the last state of a cut one has a value."""
    from soundspaces_sim.nav.learn.ppo import advantages
    from soundspaces_sim.nav.learn.rollout import Rollout

    gen = torch.Generator().manual_seed(3)
    t, n, gamma, lam = 9, 2, 0.9, 0.8
    rewards, values = torch.rand(t, n, generator=gen), torch.rand(t, n, generator=gen)
    ends, cut, last = torch.zeros(t, n), torch.zeros(t, n), torch.rand(n, generator=gen)
    ends[2, 0] = ends[5, 1] = ends[7, 0] = 1.0
    cut[5, 1] = 0.7
    empty = torch.zeros(t, n)
    rollout = Rollout({}, empty, empty, empty, empty, empty, empty, values, rewards, ends, cut, last, {})
    found, returns = advantages(rollout, gamma, lam, bootstrap)
    for i in range(n):
        for k in range(t):
            expected, weight = 0.0, 1.0
            for j in range(k, t):
                following = float(values[j + 1, i]) if j + 1 < t else float(last[i])
                if ends[j, i]:
                    following = float(cut[j, i]) if bootstrap else 0.0
                expected += weight * (float(rewards[j, i]) + gamma * following - float(values[j, i]))
                if ends[j, i]:
                    break
                weight *= gamma * lam
            assert float(found[k, i]) == pytest.approx(expected, abs=1e-5)
            assert float(returns[k, i]) == pytest.approx(expected + float(values[k, i]), abs=1e-5)


@pytest.mark.parametrize("clip_value", [False, True])
def test_loss_against_a_slow_twin(clip_value: bool) -> None:
    from soundspaces_sim.nav.learn.ppo import ppo_loss

    rng = np.random.default_rng(1)
    n, clip = 50, 0.2
    config = replace(TrainConfig(), clip_value=clip_value)
    logits, values = rng.standard_normal((n, 4)), rng.standard_normal(n)
    actions, advantage = rng.integers(4, size=n), rng.standard_normal(n)
    old_values, returns = values + 0.5 * rng.standard_normal(n), rng.standard_normal(n)
    old = np.log(rng.dirichlet(np.ones(4), n))[np.arange(n), actions]
    policy = value = entropy = 0.0
    for k in range(n):
        p = np.exp(logits[k]) / np.exp(logits[k]).sum()
        ratio = p[actions[k]] / np.exp(old[k])
        policy -= min(ratio * advantage[k], min(max(ratio, 1 - clip), 1 + clip) * advantage[k]) / n
        error = (values[k] - returns[k]) ** 2
        if clip_value:
            near = old_values[k] + min(max(values[k] - old_values[k], -clip), clip)
            error = max(error, (near - returns[k]) ** 2)
        value += 0.5 * error / n
        entropy -= float((p * np.log(p)).sum()) / n
    tensors = [
        torch.from_numpy(a) for a in (logits, values, actions, old, old_values, advantage, returns)
    ]
    a, b, c, d, e, f, g = tensors
    loss = ppo_loss(a, b, c, d, e, f, g, clip, config)
    assert [float(x) for x in loss] == pytest.approx(
        [policy + config.value_weight * value - config.entropy_weight * entropy, policy, value, entropy]
    )


def test_the_oracle_labels_what_it_would_do(data: NavData) -> None:
    from soundspaces_sim.nav.learn.dagger import Dagger
    from soundspaces_sim.nav.learn.net import Policy
    from soundspaces_sim.nav.learn.rollout import Collector

    env = AudioNavVectorEnv(
        3, data, split="test", sensors=("intensity", "collision"), max_steps=9, autoreset_mode="SameStep"
    )
    policy = Policy(env.setting.sensor_suite.shapes, TINY.net)
    learner = Dagger(policy, Collector(env, policy, 0), replace(TINY, updates=100, oracle_share=1.0), 0)
    expected = []

    def spy(walks: list[Any], logits: Any) -> Any:
        expected.append([oracle_action(w) for w in walks])
        return learner._choose(walks, logits)

    rollout = learner.collector.collect(12, spy)
    assert rollout.labels.tolist() == expected
    assert (rollout.actions == rollout.labels).all()  # at first the oracle acts
    assert float(rollout.ends.sum()) > 0


@pytest.mark.parametrize("method", ["ppo", "dagger"])
def test_training_is_resumed_and_repeats_itself(data: NavData, tmp_path: Path, method: str) -> None:
    from soundspaces_sim.nav.learn.checkpoint import read_checkpoint
    from soundspaces_sim.nav.learn.run_files import read_curve
    from soundspaces_sim.nav.learn.train import Run, train_agent

    run = Run("tiny", "AudioGoal", ("intensity", "collision"), method)  # type: ignore[arg-type]
    root = data.root
    a, b = (train_agent(run, TINY, root, tmp_path / name, 5) for name in ("a", "b"))
    one, two = (read_checkpoint(p)["weights"] for p in (a, b))
    assert all(torch.equal(one[k], two[k]) for k in one)
    stamp = a.stat().st_mtime_ns
    assert (
        train_agent(run, TINY, root, tmp_path / "a", 5) == a and a.stat().st_mtime_ns == stamp
    )  # nothing to do
    train_agent(run, replace(TINY, updates=3), root, tmp_path / "a", 5)
    rows = read_curve(tmp_path / "a")
    assert [r["update"] for r in rows] == [1, 2, 3] and rows[-1]["steps"] == 3 * 64
    assert 0 < rows[1]["episodes"] <= rows[2]["episodes"]
    other = replace(run, sensors=("spectrogram", "collision"))
    with pytest.raises(ss.ConfigError, match="begun with other sensors"):
        train_agent(other, replace(TINY, updates=4), root, tmp_path / "a", 5)


def test_a_kept_agent_walks_and_knows_its_sensors(data: NavData, tmp_path: Path) -> None:
    from soundspaces_sim.nav.learn.train import Run, train_agent

    path = train_agent(
        Run("tiny", "AudioGoal", ("spectrogram", "collision")), TINY, data.root, tmp_path, 0
    )
    agent = load_agent(path)
    episodes = make_episodes(data, "test", 3)
    env = AudioNavEnv(data, split="test", sensors=("spectrogram", "collision"), max_steps=15)
    rows = evaluate(agent, env, episodes).rows
    np.testing.assert_array_equal(rows, evaluate(agent, env, episodes).rows)
    with pytest.raises(
        ss.ConfigError, match=r"trained with the sensors spectrogram, collision.*has intensity"
    ):
        evaluate(agent, AudioNavEnv(data, split="test", sensors=("intensity",)), episodes)
    (tmp_path / "bad.pt").write_bytes(b"nothing")
    with pytest.raises(ss.ConfigError, match=r"bad\.pt: not a checkpoint"):
        load_agent(tmp_path / "bad.pt")
    with pytest.raises(ss.ConfigError, match="did you mean 'small'"):
        preset("smal")
