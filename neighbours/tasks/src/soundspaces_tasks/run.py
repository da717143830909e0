"""All tasks, or some, on a collection, and their page."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from soundspaces_sim.parts import (
    check_entry_name as check_name,
    find_entry as find,
    make_folder,
    publish_file as publish,
)
from soundspaces_tasks.registry import TASKS
from soundspaces_tasks.report import page
from soundspaces_tasks.results import TaskResult
from soundspaces_tasks.setting import Setting, open_setting

_KIND = "task"


def run_tasks(setting: Setting, tasks: Sequence[str] = ()) -> dict[str, TaskResult]:
    """Results of `tasks` by name, by default of all. The same setting gives the same scores. Raises `ConfigError`,
    `DatasetError`, `MissingExtraError`."""
    for name in tasks:
        check_name(_KIND, TASKS, name)
    found: dict[str, TaskResult] = {}
    for name in dict.fromkeys(tasks or TASKS):
        started = time.monotonic()
        result: TaskResult = find(_KIND, TASKS, name)(setting)
        found[name] = replace(result, seconds=time.monotonic() - started)
    return found


def write_page(setting: Setting, results: dict[str, TaskResult], path: str | Path, command: str) -> Path:
    """Publish the page of the results in Markdown."""
    path = Path(path)
    make_folder(path.parent, "choose another --report")
    publish(path, page(setting, results, command).encode())
    return path


def score_tasks(
    collection: str | Path,
    tasks: Sequence[str] = (),
    *,
    homes: Sequence[int] = (),
    seeds: int = 3,
    pairs: int = 32,
    updates: int = 600,
    jobs: int | None = None,
    report: str | Path | None = None,
    say: Callable[[str], None] = print,
) -> dict[str, TaskResult]:
    """Train and score the baselines of tasks on a collection of homes: results by the task's name.

    `tasks`: names, by default all (README.md). `homes`: numbers of training homes, by default 10, 30, 100, …
    and all. `seeds`: runs of everything that is trained. `pairs`: of a home. `updates`: of a network. `jobs`:
    processes that render. `report`: a Markdown file that is written after every task. `say` is told how far it is.
    Raises `ConfigError`, `DatasetError`, `MissingExtraError`.
    """
    for name in tasks:
        check_name(_KIND, TASKS, name)
    setting = open_setting(collection, homes, seeds, pairs, updates, jobs, say)
    words = ["soundspaces-tasks", str(collection), *(f"--task {name}" for name in tasks)]
    words += [f"--homes {count}" for count in homes]
    words += [f"--seeds {seeds}", f"--pairs {pairs}", f"--updates {updates}"]
    results: dict[str, TaskResult] = {}
    for name in tasks or TASKS:
        results |= run_tasks(setting, [name])
        if report is not None:
            path = write_page(setting, results, report, " ".join(words))
            say(f"Wrote {path}: {', '.join(results)}")
    return results
