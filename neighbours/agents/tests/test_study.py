"""Studies: sets of episodes, what is compared, what the report says of results, one study from end to end."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from soundspaces_agents.experiments import (
    ACOUSTICS,
    CONDITIONS,
    IN,
    NOISY,
    PLAIN,
    VARIANTS,
    Condition,
    Trial,
    choose_variants,
    claims,
    heard_in,
    trials_of,
)
from soundspaces_agents.pictures.provenance import data_lines
from soundspaces_agents.pipeline import with_sounds
from soundspaces_agents.study import (
    STUDIES,
    RunSpec,
    Study,
    data_folder,
    episodes_path,
    read_specs,
    record_spec,
    result_path,
    study,
)

import soundspaces_sim as ss
from soundspaces_sim.dataset.format.splits import write_splits
from soundspaces_sim.nav.agents import BASELINES
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episodes import write_episodes
from soundspaces_sim.nav.evaluate import Result, _dtype
from soundspaces_sim.nav.generate import make_episodes
from soundspaces_sim.nav.task import SENSORS
from tests.marks import ci_slow
from tests.nav.conftest import lattice_dataset


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
        parts = plan.parted([f"home-{k}" for k in range(sum(plan.homes))])
        assert choose_variants(plan.variants) and not {*parts["train"]} & {*parts["test"]}
        assert [len(parts[split]) for split in ("train", "val", "test")] == list(plan.homes)
    for variant in VARIANTS.values():
        own = SENSORS[variant.task]
        assert set(variant.sensors) - {"collision", "intensity"} <= set(own), variant.name
    tested = {(t.agent, t.condition) for t in trials_of([(variant, 0) for variant in VARIANTS.values()])}
    for walks in (None, 100, 1000):
        for claim in claims(walks):
            assert {claim.better, claim.worse} <= tested
    with pytest.raises(ss.ConfigError, match=r"'APQ' is not one of.*did you mean 'APG'"):
        choose_variants(["APQ"])
    with pytest.raises(
        ss.ConfigError, match=r"PRESET: expected one of quick, small, paper.*did you mean 'small'"
    ):
        study("smol")


def test_small_and_paper_ask_what_sound_must_be_like() -> None:
    """Both train in every acoustics but the one that their own datasets have; `quick` in none, and builds nothing
    for it."""
    others = {"AG-mono", "AG-direct", "AG-paper", "AG-walks-250"}
    assert (
        others | {"AG-walks-1000"} <= {*STUDIES["small"].variants}
        and "AG-walks-100" not in STUDIES["small"].variants
    )
    assert (
        others | {"AG-walks-100"} <= {*STUDIES["paper"].variants}
        and "AG-walks-1000" not in STUDIES["paper"].variants
    )
    assert heard_in(RunSpec("quick", STUDIES["quick"].variants).runs) == {"own": {"train", "test"}}
    for name, finest in (("small", "data-walks-1000"), ("paper", "data")):
        plan, out = STUDIES[name], Path("out")
        assert data_folder(plan, out, ACOUSTICS["walks-1000"]) == out / finest
        assert data_folder(plan, out, ACOUSTICS["direct"]) == out / "data"


def test_who_is_tested_in_which_acoustics() -> None:
    spec = RunSpec("small", ("AG-dagger", "AG-walks-250-dagger", "AG-direct-dagger", "AG-mono-dagger"))
    tested: dict[str, list[str]] = {}
    for trial in trials_of(spec.runs):
        tested.setdefault(trial.agent, []).append(trial.condition.name)
    assert {name: tested[name] for name in spec.variants} == {
        "AG-dagger": ["plain", "in-walks-1000", "in-direct"],
        "AG-walks-250-dagger": ["plain", "in-walks-1000"],
        "AG-direct-dagger": ["plain", "in-direct"],
        "AG-mono-dagger": ["plain"],
    }
    assert heard_in(spec.runs) == {
        "own": {"train", "test"}, "walks-250": {"train"}, "walks-1000": {"test"}, "direct": {"train", "test"},
    }  # fmt: skip
    about = {(c.better, c.worse) for c in claims(100)}
    fine = IN["walks-1000"]
    assert (("AG-walks-1000-dagger", fine), ("AG-dagger", fine)) in about
    assert not any("AG-walks-100" in {a, b} for (a, _), (b, _) in about)


def test_each_run_hears_its_own_acoustics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Datasets, renderers and ears as training and testing get them, of a study of three small worlds."""
    pytest.importorskip("torch", reason="the extra `train` is not installed")
    from soundspaces_agents import learn
    from soundspaces_agents import pipeline as stages
    from soundspaces_agents.study import open_test

    def build(
        plan: Study, folder: Path, _jobs: int, _say: object, names: list[str] | None = None
    ) -> None:
        parts = plan.parted(("a", "b", "c"))
        splits = {split: parts[split] for split in names or parts}
        for (name,) in splits.values():
            lattice_dataset([(0, 0), (1, 0)], folder, name, plan.walks)
        write_splits(folder, splits)

    got: dict[str, tuple[int | None, str | None, str]] = {}

    def train(run: learn.Run, _config: object, data: NavData, *_: object) -> Path:
        walks = data.dataset(data.scenes("train")[0]).manifest.config.simulation.walks
        got[run.name] = (walks, data.renderer, run.ears)
        return tmp_path

    monkeypatch.setattr(stages, "build_homes", build)
    monkeypatch.setattr(learn, "train_agent", train)
    monkeypatch.setattr(stages, "read_curve", lambda _: [{"steps": 1, "seconds": 1, "spl": 0}])
    monkeypatch.setitem(STUDIES, "small", Study("small", (1, 1, 1), 32, 0, 0, (), 0))
    spec = RunSpec(
        "small",
        ("AG-dagger", "AG-mono-dagger", "AG-direct-dagger", "AG-paper-dagger", "AG-walks-100-dagger"),
    )
    build(spec.plan, tmp_path / "data", 1, print)
    stages.build_others(spec, tmp_path, 1, print)
    assert set(NavData(tmp_path / "data-walks-100").splits) == {"train"}
    assert set(NavData(tmp_path / "data-walks-1000").splits) == {"test"}
    stages.train_all(spec, tmp_path, 1, print)
    assert got == {
        "AG-dagger": (32, None, "binaural"), "AG-mono-dagger": (32, None, "mono"),
        "AG-direct-dagger": (32, "direct", "binaural"), "AG-paper-dagger": (32, "paper", "binaural"),
        "AG-walks-100-dagger": (100, None, "binaural"),
    }  # fmt: skip
    data = NavData(tmp_path / "data")
    write_episodes(
        make_episodes(data, "test", 3, min_distance=1.0, min_ratio=1.0), episodes_path(tmp_path, "test")
    )
    monkeypatch.setattr("soundspaces_agents.study.load_agent", lambda path: path)
    for trial in trials_of(spec.runs):
        _, env, episodes = open_test(spec.plan, tmp_path, trial)
        heard = ACOUSTICS[trial.condition.acoustics]
        ds = env.setting.data.dataset(episodes[0].scene)
        assert ds.manifest.config.simulation.walks == (heard.walks or 32)
        assert ds.renderer == (heard.renderer or "default")


def test_orders_are_put_down_in_turn(tmp_path: Path) -> None:
    first, second = RunSpec("small", ("AG",), 1), RunSpec("small", ("AG", "PG"), 3, 40)
    for spec in (first, second, first):
        record_spec(spec, tmp_path)
    assert read_specs(tmp_path) == [second, first]
    assert (
        second.command == "soundspaces-agents run --preset small --seeds 3 --agents AG,PG --updates 40"
    )
    assert [(variant.name, seed) for variant, seed in second.runs][:3] == [
        ("AG", 0),
        ("PG", 0),
        ("AG", 1),
    ]
    fewer = RunSpec("small", ("AG",), homes=(2, 1, 1))
    assert fewer.command.endswith("--agents AG --homes 2,1,1") and fewer.plan.homes == (2, 1, 1)
    with pytest.raises(ss.ConfigError, match=r"holds a study of 24,4,16 homes, not 2,1,1"):
        record_spec(fewer, tmp_path)
    with pytest.raises(ss.ConfigError, match="holds a study of preset 'small', not 'quick'"):
        record_spec(RunSpec("quick", ("AG",)), tmp_path)
    (tmp_path / "study.json").write_text("[3]")
    with pytest.raises(ss.ConfigError, match="not a record of a study"):
        read_specs(tmp_path)


def put(out: Path, agent: str, seed: int, spl: float, condition: Condition = PLAIN) -> None:
    """A result of 40 episodes in four scenes around an SPL."""
    rows = np.zeros(40, _dtype())
    rows["scene"], rows["episode_id"] = [f"s{k % 4}" for k in range(40)], [str(k) for k in range(40)]
    rows["seed"] = seed
    rows["spl"] = rows["success"] = spl + 0.01 * np.sin(np.arange(40) + seed)
    path = result_path(out, Trial(agent, seed, condition))
    path.parent.mkdir(parents=True, exist_ok=True)
    Result(agent, rows).save(path)


@ci_slow
def test_a_report_says_which_orderings_hold(tmp_path: Path) -> None:
    """AG 0.6 over EarFollower 0.3 holds, PG 0.7 turns one round, and APG as good as PG is not decided."""
    report = pytest.importorskip(
        "soundspaces_agents.pictures.report", reason="the extra `figures` is not installed"
    )
    record_spec(RunSpec("small", ("AG", "PG"), 2), tmp_path)
    for seed in (0, 1):
        put(tmp_path, "AG", seed, 0.6)
        put(tmp_path, "PG", seed, 0.7)
        put(tmp_path, "APG", seed, 0.7)
        put(tmp_path, "PG", seed, 0.2, NOISY[0.5])
        put(tmp_path, "AG-walks-1000", seed, 0.8, IN["walks-1000"])
        put(tmp_path, "AG", seed, 0.65, IN["walks-1000"])
    put(tmp_path, "EarFollower", 0, 0.3)
    text = report.write_report(tmp_path, print, "On a quiet machine.").read_text()
    shutil.copy(tmp_path / "record.json.gz", tmp_path / "alone.json.gz")
    (tmp_path / "else").mkdir()
    shutil.move(tmp_path / "alone.json.gz", tmp_path / "else" / "record.json.gz")
    assert report.write_page(tmp_path / "else" / "record.json.gz", print).read_text() == text
    verdicts = {m[1]: m[2] for m in re.finditer(r"^\| (\S.* > .*?) \|.*\| ([a-z ]+) \|$", text, re.M)}
    assert verdicts == {
        "AG > EarFollower": "holds",
        "AG > PG": "the reverse holds",
        "APG > PG": "not decided",
        "AG > APG": "the reverse holds",
        "PG > PG, σ = 0.5 m": "holds",
        "AG > PG, σ = 0.5 m": "holds",
        "AG-walks-1000, in walks-1000 > AG, in walks-1000": "holds",
    }
    order = [m[1] for m in re.finditer(r"^\| \S.* > .*?\|.*\| ([a-z ]+) \|$", text, re.M)]
    assert order == ["holds"] * 4 + ["the reverse holds"] * 2 + ["not decided"]
    assert "holds: 4, the reverse holds: 2, not decided: 1." in text and "On a quiet machine." in text
    assert "not there" not in text and "**Asked for" not in text
    assert "1,000 walks a point teach more than 100" in text
    assert re.search(r"\| AG \| the study's datasets \| 0\.6\S* \[.*\] \| 0\.65", text)
    assert "| PG | 0.7" in text and re.search(
        r"\| AG \| AudioGoal \| 0\.6\S* \[.*?\] \| 0\.6\d\d, 0\.6\d\d \|", text
    )
    assert "for all 7 of them together (Bonferroni)" in text
    assert "soundspaces-agents run --preset small --seeds 2 --agents AG,PG" in text


def test_the_committed_page_is_made_of_its_record(tmp_path: Path) -> None:
    """One command makes the page of the episodes beside it, without datasets."""
    pytest.importorskip("torch", reason="the extra `train` is not installed")
    from soundspaces_agents.pictures import report

    pages = Path(__file__).parents[1] / "pages"
    for path in (pages / "record.json.gz", *pages.glob("*.png"), *pages.glob("*.gif")):
        shutil.copy(path, tmp_path)
    made = report.write_page(tmp_path / "record.json.gz", print)
    assert made.read_text() == (pages / "report.md").read_text()


def test_a_report_names_what_it_is_of(tmp_path: Path, data: NavData) -> None:
    """Digests of datasets and episodes, by hand; other episodes have another, the same ones written again have not."""
    assert data_lines(tmp_path) == []
    keys = ""
    for scene in sorted({scene for names in data.splits.values() for scene in names}):
        (tmp_path / "data" / scene).mkdir(parents=True)
        shutil.copy(data.root / scene / "manifest.json", tmp_path / "data" / scene)
        keys += f"{scene} {json.loads((data.root / scene / 'manifest.json').read_text())['key']}\n"
    path = episodes_path(tmp_path, "train")

    def digest(seed: int) -> str:
        write_episodes(make_episodes(data, "train", 4, min_distance=1.0, min_ratio=1.0, seed=seed), path)
        return data_lines(tmp_path)[-2].split("`")[-2]

    first = digest(0)
    assert hashlib.sha256(keys.encode()).hexdigest() in data_lines(tmp_path)[4]
    assert digest(1) != first and digest(0) == first


def test_scenes_take_turns(data: NavData) -> None:
    episodes = [
        *make_episodes(data, "test", 3),
        *make_episodes(data, "train", 2, min_distance=1.0, min_ratio=1.0),
    ]
    from soundspaces_agents.pictures.order import in_turn

    found = in_turn(episodes)
    assert [e.scene for e in found] == ["tee", "ladder", "tee", "ladder", "tee"]
    assert Counter(map(id, found)) == Counter(map(id, episodes))


@pytest.mark.slow
def test_ears_beat_chance_in_three_homes(tmp_path: Path) -> None:
    """EarFollower's SPL is more than 0.1 above Random's in three furnished homes."""
    from soundspaces_agents.pipeline import build_homes

    from soundspaces_sim.nav.agents import EarFollower, Random
    from soundspaces_sim.nav.env import AudioNavEnv
    from soundspaces_sim.nav.evaluate import evaluate

    build_homes(Study("three", (3, 0, 0), 64, 0, 0, (), 0), tmp_path / "data", 2, print, ["train"])
    data = NavData(tmp_path / "data")
    episodes = make_episodes(data, "train", 90, seed=7)
    env = AudioNavEnv(data, sensors=("intensity",), max_steps=200)
    ears, chance = evaluate(EarFollower(), env, episodes), evaluate(Random(), env, episodes)
    assert ears.compare(chance).low > 0.1


@pytest.mark.slow
def test_a_study_is_stopped_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped once in every stage; finished parts are not made again, and the end is that of one run."""
    pytest.importorskip("torch", reason="the extra `train` is not installed")
    from soundspaces_agents import pipeline as stages
    from soundspaces_agents.pipeline import run_study

    tiny = Study("quick", (1, 1, 1), 32, 60, 6, ("AG-dagger", "AG-varied-dagger"), 1)
    monkeypatch.setitem(STUDIES, "quick", tiny)

    said: list[str] = []

    def stop_at(word: str) -> None:
        def log(line: str) -> None:
            said.append(line)
            if word and line.startswith(word):
                raise InterruptedError

        run_study("quick", tmp_path, 1, 1, None, 1, log)

    for word in ("dataset 2", "episodes", "views", "trained", "tested"):
        with pytest.raises(InterruptedError):
            stop_at(word)
    stop_at("")
    assert sum(line.startswith("dataset") for line in said) == 4  # the second of three was begun twice
    assert sum(line.startswith("tested AG-dagger") for line in said) == 1
    record = tmp_path / "record.json.gz"  # is written anew, with the report
    made = {
        p: p.stat().st_mtime_ns
        for p in tmp_path.rglob("*")
        if p.suffix in (".h5", ".gz", ".pt", ".gif") and p != record
    }
    assert {p.suffix for p in made} == {".h5", ".gz", ".pt", ".gif"}
    report, content = (tmp_path / "report.md").read_text(), record.read_bytes()
    stop_at("")
    assert record.read_bytes() == content
    assert {p: p.stat().st_mtime_ns for p in made} == made and (
        tmp_path / "report.md"
    ).read_text() == report
    for test in trials_of(RunSpec("quick", tiny.variants).runs):
        assert result_path(tmp_path, test).exists() and test.condition.name in CONDITIONS
    assert set(BASELINES) <= {p.name for p in (tmp_path / "results").iterdir()} and stages.GOALS == 20
