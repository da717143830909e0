"""The environments: Gymnasium's own checks, rewards, seeds, many agents, bad input."""

from __future__ import annotations

import pickle
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import check_env

import soundspaces_sim as ss
from soundspaces_sim.nav.agents import EarFollower, Forward, GoalFollower, Oracle, Random
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.env import AudioNavEnv, register_environments
from soundspaces_sim.nav.episodes import make_episode
from soundspaces_sim.nav.evaluate import evaluate
from soundspaces_sim.nav.generate import make_episodes
from soundspaces_sim.nav.task import POINTGOAL
from soundspaces_sim.nav.vector import AudioNavVectorEnv
from tests.marks import ci_slow, few
from tests.nav.conftest import T_CORRIDOR
from tests.stats import limit

EARS = ("intensity", "spectrogram", "collision")


@pytest.mark.parametrize(
    ("name", "sensors"),
    [
        ("SoundSpaces/AudioGoal-v0", ("spectrogram", "audiogoal", "intensity")),
        ("SoundSpaces/AudioPointGoal-v0", ("spectrogram", POINTGOAL, "collision")),
        ("SoundSpaces/PointGoal-v0", (POINTGOAL, "collision")),
    ],
)
def test_gymnasium_is_content(data: NavData, name: str, sensors: tuple[str, ...]) -> None:
    env = gymnasium.make(name, data=str(data.root), sensors=sensors)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    observation, info = env.reset(seed=1)
    assert set(observation) == set(sensors) and {"spl", "episode_id", "node", "heading"} <= set(info)
    assert env.observation_space.contains(observation)


def test_stable_baselines_is_content(data: NavData) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        # Spectrograms are pictures of float32, which its own networks for pictures would not take.
        warnings.filterwarnings(
            "ignore", "It seems that your observation (space )?spectrogram", UserWarning
        )
        warnings.filterwarnings("ignore", "The minimal resolution for an image", UserWarning)
        checker.check_env(AudioNavEnv(data, sensors=EARS), warn=True)


def test_rewards_sum_to_what_was_gained(data: NavData) -> None:
    """Σ reward = 10 S - 0.01 n + d_0 - d_T for whatever is done."""
    env = AudioNavEnv(data, split="test", sensors=("collision",), max_steps=60)
    rng = np.random.default_rng(0)
    won = 0
    for episode in make_episodes(data, "test", 80, seed=1):
        _, info = env.reset(seed=5, options={"episode": episode})
        total, over, n = 0.0, False, 0
        oracle = rng.random() < 0.3
        walker = Oracle()
        assert env.state is not None
        walker.reset(env.state, 0)
        while not over:
            action = walker.act({}) if oracle else int(rng.choice(4, p=(0.02, 0.5, 0.24, 0.24)))
            _, reward, terminated, truncated, info = env.step(action)
            total, n, over = total + reward, n + 1, terminated or truncated
        won += info["success"]
        expected = 10 * info["success"] - 0.01 * n + episode.distance - info["distance_to_goal"]
        assert total == pytest.approx(expected, abs=1e-9) and info["na"] == n
    assert won > 10


def test_oracle_is_perfect(data: NavData) -> None:
    for split in ("train", "test"):
        rules = {} if split == "test" else {"min_distance": 1.0, "min_ratio": 1.0}
        episodes = make_episodes(data, split, 50, seed=2, **rules)  # type: ignore[arg-type]
        result = evaluate(Oracle(), AudioNavEnv(data, split=split, sensors=("collision",)), episodes)
        for measure in ("spl", "sna", "success", "softspl", "success_1m"):
            assert (result.rows[measure] == 1.0).all(), measure
        assert (result.rows["collisions"] == 0).all() and (result.rows["distance_to_goal"] == 0).all()


def test_random_needs_twelve_moves(two_nodes: NavData) -> None:
    """Two nodes, one edge, facing it: E0 = 1 + 2/3 E1, E1 = 4.5 + E0 for the moves to the goal: 12."""
    graph = two_nodes.graph("pair")
    episodes = [make_episode(graph, str(k), 0, 0, 1, "telephone") for k in range(1000)]
    env = AudioNavEnv(two_nodes, sensors=("collision",), max_steps=10_000)
    rows = evaluate(Random(), env, episodes).rows
    assert (rows["spl"] == 1.0).all()
    moves = rows["na"] - 1.0  # STOP
    z = (moves.mean() - 12.0) / (moves.std(ddof=1) / np.sqrt(len(moves)))
    assert abs(z) < limit(1)


def test_baselines_do_as_they_are_described(data: NavData) -> None:
    tee = data.graph("tee")
    start, goal = T_CORRIDOR.index((0, 3)), T_CORRIDOR.index((3, 1))
    env = AudioNavEnv(data, split="test", sensors=EARS, max_steps=30)

    def actions(agent: Any, heading: int) -> list[int]:
        observation, _ = env.reset(
            seed=0, options={"episode": make_episode(tee, "0", start, heading, goal, "noise_0")}
        )
        agent.reset(env.state, 0)
        taken, over = [], False
        while not over:
            taken.append(agent.act(observation))
            observation, _, terminated, truncated, _ = env.step(taken[-1])
            over = terminated or truncated
        return taken

    assert actions(Forward(), 90)[:3] == [1, 3, 1]  # bump, right, on
    # the goal lies 34 degrees below +X: east is nearest, until it lies below
    assert actions(GoalFollower(), 180) == [
        2,
        2,
        1,
        1,
        3,
        *[1] * 25,
    ]  # stuck in the corner before the stem
    assert Oracle().name == "Oracle" and actions(Oracle(), 0) == [1, 1, 1, 3, 1, 1, 0]


def test_ear_follower_beats_chance(data: NavData) -> None:
    """Corridors are easy: by far more than the 0.1 SPL asked of flats."""
    episodes = make_episodes(data, "test", 60, seed=4, sounds=("noise_0",))
    env = AudioNavEnv(data, split="test", sensors=("intensity",), max_steps=60)
    ears, chance = evaluate(EarFollower(), env, episodes), evaluate(Random(), env, episodes)
    assert ears.compare(chance).low > 0.1


def test_same_seed_same_bytes(data: NavData) -> None:
    def play(seed: int, **settings: Any) -> bytes:
        env = AudioNavEnv(data, sensors=("spectrogram", POINTGOAL), **settings)
        out = [env.reset(seed=seed)[0], *(env.step(a)[0] for a in (1, 2, 1, 3, 1))]
        return b"".join(o[k].tobytes() for o in out for k in sorted(o))

    assert play(3) == play(3) != play(4)
    assert (
        play(3, snr_db=20.0, gps_sigma=1.0)
        == play(3, snr_db=20.0, gps_sigma=1.0)
        != play(3, snr_db=20.0)
    )


def test_audiogoal_does_not_know_the_gps(data: NavData) -> None:
    def play(sigma: float) -> list[Any]:
        env = AudioNavEnv(data, sensors=("spectrogram",), gps_sigma=sigma, snr_db=30.0)
        return [env.reset(seed=1)[0]["spectrogram"], *(env.step(a)[0]["spectrogram"] for a in (1, 2, 1))]

    for a, b in zip(play(0.0), play(1.5), strict=True):
        np.testing.assert_array_equal(a, b)


def test_observations_are_their_own(data: NavData) -> None:
    env = AudioNavEnv(data, sensors=("spectrogram", "intensity"))
    first, _ = env.reset(seed=0)
    kept = {k: v.copy() for k, v in first.items()}
    second = env.step(2)[0]
    for name in kept:
        second[name][:] = -1.0
        np.testing.assert_array_equal(first[name], kept[name])
    np.testing.assert_array_equal(
        env.step(3)[0]["intensity"], kept["intensity"]
    )  # back where it was, unspoilt


@pytest.mark.parametrize("mode", few(["NextStep", "SameStep"], "NextStep"))
def test_many_agents_are_many_of_one(data: NavData, mode: str) -> None:
    settings: dict[str, Any] = {
        "data": str(data.root), "sensors": ("intensity", POINTGOAL), "max_steps": 7, "gps_sigma": 0.3, "snr_db": 10.0
    }  # fmt: skip
    modes: dict[str, Any] = {"autoreset_mode": mode}
    name = "SoundSpaces/AudioPointGoal-v0"
    own = gymnasium.make_vec(name, 3, vectorization_mode="vector_entry_point", **settings, **modes)
    sync = gymnasium.make_vec(name, 3, vectorization_mode="sync", vector_kwargs=modes, **settings)
    assert (
        own.metadata["autoreset_mode"].value == mode
        and own.single_observation_space == sync.single_observation_space
    )
    a: tuple[Any, ...]
    b: tuple[Any, ...]
    a, b = own.reset(seed=11), sync.reset(seed=11)
    rng = np.random.default_rng(0)
    for _ in range(30):
        for name_ in a[0]:
            np.testing.assert_array_equal(a[0][name_], b[0][name_])
        np.testing.assert_array_equal(a[-1]["node"], b[-1]["node"])
        assert list(a[-1]["episode_id"]) == list(b[-1]["episode_id"])
        actions = rng.choice(4, 3, p=(0.1, 0.5, 0.2, 0.2))
        a, b = own.step(actions), sync.step(actions)
        for mine, theirs in zip(a[1:4], b[1:4], strict=True):
            np.testing.assert_array_equal(mine, theirs)
        if mode == "SameStep" and "final_info" in b[-1]:
            for measure in ("spl", "success", "na"):
                mask = b[-1]["_final_info"]
                np.testing.assert_array_equal(
                    a[-1]["final_info"][measure][mask], b[-1]["final_info"][measure][mask]
                )
                for i in np.flatnonzero(mask):
                    np.testing.assert_array_equal(
                        a[-1]["final_obs"][i]["intensity"], b[-1]["final_obs"][i]["intensity"]
                    )
        elif mode == "NextStep" and (a[2] | a[3]).any():
            ended = a[2] | a[3]
            np.testing.assert_array_equal(a[-1]["spl"][ended], b[-1]["spl"][ended])


@ci_slow
def test_processes_see_the_same(data: NavData) -> None:
    settings: dict[str, Any] = {"data": str(data.root), "sensors": ("intensity",)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other = gymnasium.make_vec(
            "SoundSpaces/AudioGoal-v0",
            2,
            vectorization_mode="async",
            vector_kwargs={"context": "spawn"},
            **settings,
        )
    own = AudioNavVectorEnv(2, data, sensors=("intensity",))
    try:
        np.testing.assert_array_equal(
            own.reset(seed=3)[0]["intensity"], other.reset(seed=3)[0]["intensity"]
        )
        for action in (1, 2, 1):
            a, b = own.step(np.full(2, action)), other.step(np.full(2, action))
            np.testing.assert_array_equal(a[0]["intensity"], b[0]["intensity"])
            np.testing.assert_array_equal(a[1], b[1])
    finally:
        other.close()


def test_a_pickle_is_the_settings(data: NavData) -> None:
    env = AudioNavEnv(data, split="test", sensors=("intensity",), max_steps=9)
    env.reset(seed=0)
    again = pickle.loads(pickle.dumps(env))
    assert len(pickle.dumps(env)) < 2000 and again.setting.task == env.setting.task
    np.testing.assert_array_equal(again.reset(seed=4)[0]["intensity"], env.reset(seed=4)[0]["intensity"])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"split": "tran"}, "split 'tran'.*did you mean 'train'"),
        ({"sensors": ("dept",)}, "sensor 'dept'.*did you mean 'depth'"),
        ({"sensors": "depth"}, "expected a list"),
        ({"sounds": "telefone"}, "did you mean 'telephone'"),
        ({"max_steps": 0}, "max_steps"),
        ({"gps_sigma": -1.0}, "gps_sigma"),
        ({"gps_sigma": float("nan")}, "gps_sigma"),
        ({"snr_db": float("inf")}, "snr_db"),
        ({"depth_size": 3}, "depth_size"),
        ({"distance_reward": "km"}, "distance_reward"),
        ({"cache": "tape"}, "cache"),
        ({"task": "SoundGoal"}, "task"),
        ({"render_mode": "human"}, "render_mode"),
        ({"episodes": []}, "at least one"),
    ],
)
def test_bad_settings(data: NavData, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        AudioNavEnv(data, **settings).reset(seed=0)


def test_bad_steps(data: NavData) -> None:
    env = AudioNavEnv(data, sensors=("collision",), max_steps=2)
    with pytest.raises(ResetNeeded):
        env.step(1)
    env.reset(seed=0)
    for bad in (4, -1, 1.5, "left"):
        with pytest.raises(InvalidAction, match="0 STOP"):
            env.step(bad)  # type: ignore[arg-type]
    env.step(0)
    with pytest.raises(ResetNeeded):
        env.step(1)
    with pytest.raises(ss.ConfigError, match="an Episode or a number below 0"):
        env.reset(options={"episode": 3})
    with pytest.raises(ss.ConfigError, match="expected 'episode' alone"):
        env.reset(options={"epsiode": 3})
    vector = AudioNavVectorEnv(2, data, sensors=("collision",))
    with pytest.raises(ResetNeeded):
        vector.step(np.array([1, 1]))
    vector.reset(seed=0)
    for wrong in (np.array([1, 4]), np.array([1.0, 2.0]), np.array([1])):
        with pytest.raises(InvalidAction):
            vector.step(wrong)


def test_intervals_and_differences() -> None:
    """Of one scene and one seed of n rows the interval is that of a mean."""
    from soundspaces_sim.nav.evaluate import Result, _dtype

    rng = np.random.default_rng(0)
    rows = np.zeros(400, _dtype())
    rows["scene"], rows["episode_id"] = "a", np.arange(400).astype(str)
    rows["spl"] = rng.random(400)
    result = Result("x", rows)
    found = result.summary()["spl"]
    half = 1.96 * rows["spl"].std() / 20.0
    assert found.mean == pytest.approx(rows["spl"].mean())
    assert (found.high - found.low) / 2 == pytest.approx(half, rel=0.1)
    other = rows.copy()
    other["spl"] += 0.25
    rng.shuffle(other)
    difference = Result("y", other).compare(result)  # paired: no spread is left
    assert difference.low == pytest.approx(0.25) and difference.high == pytest.approx(0.25)
    with pytest.raises(ss.ConfigError, match="did not walk the same episodes"):
        Result("z", other[1:]).compare(result)
    # scenes are what counts: two that differ leave the mean wide open, by Student's quantile of one degree of
    # freedom, 12.706 (tables), times the standard error of two values 0 and 1
    split = rows.copy()
    split["scene"][200:], split["spl"] = "b", np.repeat([0.0, 1.0], 200)
    wide = Result("w", split).summary()["spl"]
    assert (wide.low, wide.high) == pytest.approx((0.5 - 0.5 * 12.706, 0.5 + 0.5 * 12.706), abs=1e-3)


def test_a_neighbours_environment_is_registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By an entry point of its distribution."""
    folder = tmp_path / "some_world-1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: some-world\nVersion: 1\n")
    (folder / "entry_points.txt").write_text("[soundspaces_sim.environments]\nw = some_world:tell\n")
    (tmp_path / "some_world.py").write_text("told = []\ndef tell() -> None:\n    told.append(1)\n")
    monkeypatch.syspath_prepend(tmp_path)
    register_environments()
    assert sys.modules.pop("some_world").told == [1]
