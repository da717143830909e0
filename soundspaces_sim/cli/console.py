"""What commands say on stderr while they run: log lines, for people or as JSON, and how far they are."""

from __future__ import annotations

import json
import logging
import sys
import time

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from soundspaces_sim.core.errors import SoundSpacesSimError

DAMAGED, USAGE_ERROR, INTERRUPTED = 1, 2, 130  # exit codes
console = Console(stderr=True)

_EVERY_SHARE, _EVERY_S = 0.1, 30.0  # off a terminal: a line so often


def set_up_logging(verbose: bool, log_json: bool) -> None:
    """Send log lines to stderr; as JSON they carry the progress, which is else a bar."""
    handler: logging.Handler
    if log_json:
        console.quiet = True
        handler = logging.StreamHandler()
        handler.setFormatter(_JsonLines())
    else:
        handler = RichHandler(console=console, show_path=False, show_time=False)
        handler.addFilter(lambda record: not hasattr(record, "event"))  # the progress shows these
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


class Meter:
    """How far a command is: a bar on a terminal; else a line every 10 % or 30 s. A context."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[extra]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task(what, total=None, extra="")
        self._started = self._said_at = time.monotonic()
        self._said = 0.0

    def __enter__(self) -> Meter:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def stage(self, what: str) -> None:
        """Name the step that begins, of unknown length."""
        if what != self._what:
            self._what, self._said = what, 0.0
            self._started = self._said_at = time.monotonic()
            self._bar.update(self._task, description=what)
            if not console.is_terminal:
                console.print(f"{what} …", highlight=False)

    def update(self, done: int, total: int, extra: str = "") -> None:
        """`done` of `total` steps, and more to say about it."""
        self._bar.update(self._task, description=self._what, completed=done, total=total, extra=extra)
        if console.is_terminal or total <= 0:
            return
        now, share = time.monotonic(), done / total
        if (
            share - self._said >= _EVERY_SHARE - 1e-9
            or now - self._said_at >= _EVERY_S
            or (done == total and self._said < 1.0)
        ):
            self._said_at, self._said = now, share
            left = (now - self._started) * (1.0 - share) / max(share, 1e-9)
            rest = f", about {duration(left)} left" if done < total else ""
            more = f", {extra}" if extra else ""
            console.print(
                f"{self._what}: {int(100 * share + 1e-9)} %{more}{rest}", highlight=False, soft_wrap=True
            )


def run_app(app: typer.Typer, arguments: list[str] | None = None, name: str | None = None) -> None:
    """Run a command line, by default that of this process: an error of ours is one line on stderr and exit code 2;
    Ctrl-C is exit code 130."""
    try:
        app(arguments, prog_name=name)
    except SoundSpacesSimError as error:
        logging.getLogger(__name__).debug("where it was raised:", exc_info=error)
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        sys.exit(USAGE_ERROR)


def duration(seconds: float) -> str:
    """``8 s``, ``3 min``, ``2.5 h``."""
    if seconds < 100.0:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def size_text(count: float) -> str:
    """Bytes: ``24.1 MB``, ``9.9 GB``."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"
