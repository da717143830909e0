"""Private words that the literature's have replaced do not come back: in code, messages, docs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from soundspaces_sim.core.simulation_config import FORMER_NAMES

ROOT = Path(__file__).resolve().parents[1]
#: What may not be written, and what to write instead.
INSTEAD = {
    r"\bhangs? on\b": "depends on, is a function of, is seeded by",
    r"\bby lot\b": "at random, uniformly",
    r"\bsees? to it\b": "calls, ensures",
    r"\bdo(es)? not mind\b": "is unaffected by",
    r"\bwho (reads?|only|asks?|wants?|gives?|opens?)\b": "the reader, users who …, or the passive",
    r"\bwalking graph\b": "navigation graph",
    r"\b(EarlyPaths|join_paths)\b": "PathTable",
    r"(?<!\.)\bjoin(s|ed|ing)?(_\w+)?\b(?!\()": "connect, connection; concatenate",
    r"(?<!ast\.)\b(shared|specular|short|connected|scattered|\d|\}) walks\b|\bwalks per point\b": "subpaths",
    r"\b(an?|the|synthetic|without|with) lids?\b": "synthetic ceiling",
    r"\bhero\b(?!.wavelength)": "proposal index",
    r"\brims?\b": "edges of a finite reflector",
    r"\bweaken(s|ed)?\b": "attenuate",
    r"\bbends? round\b": "is diffracted",
    r"\bsights\b": "visible wedges",
    r"\bflattened\b": "decay-compensated",
    r"\bpatience\b": "wait_for, timeout",
    r"\b(album|senses)\b": "encoding cache, sensors",
    r"\bspecular_walks\b": "specular subpaths",
}
#: Pages that quote former words: what was tried then, and reports of runs of then.
_OF_THEN = ("docs/lab_notes", "docs/navigation/report.md", "CHANGELOG.md")
#: Where former names of settings stand, in quotes: the table of them, and its page.
_FORMER = ("soundspaces_sim/core/simulation_config.py", "docs/settings.md")


def _pages() -> list[Path]:
    found = [
        *(ROOT / "soundspaces_sim").rglob("*.py"),
        *(ROOT / "docs").rglob("*.md"),
        *ROOT.glob("*.md"),
    ]
    names = {path: path.relative_to(ROOT).as_posix() for path in found}
    return [path for path, name in names.items() if not name.startswith(_OF_THEN)]


@pytest.mark.parametrize("word", INSTEAD)
def test_private_words_stay_away(word: str) -> None:
    pattern, found = re.compile(word, re.IGNORECASE), []
    for path in _pages():
        name = path.relative_to(ROOT).as_posix()
        for k, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            former = name in _FORMER and any(re.search(f'[`"]{old}[`"]', line) for old in FORMER_NAMES)
            if pattern.search(line) and not former:
                found.append(f"{name}:{k}: {line.strip()[:100]}")
    assert not found, f"write: {INSTEAD[word]}\n" + "\n".join(found)
