"""The page of a run: a section and a table per task, in Markdown."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from soundspaces_sim import __version__
from soundspaces_sim.parts import Interval
from soundspaces_tasks.results import TaskResult
from soundspaces_tasks.setting import Setting

_INTERVALS = """\
Scores are means over the pairs of the test homes, in brackets 95 % intervals of a bootstrap that draws test homes
and seeds (`soundspaces_tasks/results.py`). A seed draws the training homes, where not all are used, and the
start and order of training. Networks are kept as they were best in the homes of the split val. Intervals are wide
where test homes are few, of a single one there is none, and they reach below 0 for errors that cannot.

Speech is synthetic (`soundspaces_tasks/speech.py`): syllables by a source and formants, with random rhythm,
pitch, level and pauses. Scores say how methods compare on these homes. They are not those of recorded speech in
real homes."""


def page(setting: Setting, results: Mapping[str, TaskResult], command: str) -> str:
    """All sections."""
    counts = ", ".join(f"{len(setting.splits[s])} in {s}" for s in ("train", "val", "test"))
    runs = "one seed" if setting.seeds == 1 else f"{setting.seeds} seeds"
    total = sum(result.seconds for result in results.values())
    data = f"{len(setting.names)} homes ({counts}; {setting.about})"
    asked = f"{setting.pairs} pairs of each, {runs}, {setting.updates:,} updates of a network"
    made = f"Made by `{command}` (version {__version__}) on {data}, {asked}; {_minutes(total)} in all."
    head = f"# Tasks\n\n{made}\n\n{_INTERVALS}\n"
    return "\n".join([head, *(_section(name, result) for name, result in results.items())])


def _section(name: str, result: TaskResult) -> str:
    heads = ["Method", "Training homes", *(s.name + (" ↑" if s.higher else " ↓") for s in result.scores)]
    lines = [f"| {' | '.join(heads)} |", "|" + " --- |" * len(heads)]
    for row in result.rows:
        cells = [
            "" if value is None else _text(value, score.digits)
            for value, score in zip(row.scores, result.scores, strict=True)
        ]
        lines.append(f"| {' | '.join([row.method, str(row.homes or ''), *cells])} |")
    facts = "\n\n".join([*result.facts, f"{_minutes(result.seconds)}."])
    table = "\n".join(lines)
    return f"## {result.title}\n\n`--task {name}`. {result.about}\n\n{table}\n\n{facts}\n"


def _text(value: Interval, digits: int) -> str:
    if not np.isfinite(value.low):
        return f"{value.mean:.{digits}f}"
    return f"{value.mean:.{digits}f} [{value.low:.{digits}f}, {value.high:.{digits}f}]"


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.1f} minutes"
