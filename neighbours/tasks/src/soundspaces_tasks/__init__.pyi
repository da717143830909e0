"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .results import Row, Score, TaskResult, interval
from .run import run_tasks, score_tasks, write_page
from .setting import Setting, open_setting

__all__ = [
    "Row",
    "Score",
    "Setting",
    "TaskResult",
    "interval",
    "open_setting",
    "run_tasks",
    "score_tasks",
    "write_page",
]
