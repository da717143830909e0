"""Studies: sets of episodes, what is compared, what the report says of results, one study from end to end."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.nav.agents import BASELINES
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.evaluate import Result, _dtype
from soundspaces_sim.nav.experiments import (
    ARMS,
    CONDITIONS,
    NOISY,
    PLAIN,
    Condition,
    Trial,
    choose_arms,
    claims,
    trials_of,
)
from soundspaces_sim.nav.generate import make_episodes
from soundspaces_sim.nav.stages import with_sounds
from soundspaces_sim.nav.study import STUDIES, Order, Study, note_order, read_orders, result_path, study
from soundspaces_sim.nav.task import SENSORS


def test_the_same_episodes_with_other_sounds(data: NavData) -> None:
    episodes = make_episodes(data, "test", 60, seed=2)
    names = [f"sound_{k}" for k in range(9)]
    found = with_sounds(episodes, names, 3)
    assert found == with_sounds(episodes, names, 3) and len({e.sound for e in found}) > 3
    at: dict[int, set[str]] = {}
    for before, after in zip(episodes, found, strict=True):
        assert (before.start, before.heading, before.goal) == (after.start, after.heading, after.goal)
        at.setdefault(after.goal, set()).add(after.sound)
    assert max(len(sounds) for sounds in at.values()) <= 3


def test_what_is_compared_exists() -> None:
    for plan in STUDIES.values():
        job = plan.job
        assert (job.dataset.rate, job.grid.spacing, job.simulation.walks) == (
            plan.rate,
            plan.spacing,
            plan.walks,
        )
        assert choose_arms(plan.arms) and not {*plan.splits["train"]} & {*plan.splits["test"]}
    for arm in ARMS.values():
        own = SENSORS[arm.task]
        assert set(arm.sensors) - {"collision", "intensity"} <= set(own), arm.name
    tested = {(t.agent, t.condition) for t in trials_of([(arm, 0) for arm in ARMS.values()])}
    for claim in claims():
        assert {claim.better, claim.worse} <= tested
    with pytest.raises(ss.ConfigError, match=r"'APQ' is not one of.*did you mean 'APG'"):
        choose_arms(["APQ"])
    with pytest.raises(
        ss.ConfigError, match=r"PRESET: expected one of quick, small, paper.*did you mean 'small'"
    ):
        study("smol")


def test_orders_are_put_down_in_turn(tmp_path: Path) -> None:
    first, second = Order("small", ("AG",), 1), Order("small", ("AG", "PG"), 3, 40)
    for order in (first, second, first):
        note_order(order, tmp_path)
    assert read_orders(tmp_path) == [second, first]
    assert (
        second.command == "soundspaces-sim nav run --preset small --seeds 3 --agents AG,PG --updates 40"
    )
    assert [(arm.name, seed) for arm, seed in second.runs][:3] == [("AG", 0), ("PG", 0), ("AG", 1)]
    with pytest.raises(ss.ConfigError, match="holds a study of preset 'small', not 'quick'"):
        note_order(Order("quick", ("AG",)), tmp_path)
    (tmp_path / "study.json").write_text("[3]")
    with pytest.raises(ss.ConfigError, match="not a record of a study"):
        read_orders(tmp_path)


def put(out: Path, agent: str, seed: int, spl: float, condition: Condition = PLAIN) -> None:
    """A result of 40 episodes in four scenes around an SPL."""
    rows = np.zeros(40, _dtype())
    rows["scene"], rows["episode_id"] = [f"s{k % 4}" for k in range(40)], [str(k) for k in range(40)]
    rows["seed"] = seed
    rows["spl"] = rows["success"] = spl + 0.01 * np.sin(np.arange(40) + seed)
    path = result_path(out, Trial(agent, seed, condition))
    path.parent.mkdir(parents=True, exist_ok=True)
    Result(agent, rows).save(path)


def test_a_report_says_which_orderings_hold(tmp_path: Path) -> None:
    """AG 0.6 over EarFollower 0.3 holds, PG 0.7 turns one round, and APG as good as PG is not decided."""
    report = pytest.importorskip(
        "soundspaces_sim.nav.report", reason="the extra `figures` is not installed"
    )
    note_order(Order("small", ("AG", "PG"), 2), tmp_path)
    for seed in (0, 1):
        put(tmp_path, "AG", seed, 0.6)
        put(tmp_path, "PG", seed, 0.7)
        put(tmp_path, "APG", seed, 0.7)
        put(tmp_path, "PG", seed, 0.2, NOISY[0.5])
    put(tmp_path, "EarFollower", 0, 0.3)
    text = report.write_report(tmp_path, print).read_text()
    verdicts = {m[1]: m[2] for m in re.finditer(r"^\| (\S.* > .*?) \|.*\| ([a-z ]+) \|$", text, re.M)}
    assert verdicts == {
        "AG > EarFollower": "holds",
        "AG > PG": "the reverse holds",
        "APG > PG": "not decided",
        "AG > APG": "the reverse holds",
        "PG > PG, σ = 0.5 m": "holds",
        "AG > PG, σ = 0.5 m": "holds",
    }
    assert "| PG | 0.7" in text and "| 2 | 0.6" in text
    assert "soundspaces-sim nav run --preset small --seeds 2 --agents AG,PG" in text


def test_scenes_take_turns(data: NavData) -> None:
    report = pytest.importorskip(
        "soundspaces_sim.nav.report", reason="the extra `figures` is not installed"
    )
    episodes = [
        *make_episodes(data, "test", 3),
        *make_episodes(data, "train", 2, min_distance=1.0, min_ratio=1.0),
    ]
    found = report.in_turn(episodes)
    assert [e.scene for e in found] == ["tee", "ladder", "tee", "ladder", "tee"]
    assert Counter(map(id, found)) == Counter(map(id, episodes))


@pytest.mark.slow
def test_ears_beat_chance_in_three_flats(tmp_path: Path) -> None:
    """EarFollower's SPL is more than 0.1 above Random's in three furnished flats."""
    from soundspaces_sim.nav.agents import EarFollower, Random
    from soundspaces_sim.nav.env import AudioNavEnv
    from soundspaces_sim.nav.evaluate import evaluate
    from soundspaces_sim.nav.stages import build_flats

    build_flats(Study("three", (3, 0, 0), 64, 0, 0, (), 0), tmp_path, 2, print)
    data = NavData(tmp_path)
    episodes = make_episodes(data, "train", 90, seed=7)
    env = AudioNavEnv(data, sensors=("intensity",), max_steps=200)
    ears, chance = evaluate(EarFollower(), env, episodes), evaluate(Random(), env, episodes)
    assert ears.compare(chance).mean > 0.1


@pytest.mark.slow
def test_a_study_is_stopped_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped once in every stage; finished parts are not made again, and the end is that of one run."""
    pytest.importorskip("torch", reason="the extra `train` is not installed")
    from soundspaces_sim.nav import stages
    from soundspaces_sim.nav.stages import run_study

    tiny = Study("quick", (1, 1, 1), 32, 60, 6, ("AG-dagger", "AG-varied-dagger"), 1)
    monkeypatch.setitem(STUDIES, "quick", tiny)

    said: list[str] = []

    def stop_at(word: str) -> None:
        def say(line: str) -> None:
            said.append(line)
            if word and line.startswith(word):
                raise InterruptedError

        run_study("quick", tmp_path, 1, 1, None, 1, say)

    for word in ("dataset 2", "episodes", "views", "trained", "tested"):
        with pytest.raises(InterruptedError):
            stop_at(word)
    stop_at("")
    assert sum(line.startswith("dataset") for line in said) == 4  # the second of three was begun twice
    assert sum(line.startswith("tested AG-dagger") for line in said) == 1
    made = {
        p: p.stat().st_mtime_ns for p in tmp_path.rglob("*") if p.suffix in (".h5", ".gz", ".pt", ".gif")
    }
    assert {p.suffix for p in made} == {".h5", ".gz", ".pt", ".gif"}
    report = (tmp_path / "report.md").read_text()
    stop_at("")
    assert {p: p.stat().st_mtime_ns for p in made} == made and (
        tmp_path / "report.md"
    ).read_text() == report
    for test in trials_of(Order("quick", tiny.arms).runs):
        assert result_path(tmp_path, test).exists() and test.condition.name in CONDITIONS
    assert set(BASELINES) <= {p.name for p in (tmp_path / "results").iterdir()} and stages.GOALS == 20
