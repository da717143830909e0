"""Every file that is read, damaged at random: our errors only, in bounded time and memory, and nothing unseen."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.attack.harness import report, run
from tests.attack.victims import make_victims, make_whole
from tests.marks import ci_slow


def _attack(folder: Path, tries: int, seed: int) -> None:
    make_whole(folder)
    (folder / "names").mkdir()
    names = list(make_victims(folder / "names", folder))
    found, lines = run(folder, dict.fromkeys(names, tries), seed)
    print(report(found))
    for name, outcomes in found.items():
        assert outcomes["foreign"] == outcomes["slow"] == outcomes["silent"] == 0, (name, lines[:20])
        assert sum(outcomes.values()) == tries
    # Both ends are reached: some damages are found, some do not matter.
    assert all(outcomes["own"] > 0 for outcomes in found.values())
    assert sum(outcomes["same"] + outcomes["other"] for outcomes in found.values()) > 0


@ci_slow
def test_a_few_damages_of_every_file(tmp_path: Path) -> None:
    _attack(tmp_path, 10, seed=1)


@pytest.mark.slow
def test_a_hundred_thousand_damages(tmp_path: Path) -> None:
    _attack(tmp_path, 2860, seed=2)
