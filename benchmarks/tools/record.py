"""A stored run of a benchmark: its tables, and where, when and on what code it ran.

Files are `benchmarks/results/NAME.json`. Nothing here imports NumPy: benchmarks set the number of threads
first.
"""

from __future__ import annotations

import os
import platform
import resource
import subprocess
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

import msgspec

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results"
_LIBRARIES = ("numpy", "scipy", "numba", "embreex", "h5py", "torch")

Cell = str | int | float | None


class UnavailableError(Exception):
    """A benchmark cannot run here: what is absent."""


class Column(msgspec.Struct, frozen=True):
    """Head of a column. `unit`: of every number in it, empty for words, counts and ratios."""

    name: str
    unit: str = ""


class Table(msgspec.Struct, frozen=True):
    """Rows under columns; `note` is what a row cannot say: sizes, settings, seeds."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"table {self.title!r}: expected rows of {len(self.columns)} cells, got {row}"
                )
            for cell in row:
                if isinstance(cell, float) and not abs(cell) < float("inf"):
                    raise ValueError(f"table {self.title!r}: expected finite numbers, got {row}")


class Machine(msgspec.Struct, frozen=True):
    """`load`: the load average of the minute before the run; None where none was noted."""

    processor: str
    cores: int | None
    load: float | None
    remark: str = ""


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """A run. Versions and seconds are empty where they were not noted."""

    name: str
    question: str
    command: str
    commit: str
    date: str
    machine: Machine
    tables: tuple[Table, ...]
    versions: dict[str, str] = {}
    wall_s: float | None = None
    processor_s: float | None = None


def table(
    title: str,
    columns: Sequence[Sequence[str]],
    rows: Sequence[Sequence[object]],
    note: str = "",
) -> Table:
    """A table of columns ``"name"`` or ``("name", "unit")``; numbers of NumPy become Python's.

    Raises `ValueError` for rows of another length and for numbers that are not finite (None is an empty cell).
    """
    heads = tuple(Column(c) if isinstance(c, str) else Column(*c) for c in columns)
    return Table(title, heads, tuple(tuple(_cell(c) for c in row) for row in rows), note)


def _cell(value: object) -> Cell:
    if value is None or isinstance(value, str | bool):
        return None if value is None else str(value)
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        # Four figures: more are noise, and make every run a change of every digit of a file.
        return float(f"{value:.4g}")
    raise TypeError(f"expected a word or a number in a table, got {value!r}")


def path_of(name: str, folder: Path = RESULTS) -> Path:
    """The file of a benchmark's stored run."""
    return folder / f"{name}.json"


def save(result: Result, folder: Path = RESULTS) -> Path:
    """Write a run over the one before; returns its path."""
    path = path_of(result.name, folder)
    path.write_bytes(msgspec.json.format(msgspec.json.encode(result), indent=1) + b"\n")
    return path


def load(path: Path) -> Result:
    """Read a stored run. Raises `ValueError` with the path where it is none."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Result, strict=True)
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: expected a stored run of a benchmark, {error}") from error


def stored(folder: Path = RESULTS) -> list[Result]:
    """All stored runs, by name."""
    return [load(path) for path in sorted(folder.glob("*.json"))]


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _commit() -> str:
    """The commit checked out, with a plus where files of the package or of benchmarks differ from it."""

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--", "soundspaces_sim", "benchmarks/*.py")
    return git("rev-parse", "--short=7", "HEAD") + ("+" if changed else "")


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _processor_seconds() -> float:
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usages)


class Watch:
    """Started before a benchmark is imported; makes the record of what it returned."""

    def __init__(self) -> None:
        self._machine = Machine(_processor(), os.cpu_count(), round(os.getloadavg()[0], 1))
        self._wall, self._used = time.perf_counter(), _processor_seconds()
        self._commit = _commit()

    def result(
        self, name: str, question: str, arguments: Sequence[str], tables: Sequence[Table]
    ) -> Result:
        """The record of a run that ended now."""
        command = " ".join(
            [".venv/bin/python -m benchmarks run", name, *(["--", *arguments] if arguments else [])]
        )
        return Result(
            name=name,
            question=question,
            command=command,
            commit=self._commit,
            date=datetime.now(UTC).date().isoformat(),
            machine=self._machine,
            tables=tuple(tables),
            versions=_versions(),
            wall_s=round(time.perf_counter() - self._wall, 1),
            processor_s=round(_processor_seconds() - self._used, 1),
        )
