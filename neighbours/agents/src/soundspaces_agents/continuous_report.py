"""What a study of agents in continuous space has found, as Markdown."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from itertools import product
from pathlib import Path

from soundspaces_agents.continuous_study import EARS, SETS, ContinuousStudy, Log
from soundspaces_agents.learn.run_files import read_curve
from soundspaces_agents.pictures.provenance import datasets_row
from soundspaces_sim.nav import Result
from soundspaces_sim.parts import publish_file as publish

_MEASURES = ("success", "spl", "success_when_silent")
_HEARD, _UNHEARD, _SILENT = SETS
_WITH, _WITHOUT = (f"trained, {ears}" for ears in EARS)
_BETWEEN = (
    (_WITH, _HEARD, "ear follower", _HEARD),
    (_WITH, _HEARD, _WITH, _UNHEARD),
    (_WITH, _HEARD, _WITH, _SILENT),
    *((_WITH, which, _WITHOUT, which) for which in SETS),
)


def run_continuous_study(data: Path, out: Path, seeds: int, episodes: int, log: Log) -> Path:
    """Train, test and report; goes on where it was stopped. The report's path."""
    study = ContinuousStudy(data, out, seeds, episodes)
    study.train(log)
    return write_study_report(study, study.evaluate(log))


def write_study_report(study: ContinuousStudy, results: Mapping[str, Result]) -> Path:
    """`report.md` in the study's folder; the path."""
    lines = [*_agents(results), *_comparisons(results), *_runs(study), *_data(study)]
    path = study.out / "report.md"
    publish(path, ("\n".join(lines) + "\n").encode())
    return path


def _agents(results: Mapping[str, Result]) -> list[str]:
    lines = [
        "| agent | sounds | success | SPL | by seed | success when silent | actions |",
        "|" + "---|" * 7,
    ]
    for name, result in results.items():
        agent, which = name.split(": ")
        s = result.summary()
        seeds = ", ".join(f"{mean:.3f}" for mean in result.by_seed())
        cells = [agent, which, str(s["success"]), str(s["spl"]), seeds, str(s["success_when_silent"])]
        lines.append(f"| {' | '.join(cells)} | {result.rows['na'].mean():.0f} |")
    return [*lines, ""]


def _comparisons(results: Mapping[str, Result]) -> list[str]:
    """Paired differences, episode by episode; the last column holds for all of them together."""
    count = len(_BETWEEN) * 2
    lines = ["| | less | measure | difference | corrected |", "|" + "---|" * 5]
    for (agent, which, other, against), measure in product(_BETWEEN, _MEASURES[:2]):
        found = results[f"{agent}: {which}"].compare(results[f"{other}: {against}"], measure)
        corrected = found.among(count)
        bounds = f"[{corrected.low:.3f}, {corrected.high:.3f}]"
        lines.append(f"| {agent}: {which} | {other}: {against} | {measure} | {found} | {bounds} |")
    return [*lines, ""]


def _runs(study: ContinuousStudy) -> list[str]:
    lines = ["| run | steps | of them the oracle's | processor s |", "|---|---|---|---|"]
    for seed, ears in product(range(study.seeds), EARS):
        rows = read_curve(study.run_folder(ears, seed))
        led = sum(row["steps"] for row in rows[: study.dagger.led])
        seconds = sum(row["walking_s"] + row["learning_s"] for row in rows)
        steps = sum(row["steps"] for row in rows)
        lines.append(f"| {ears}, seed {seed} | {steps:,.0f} | {led:,.0f} | {seconds:.0f} |")
    return [*lines, ""]


def _data(study: ContinuousStudy) -> list[str]:
    sets = study.test_episodes()
    digest = hashlib.sha256(repr(sets).encode()).hexdigest()
    count = sum(len(episodes) for episodes in sets.values())
    head = ["| | | SHA-256 |", "|---|---|---|", datasets_row(study.data)]
    return [*head, f"| test episodes | {count} in {len(sets)} sets | `{digest}` |", ""]
