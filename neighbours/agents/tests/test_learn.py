"""Learning: sizes of networks, the loss against a slow twin, resumption, agents that are kept."""

from __future__ import annotations

import zipfile
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from soundspaces_agents.learn.state_table import StateTable
from soundspaces_agents.learn.walkers import Walkers
from soundspaces_agents.presets import PRESETS, NetConfig, TrainConfig, preset, sources
from soundspaces_agents.trained import load_agent

import soundspaces_sim as ss
from soundspaces_sim.nav.agents import oracle_action
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.env import AudioNavEnv, Setting
from soundspaces_sim.nav.env_options import EnvOptions
from soundspaces_sim.nav.episode_state import EpisodeState
from soundspaces_sim.nav.episodes import write_episodes
from soundspaces_sim.nav.evaluate import evaluate
from soundspaces_sim.nav.generate import make_episodes
from soundspaces_sim.nav.task import POINTGOAL
from soundspaces_sim.nav.vector import AudioNavVectorEnv

torch = pytest.importorskip("torch", reason="the extra `train` is not installed")

TINY = replace(
    preset("small"), envs=4, steps=16, updates=2, max_steps=20, minibatches=2, epochs=2, finetune=0, warm_batches=0,
    net=NetConfig((4, 4, 4), (5, 3, 3), (2, 2, 1), 16, 16, moves=True, tidy=True, stop_bias=-3.0),
)  # fmt: skip


@pytest.mark.parametrize(("frames", "parameters"), [(26, 4_952_453), (69, 4_346_693)])
def test_the_papers_network_has_its_size(frames: int, parameters: int) -> None:
    from soundspaces_agents.learn.net import Policy

    with torch.device("meta"):  # sizes alone
        policy = Policy({"spectrogram": (65, frames, 2), "depth": (128, 128, 1)}, preset("paper").net)
    assert sum(p.numel() for p in policy.parameters()) == parameters


def test_a_sequence_is_its_steps() -> None:
    from soundspaces_agents.learn.net import MOVES, Policy

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


def _told_ears_apart(loudness: int) -> float:
    """Share of answers LEFT or RIGHT that are right, after 100 updates: one ear is 3 dB louder, at any level of 40 dB,
    and a picture of the scene says nothing."""
    from soundspaces_agents.learn.net import Policy

    torch.manual_seed(0)
    net = replace(preset("small").net, loudness=loudness)
    policy = Policy({"intensity": (2,), "depth": (32, 32, 1)}, net)
    optimizer = torch.optim.Adam(policy.parameters(), preset("small").learning_rate)

    def batch(count: int) -> tuple[Any, Any]:
        level, louder = 10.0 ** (-3.0 + 2.0 * torch.rand(count)), torch.randint(2, (count,))
        ears = level[:, None] * 10.0 ** ((torch.stack([1 - louder, louder], dim=1) - 0.5) * 3.0 / 20.0)
        depth = torch.relu(torch.randn(count, net.features))
        moves = torch.zeros(count, dtype=torch.long)
        return policy.step({"intensity": ears}, moves, policy.start(count), {"depth": depth})[
            0
        ], louder + 2

    for _ in range(100):
        logits, wanted = batch(256)
        optimizer.zero_grad()
        torch.nn.functional.cross_entropy(logits, wanted).backward()
        optimizer.step()
    with torch.no_grad():
        logits, wanted = batch(4000)
    return float((logits[:, 2:].argmax(dim=1) + 2 == wanted).float().mean())


def test_two_numbers_beside_a_picture_need_an_encoder() -> None:
    """The louder ear is known for certain. With the encoder of loudness all answers but a few are right; without it,
    as agents were trained that heard loudness alone, they are no better than chance after as many updates (0.492 of 4,000 was found, 0.5 is chance)."""
    assert _told_ears_apart(preset("small").net.loudness) > 0.99
    assert abs(_told_ears_apart(0) - 0.5) < 0.1


def collector_of(data: NavData, sensors: tuple[str, ...], count: int = 4, **options: Any) -> Any:
    """(collector, policy) of small agents that often stop."""
    from soundspaces_agents.learn.net import Policy
    from soundspaces_agents.learn.rollout import Collector

    torch.manual_seed(1)
    setting = Setting(EnvOptions(data=data, sensors=sensors, max_steps=9, **options))
    policy = Policy(setting.sensor_suite.shapes, replace(TINY.net, stop_bias=0.0))
    return Collector(Walkers(count, StateTable(setting)), policy, 0), policy


@pytest.mark.parametrize("learning", [False, True])
def test_features_are_the_encoders_output(seen_data: NavData, learning: bool) -> None:
    """What a rollout keeps is what the encoder makes of what the environment shows in those states, whether it
    learns or not; replayed, logits are those of the walk, and only an encoder that learns gets gradients."""
    from soundspaces_agents.learn.rollout import sample

    collector, policy = collector_of(seen_data, ("spectrogram", "depth", "collision"), depth_size=32)
    env = AudioNavVectorEnv(
        4,
        seen_data,
        sensors=("spectrogram", "depth", "collision"),
        max_steps=9,
        depth_size=32,
        autoreset_mode="SameStep",
    )
    shown = [env.reset(seed=0)[0]]
    gen, said = torch.Generator().manual_seed(0), []

    def choose(_: Any, logits: Any) -> Any:
        said.append(logits)
        actions = sample(logits, gen)
        shown.append(env.step(actions.numpy())[0])
        return actions, actions

    collector.begin(learning)
    rollout = collector.collect(40, choose)
    for name, encoder in policy.encoders.items():
        whole = torch.stack([torch.from_numpy(seen[name]) for seen in shown[:-1]])
        made = encoder(whole.flatten(0, 1)).reshape(40, 4, -1)
        torch.testing.assert_close(rollout.encoded[name], made.detach(), rtol=1e-5, atol=1e-6)
        distinct = len({p.numpy().tobytes() for p in whole.flatten(0, 1)})
        numbers = collector.encodings[name]._count
        assert distinct <= numbers and (numbers < 120 or not learning)
    agents = torch.tensor([2, 0, 3])
    found = rollout.replay(policy, agents, collector.encodings)
    torch.testing.assert_close(found[0], torch.stack(said)[:, agents])
    (found[0][..., 1].square().mean() + found[1].square().mean()).backward()
    got = [p.grad is not None and bool(p.grad.abs().max() > 1e-9) for p in policy.encoders.parameters()]
    assert any(got) == learning
    if learning:
        whole_seen = {
            n: torch.stack([torch.from_numpy(seen[n])[agents] for seen in shown[:-1]])
            for n in policy.encoders
        }
        slopes = {n: p.grad.clone() for n, p in policy.named_parameters() if p.grad is not None}
        policy.zero_grad()
        logits, values = policy.sequence(
            whole_seen, rollout.moves[:, agents], rollout.starts[:, agents], rollout.hidden[agents]
        )
        (logits[..., 1].square().mean() + values.square().mean()).backward()
        for name, p in policy.named_parameters():
            torch.testing.assert_close(p.grad, slopes[name], rtol=1e-3, atol=1e-6)


def test_memory_is_that_of_each_episode_alone() -> None:
    """PyTorch's own GRU, run over every episode by itself, has the states of the whole with resets, and its
    gradients."""
    from soundspaces_agents.learn.net import run_memory

    torch.manual_seed(0)
    t, n = 23, 5
    gru = torch.nn.GRU(7, 6)
    inputs, begin = torch.randn(t, n, 7, requires_grad=True), torch.randn(n, 6)
    starts = (torch.rand(t, n) < 0.2).float()
    starts[0, 1], starts[0, 2] = 1.0, 0.0
    found = run_memory(gru, inputs, starts, begin)
    expected = torch.zeros(t, n, 6)
    for i in range(n):
        cuts = sorted({0, t, *torch.nonzero(starts[:, i]).flatten().tolist()})
        for a, b in pairwise(cuts):
            first = torch.zeros(1, 6) if starts[a, i] else begin[i][None]
            expected[a:b, i] = gru(inputs[a:b, i], first)[0]
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)
    weight = torch.randn(t, n, 6)
    slopes = [
        torch.autograd.grad((states * weight).sum(), [inputs, *gru.parameters()], retain_graph=True)
        for states in (found, expected)
    ]
    for a, b in zip(*slopes, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


def test_rewards_are_divided_by_the_spread_of_returns() -> None:
    """Against the standard deviation of all discounted returns so far, kept in a list."""
    from soundspaces_agents.learn.rollout import RewardScale

    rng = np.random.default_rng(0)
    scale, running, seen = RewardScale(3, 0.9), np.zeros(3), []
    for _ in range(50):
        rewards, ends = rng.normal(2.0, 3.0, 3), rng.random(3) < 0.2
        running = 0.9 * running + rewards
        seen.extend(running.tolist())
        expected = rewards / np.sqrt(np.var(seen) + 1e-8)
        np.testing.assert_allclose(scale(rewards, ends), expected, rtol=1e-9)
        running[ends] = 0.0


def test_encoders_learn_where_the_goal_is(data: NavData) -> None:
    """A warm start's loss falls, and its encoder's features tell the direction better than those it began with: by
    least squares on the states of one source, told on those of another."""
    from soundspaces_agents.learn.net import Policy
    from soundspaces_agents.learn.warm_start import warm_start

    setting = Setting(
        EnvOptions(
            data=data,
            sensors=("spectrogram",),
            episodes=make_episodes(data, "train", 40, min_distance=1.0, min_ratio=1.0),
        )
    )
    table = StateTable(setting)
    torch.manual_seed(0)
    policy = Policy(setting.sensor_suite.shapes, replace(TINY.net, channels=(8, 8, 8), features=32))
    before = {name: value.clone() for name, value in policy.state_dict().items()}
    few = warm_start(policy, table, replace(TINY, warm_batches=2, warm_batch=64), 0, torch.device("cpu"))
    policy.load_state_dict(before)
    many = warm_start(
        policy, table, replace(TINY, warm_batches=150, warm_batch=64), 0, torch.device("cpu")
    )
    assert many["loss"] < 0.8 * few["loss"] and many["agreement"] > few["agreement"]
    after = policy.state_dict()
    assert all(torch.equal(before[k], after[k]) for k in before if not k.startswith("encoders"))
    assert any(not torch.equal(before[k], after[k]) for k in before if k.startswith("encoders"))


@pytest.mark.parametrize("name", ["AG", "PG", "APG", "AG-intensity", "AG-blind"])
def test_every_kind_of_agent_is_trained(seen_data: NavData, tmp_path: Path, name: str) -> None:
    """With its sensors and all that `small` has, the encoder of loudness and a warm start included, which teaches
    that encoder, too; the agent then acts."""
    from soundspaces_agents import learn
    from soundspaces_agents.experiments import VARIANTS
    from soundspaces_agents.learn import train
    from soundspaces_agents.learn.warm_start import warm_start

    variant = VARIANTS[name]
    run = learn.Run(name, variant.task, variant.sensors)
    net = replace(TINY.net, loudness=8)
    config = replace(TINY, net=net, warm_batches=3, warm_batch=32, finetune=1)
    taught: list[Any] = []

    def watched(policy: Any, *arguments: Any) -> dict[str, float]:
        kept = {k: v.clone() for k, v in policy.state_dict().items()}
        found = warm_start(policy, *arguments)
        after = policy.state_dict()
        taught.extend(k.split(".")[0] for k in kept if not torch.equal(kept[k], after[k]))
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "warm_start", watched)
        path = learn.train_agent(run, config, seen_data.root, tmp_path, 0)
    assert set(taught) == {"encoders"} | ({"loudness"} if "intensity" in variant.sensors else set())
    agent = learn.load_trained(path, "cpu")
    env = AudioNavEnv(
        seen_data, task=variant.task, sensors=variant.sensors, depth_size=TINY.depth_size, max_steps=9
    )
    observation, _ = env.reset(seed=0)
    assert env.state is not None
    agent.reset(env.state, 0)
    assert agent.act(observation) in range(4)


@pytest.mark.parametrize("bootstrap", [False, True])
def test_advantages_are_sums_of_discounted_errors(bootstrap: bool) -> None:
    """A_t = Σ_k (γ λ)^k δ_{t+k} within the episode, written out; the last state of a cut one has a value."""
    from soundspaces_agents.learn.ppo import advantages
    from soundspaces_agents.learn.rollout import Rollout

    gen = torch.Generator().manual_seed(3)
    t, n, gamma, lam = 9, 2, 0.9, 0.8
    rewards, values = torch.rand(t, n, generator=gen), torch.rand(t, n, generator=gen)
    ends, cut, last = torch.zeros(t, n), torch.zeros(t, n), torch.rand(n, generator=gen)
    ends[2, 0] = ends[5, 1] = ends[7, 0] = 1.0
    cut[5, 1] = 0.7
    empty = torch.zeros(t, n)
    rollout = Rollout(
        {}, {}, {}, empty, empty, empty, empty, empty, empty, values, rewards, ends, cut, last
    )
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
    from soundspaces_agents.learn.ppo import ppo_loss

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
    from soundspaces_agents.learn.dagger import Dagger

    collector, policy = collector_of(data, ("intensity", "collision"), 3, split="test")
    learner = Dagger(policy, collector, replace(TINY, updates=100, oracle_share=1.0, warm_batches=0), 0)
    expected = []

    def spy(walkers: Walkers, logits: Any) -> Any:
        graph = data.graph("tee")
        row = []
        for i, episode in enumerate(walkers.episodes):
            state = EpisodeState(graph, episode, walkers.table.setting.task)
            state.pose = int(walkers.pose[i])
            row.append(oracle_action(state))
        expected.append(row)
        return learner._choose(walkers, logits)

    rollout = learner.collector.collect(12, spy)
    assert rollout.labels.tolist() == expected
    assert (rollout.actions == rollout.labels).all()  # at first the oracle acts
    assert collector.episodes > 0 and not collector.recent  # and what it did is not the agent's
    assert float(rollout.ends.sum()) > 0


@pytest.mark.parametrize(
    ("method", "sensors", "drawn"),
    [
        ("ppo", ("spectrogram", "depth", "collision"), False),
        ("ppo", ("intensity", "collision"), True),
        ("dagger", ("spectrogram", "collision"), False),
    ],
)
def test_training_goes_on_to_the_bit(
    seen_data: NavData,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    method: str,
    sensors: tuple[str, ...],
    drawn: bool,
) -> None:
    """Stopped after the second and the fourth of six updates, in the last two of which encoders learn, a run ends
    with the weights, the curve and the random numbers of one that was not stopped."""
    from soundspaces_agents.learn import train
    from soundspaces_agents.learn.checkpoint import read_checkpoint
    from soundspaces_agents.learn.run_files import read_curve

    monkeypatch.setattr(train, "_EVERY", 2)
    run = train.Run("tiny", "AudioGoal", sensors, method)  # type: ignore[arg-type]
    config = replace(TINY, updates=6, finetune=2, warm_batches=3, warm_batch=32)
    path = None
    if not drawn:
        path = write_episodes(
            make_episodes(seen_data, "train", 9, min_distance=1.0, min_ratio=1.0),
            tmp_path / "e" / "train",
        )
    whole = train.train_agent(run, config, seen_data.root, tmp_path / "a", 5, path)

    def stop(row: dict[str, Any]) -> None:
        if row["update"] in (3, 5) and row["update"] not in stopped:
            stopped.append(row["update"])
            raise InterruptedError

    stopped: list[int] = []
    for _ in range(2):
        with pytest.raises(InterruptedError):
            train.train_agent(run, config, seen_data.root, tmp_path / "b", 5, path, stop)
    parts = train.train_agent(run, config, seen_data.root, tmp_path / "b", 5, path, stop)
    one, two = read_checkpoint(whole), read_checkpoint(parts)
    assert stopped == [3, 5]
    assert all(torch.equal(one["weights"][k], two["weights"][k]) for k in one["weights"])
    assert one["learner"]["collector"]["walkers"] == two["learner"]["collector"]["walkers"]
    assert torch.equal(one["learner"]["generator"], two["learner"]["generator"])
    timed = ("seconds", "steps_per_s")
    curves = [
        [{k: v for k, v in row.items() if k not in timed} for row in read_curve(tmp_path / name)]
        for name in ("a", "b")
    ]
    assert curves[0] == curves[1] and [row["update"] for row in curves[0]] == [1, 2, 3, 4, 5, 6]
    stamp = whole.stat().st_mtime_ns
    train.train_agent(run, config, seen_data.root, tmp_path / "a", 5, path)
    assert whole.stat().st_mtime_ns == stamp  # nothing to do
    other = replace(run, sensors=("spectrogram", "intensity"))
    with pytest.raises(ss.ConfigError, match="begun with other sensors"):
        train.train_agent(other, replace(config, updates=7), seen_data.root, tmp_path / "a", 5, path)


def test_devices_and_noise_are_checked(data: NavData, tmp_path: Path) -> None:
    from soundspaces_agents.learn.train import Run, train_agent

    with pytest.raises(ss.ConfigError, match="device: PyTorch has no 'gramophone' here"):
        train_agent(Run("tiny"), TINY, data.root, tmp_path, device="gramophone")
    with pytest.raises(ss.ConfigError, match="without noise"):
        StateTable(Setting(EnvOptions(data=data, gps_sigma=0.5)))


def test_every_number_has_a_source() -> None:
    for name in PRESETS:
        config, said = preset(name), sources(name)
        assert set(said) == {f.name for f in fields(config)} and all(said.values()), name
    assert preset("quick").net == preset("small").net and preset("quick").updates == 15


def test_a_kept_agent_walks_and_knows_its_sensors(data: NavData, tmp_path: Path) -> None:
    from soundspaces_agents.learn.train import Run, train_agent

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
    with (
        zipfile.ZipFile(path) as kept,
        zipfile.ZipFile(tmp_path / "bad.pt", "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        for name in kept.namelist():
            packed.writestr(name, kept.read(name))
    with pytest.raises(ss.ConfigError, match=r"bad\.pt: not a checkpoint.*packed"):
        load_agent(tmp_path / "bad.pt")
    content = torch.load(path, weights_only=True)
    for name, value in content["weights"].items():
        content["weights"][name] = torch.zeros(1).expand(value.shape)
    torch.save(content, tmp_path / "bad.pt")
    with pytest.raises(ss.ConfigError, match=r"bad\.pt: .*stand for more numbers than it holds"):
        load_agent(tmp_path / "bad.pt")
    with pytest.raises(ss.ConfigError, match="did you mean 'small'"):
        preset("smal")
