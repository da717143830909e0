"""A toy engine: tiles run in processes that know nothing but the folder and a tile's number."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from soundspaces_sim.build.engines import Engine, Options, Task, Watch

_RUN = """
import json, sys
from soundspaces_sim.build.job_file import open_job
from soundspaces_sim.build.tile import build_tiles
folder, *numbers = sys.argv[1:]
print(json.dumps([build_tiles(open_job(folder), [int(k)])[int(k)] for k in numbers]))
"""


def run(tasks: Sequence[Task], _options: Options, _cores: int, watch: Watch) -> None:
    """Two processes at once share the tiles, last first; both make the first tile."""
    root = Path(__file__).resolve().parents[2]
    backwards = list(reversed(tasks))
    shares = (backwards[::2], [*backwards[1::2], tasks[0]])
    children = [
        subprocess.Popen(
            [sys.executable, "-c", _RUN, str(tasks[0].folder), *(str(t.number) for t in share)],
            cwd=root, stdout=subprocess.PIPE,
        )
        for share in shares
    ]  # fmt: skip
    made = dict.fromkeys(tasks, 0)
    for child, share in zip(children, shares, strict=True):
        out, _ = child.communicate(timeout=300)
        assert child.returncode == 0
        for task, count in zip(share, json.loads(out), strict=True):
            made[task] += count
    for task, count in made.items():
        watch.done(task, count)


ENGINE = Engine(Options, run)
