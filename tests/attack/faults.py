"""Every k-th system call fails once: what is left, what is said, and whether the same command then ends the same.

    LD_PRELOAD=faults.so python -m tests.attack.faults FOLDER STEP SCENARIO ...

prints a line of JSON per scenario: how many calls there are, how many faults were tried, how these ended.
`faults.c` is the preloaded library; every STEP-th call is tried.
"""

from __future__ import annotations

import ctypes
import json
import logging
import shutil
import sys
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import soundspaces_sim as ss
from soundspaces_sim.dataset.exporters.plan import carry_out
from soundspaces_sim.dataset.exporters.wav import plan_wav
from tests.attack.victims import build_whole, make_whole, plan_soundspaces1, read_dataset

Tree = dict[str, bytes]


@dataclass(frozen=True)
class Scenario:
    """`prepare` a folder, then `act` in it; files that are there in the end are those of `act` without faults.

    `judge`: what is wrong with the state that a fault left, or nothing.
    """

    prepare: Callable[[Path], object]
    act: Callable[[Path], object]
    judge: Callable[[Path, Tree, Tree], str]


def tree_of(folder: Path) -> Tree:
    """Contents by name; not of temporary files, which a later run removes."""
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*"))
        if p.is_file() and not p.name.startswith(".")
    }  # fmt: skip


def _no_third(folder: Path, before: Tree, after: Tree) -> str:
    """Every file is as it was, or as it is to be: never half written."""
    for name, content in tree_of(folder).items():
        if content not in (before.get(name), after.get(name)) and not _is_draft(name, content):
            return f"{name} is neither old nor new"
    return ""


def _is_draft(name: str, content: bytes) -> bool:
    """What a job keeps while it is under way."""
    return name.endswith("job.npz") or (
        name.endswith("manifest.json") and b'"status": "building"' in content
    )


def _whole_or_unfinished(folder: Path, before: Tree, after: Tree) -> str:
    """And a dataset opens only if it is whole, or as it was."""
    if tree_of(folder) == before:
        return ""
    try:
        ss.open_dataset(folder / "whole").close()
    except ss.DatasetError as error:
        if not any(words in str(error) for words in ("not finished", "no dataset")):
            return f"unexpected: {error}"
    else:
        problems = ss.verify_dataset(folder / "whole", full=True)[1]
        if problems:
            return f"opens, but {problems[0].file} {problems[0].what}"
    return _no_third(folder, before, after)


def _read_twice(reference: bytes) -> Callable[[Path], object]:
    def act(folder: Path) -> object:
        found = read_dataset(folder / "whole")
        if found != reference:
            raise AssertionError("other data were read")
        return found

    return act


def _verify(folder: Path) -> object:
    problems = ss.verify_dataset(folder / "whole", full=True)[1]
    if problems:
        raise ss.DatasetError(problems[0].what)
    return problems


def _nothing(_: Path) -> None:
    """An empty folder."""


def scenarios(whole: Path) -> dict[str, Scenario]:
    """By name; `whole`: a folder as `make_whole` leaves it."""

    def copy(folder: Path) -> None:
        shutil.copytree(whole / "whole", folder / "whole")

    def without_some(folder: Path) -> None:
        copy(folder)
        for path in sorted((folder / "whole").glob("*.h5"))[:1]:
            path.unlink()

    def export(folder: Path) -> object:
        with ss.open_dataset(whole / "whole") as ds:
            plans = plan_soundspaces1(ds, folder / "v1", headings=(0.0,)), plan_wav(ds, folder / "wav")
            return [carry_out(plan) for plan in plans]

    reading = read_dataset(whole / "whole")
    return {
        "build": Scenario(_nothing, build_whole, _whole_or_unfinished),
        "mend": Scenario(without_some, build_whole, _whole_or_unfinished),
        "export": Scenario(_nothing, export, _no_third),
        "read": Scenario(copy, _read_twice(reading), _no_third),
        "verify": Scenario(copy, _verify, _no_third),
    }


def try_all(faults: ctypes.CDLL, folder: Path, scenario: Scenario, step: int) -> dict[str, object]:
    """Outcomes of a scenario, and what was wrong."""

    def run(name: str, k: int) -> tuple[Path, str]:
        place = folder / name
        place.mkdir(parents=True)
        scenario.prepare(place)
        faults.fault_arm(str(place).encode(), k)
        try:
            scenario.act(place)
            outcome = "whole"
        except ss.SoundSpacesSimError:
            outcome = "own"
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-3:]
            outcome = (
                f"foreign {error!r} at {' '.join(f'{Path(f.filename).name}:{f.lineno}' for f in at)}"
            )
        finally:
            calls = faults.fault_seen()
            faults.fault_arm(b"", 0)
        return place, outcome if k else str(calls)

    (folder / "before").mkdir(parents=True)
    scenario.prepare(folder / "before")
    before = tree_of(folder / "before")
    place, calls = run("none", 0)
    after = tree_of(place)
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    for k in range(1, int(calls) + 1, step):
        place, outcome = run(str(k), k)
        counts[outcome.split()[0]] += 1
        problem = outcome if outcome.startswith("foreign") else scenario.judge(place, before, after)
        if not problem:
            try:
                scenario.act(place)
                problem = "" if tree_of(place) == after else "another result in the end"
            except Exception as error:
                problem = f"again: {error!r}"
        if problem:
            wrong.append(f"call {k}: {problem}")
        shutil.rmtree(place)
    return {"calls": int(calls), "tried": sum(counts.values()), **counts, "wrong": wrong}


def _main(folder: Path, step: int, names: list[str]) -> None:
    logging.disable()
    faults = ctypes.CDLL(None)
    faults.fault_arm.argtypes = [ctypes.c_char_p, ctypes.c_long]
    faults.fault_seen.restype = ctypes.c_long
    make_whole(folder / "reference")
    known = scenarios(folder / "reference")
    for name in names or known:
        print(
            json.dumps({"scenario": name, **try_all(faults, folder / name, known[name], step)}),
            flush=True,
        )


if __name__ == "__main__":
    _main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
