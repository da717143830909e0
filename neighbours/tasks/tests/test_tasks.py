"""Tasks on a small collection: from its folder to the page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from soundspaces_tasks import (
    Setting,
    TaskResult,
    __main__ as tasks_command,
    fits,
    open_setting,
    run_tasks,
)
from soundspaces_tasks.baselines import gathered
from soundspaces_tasks.registry import NETWORKS, TASKS
from soundspaces_tasks.report import page
from soundspaces_tasks.setting import examples
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.registry import names
from soundspaces_sim.dataset.format.splits import SPLITS, write_splits
from tests.marks import CI_SLOW, ci_slow
from tests.nav.conftest import lattice_dataset

_SPLITS = {"train": ("hall-0", "hall-1", "hall-2"), "val": ("hall-8",), "test": ("hall-9", "hall-19")}


@pytest.fixture(scope="module")
def homes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Corridors of 9 to 12 cells with a bend, by split."""
    root = tmp_path_factory.mktemp("homes")
    for row, name in enumerate(name for split in _SPLITS.values() for name in split):
        cells = [(i, 0) for i in range(4 + row % 3)] + [(0, j) for j in range(1, 5 + row % 2)]
        lattice_dataset(cells, root, name, walks=256)
    write_splits(root, _SPLITS)
    return root


def _setting(root: Path, **options: object) -> Setting:
    small = {"seeds": 2, "pairs": 4, "updates": 2, "jobs": 1, "say": lambda _: None}
    return open_setting(root, **{**small, **options})  # type: ignore[arg-type]


def _same(one: TaskResult, other: TaskResult) -> bool:
    return repr(replace(one, seconds=0.0)) == repr(replace(other, seconds=0.0))


@pytest.mark.parametrize(
    "task", [pytest.param(t, marks=CI_SLOW if t in ("audiogoal", "location") else ()) for t in TASKS]
)
def test_every_task_scores_its_baselines(homes: Path, task: str) -> None:
    """The same twice; without PyTorch the report says what was left out."""
    setting = _setting(homes, homes=(2, 3))
    result = run_tasks(setting, [task])[task]
    scored = [s for row in result.rows for s in row.scores if s is not None]
    assert len(result.rows) >= 3 and np.isfinite([s.mean for s in scored]).all()
    assert all(s.low <= s.mean <= s.high for s in scored)
    assert _same(result, run_tasks(setting, [task])[task])
    text = page(setting, {task: result}, "the command")
    assert f"## {result.title}" in text and "the command" in text and "nan" not in text
    assert text.count("\n| ") == len(result.rows) + 2  # with the heads and the line under them
    if task in NETWORKS:
        networks = {row.homes for row in result.rows if row.method == "network"}
        assert networks == (set() if fits.torch_missing() else {2, 3})
        assert fits.torch_missing() is None or fits.torch_missing() in result.facts


@ci_slow
def test_processes_change_nothing(homes: Path) -> None:
    one, two = (run_tasks(_setting(homes, jobs=n), ["prediction"])["prediction"] for n in (1, 2))
    assert _same(one, two)


def test_without_pytorch_the_page_says_so(homes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fits, "find_spec", lambda _: None)
    setting = _setting(homes)
    result = run_tasks(setting, ["prediction"])["prediction"]
    assert not [row for row in result.rows if row.method == "network"]
    assert "PyTorch is not installed (`pip install" in page(setting, {"prediction": result}, "")


def test_the_command_writes_the_page(homes: Path, tmp_path: Path) -> None:
    out = tmp_path / "docs" / "tasks.md"
    asked = "--task prediction --homes 2 --seeds 1 --pairs 4 --updates 2 --jobs 1".split()
    run = CliRunner().invoke(tasks_command.app, [str(homes), *asked, "--report", str(out)])
    assert run.exit_code == 0, run.output
    text = out.read_text()
    assert "--task prediction --homes 2 --seeds 1 --pairs 4 --updates 2" in text
    assert (
        "6 homes (3 in train, 1 in val, 2 in test; a grid of 1 m, 10 points a home, 256 subpaths a point)"
        in text
    )


def test_homes_of_training_are_drawn_by_seed(homes: Path) -> None:
    setting = _setting(homes, homes=(2,))
    drawn = [tuple(setting.chosen(2, seed)) for seed in range(20)]
    assert drawn == [tuple(setting.chosen(2, seed)) for seed in range(20)] and len(set(drawn)) == 3
    assert {row for rows in drawn for row in rows} == set(setting.rows("train"))
    assert [job.number for job in examples(setting, lambda job: job)] == [0, 1, 2, 8, 9, 19]
    assert _setting(homes).homes == (3,)


def test_homes_without_a_usable_pair_are_left_out(homes: Path) -> None:
    setting = _setting(homes)
    numbers, home = gathered(setting, lambda job: [(job.number,)] * (job.number % 3))
    assert numbers.tolist() == [1, 2, 2, 8, 8, 19] and home.tolist() == [1, 2, 2, 3, 3, 5]
    with pytest.raises(ConfigError, match="no home has a pair that this task can use"):
        gathered(setting, lambda _: [])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"homes": (4,)}, "homes: expected 1 to 3.*got 4"),
        ({"homes": (0,)}, "homes: expected 1 to 3.*got 0"),
        ({"seeds": 0}, "seeds: expected 1 to 100, got 0"),
        ({"pairs": 0}, "pairs"),
        ({"updates": 0}, "updates"),
    ],
)
def test_what_cannot_be_asked_is_refused(homes: Path, options: dict[str, object], message: str) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        _setting(homes, **options)


def test_unknown_tasks_and_folders_without_splits_are_refused(homes: Path, tmp_path: Path) -> None:
    with pytest.raises(ss.ConfigError, match="task: expected reverberation"):
        run_tasks(_setting(homes), ["singing"])
    for name in ("hall-0", "hall-8"):
        (tmp_path / name).symlink_to(homes / name)
    write_splits(tmp_path, {"train": ("hall-0",), "val": ("hall-8",)})
    with pytest.raises(ss.ConfigError, match=rf"{SPLITS}: expected the splits.*none in 'test'"):
        open_setting(tmp_path)


def test_the_help_names_the_tasks() -> None:
    """The command line loads no task to print its help."""
    assert names(TASKS) == tasks_command._NAMES
