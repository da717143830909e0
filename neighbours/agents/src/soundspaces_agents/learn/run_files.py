"""What a run keeps in its folder: its agent, and its learning curve, a row of JSON for each update."""

from __future__ import annotations

import json
from pathlib import Path

NAME = "agent.pt"
CURVE = "curve.jsonl"


def read_curve(folder: Path) -> list[dict[str, float]]:
    """Rows of a run's learning curve; of updates that were made twice, the later ones."""
    path = folder / CURVE
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    rows = (
        json.loads(line) for line in lines if line.endswith("\n")
    )  # a last one may have been cut off
    return list({row["update"]: row for row in rows}.values())
