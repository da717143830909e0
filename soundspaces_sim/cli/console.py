"""What commands say on stderr while they run: log lines, for people or as JSON, and a bar of progress."""

from __future__ import annotations

import json
import logging
import resource as process
import sys

from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

DAMAGED, USAGE_ERROR, INTERRUPTED = 1, 2, 130  # exit codes
console = Console(stderr=True)


def set_up_logging(verbose: bool, log_json: bool) -> None:
    """Send log lines to stderr; as JSON they carry the progress, which is else a bar."""
    handler: logging.Handler
    if log_json:
        console.quiet = True
        handler = logging.StreamHandler()
        handler.setFormatter(_JsonLines())
    else:
        handler = RichHandler(console=console, show_path=False, show_time=False)
        handler.addFilter(lambda record: not hasattr(record, "event"))  # the progress bar shows these
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[handler])
    logging.getLogger("soundspaces_sim").setLevel(logging.DEBUG if verbose or log_json else logging.INFO)
    logging.getLogger("trimesh").setLevel(logging.ERROR)
    logging.getLogger("matplotlib").setLevel(logging.WARNING)


class _JsonLines(logging.Formatter):
    """One JSON object per line: time, level, logger, message, and what an event carries."""

    def format(self, record: logging.LogRecord) -> str:
        line = {
            "time": round(record.created, 3),
            "level": record.levelname.lower(),
            "logger": record.name,
        }
        return json.dumps({**line, "message": record.getMessage(), **getattr(record, "event", {})})


def progress_bar() -> Progress:
    """A bar on the terminal, and nothing where stderr is none."""
    return Progress(
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[extra]}"), console=console, disable=not console.is_terminal,
    )  # fmt: skip


def memory_mb() -> float:
    """Largest resident size so far; macOS counts in bytes, Linux in kB."""
    peak = process.getrusage(process.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)
