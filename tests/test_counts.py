"""What small jobs do, by counts that no other work on the machine changes, does not grow unnoticed."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.counts import JOBS, STORED
from tests.marks import ci_slow

MOST = 1.05  # of what is stored


def excess(found: dict[str, dict[str, int]], stored: dict[str, dict[str, int]]) -> list[str]:
    """What is counted more often than `MOST` allows, or was not stored, or is not counted any more."""
    names = {(job, what) for counts in (found, stored) for job in counts for what in counts[job]}
    told = []
    for job, what in sorted(names):
        now, before = found.get(job, {}).get(what), stored.get(job, {}).get(what)
        if now is None or before is None or not now <= MOST * before:
            told.append(f"{job}: {what}: {now}, stored {before}")
    return told


@ci_slow
def test_counts_of_small_jobs_have_not_grown() -> None:
    """Rays, deposits, products, arrivals, bytes and compiled kernels, within 5 % of tests/counts.json."""
    said = subprocess.run(
        [sys.executable, "-m", "tests.counts"], check=True, capture_output=True, text=True
    ).stdout
    found, stored = json.loads(said), json.loads(STORED.read_text())
    assert set(JOBS) < set(found)
    assert all(found[job]["rays"] > 0 and found[job]["arrivals"] > 0 for job in ("box", "two rooms"))
    assert not excess(found, stored), (
        "if that is meant, keep the new numbers with python -m tests.counts --store, and say why in the commit"
    )


@pytest.mark.parametrize(
    ("now", "told"), [(100, False), (105, False), (106, True), (40, False), (None, True)]
)
def test_what_is_told(now: int | None, told: bool) -> None:
    found = {"job": {} if now is None else {"rays": now}}
    assert bool(excess(found, {"job": {"rays": 100}})) == told
    assert excess({"job": {"rays": 1, "new": 1}}, {"job": {"rays": 1}}) == ["job: new: 1, stored None"]
