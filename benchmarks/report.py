"""Write benchmarks/RESULTS.md from the stored runs alone: ``python -m benchmarks.report``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.tools.record import RESULTS, ROOT, Cell, Result, Table, stored

PAGE = ROOT / "benchmarks" / "RESULTS.md"
_MOST_ROWS = 12  # of a table that is shown as a whole
_SHOWN = 4  # of a longer one
TITLES = {"speed": "Speed", "accuracy": "Accuracy", "experiments": "Experiments"}
_HEAD = """# Results

Written by `python -m benchmarks.report` from `benchmarks/results/*.json`; not to be edited. What each benchmark
asks, how it measures and how to read it: [docs/benchmarks.md](../docs/benchmarks.md). Figures of different runs
come from different machines and loads: compare within one table. Each says the commit it is of.
"""


def number(value: Cell) -> str:
    """A cell as text: words as they are, whole numbers with commas, others with at most four figures."""
    if value is None:
        return ""
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        if value != 0.0 and not 1e-4 <= abs(value) < 1e7:
            return f"{value:.3g}"
        return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.4g}"
    return value


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|")


def _table(table: Table) -> str:
    heads = [f"{c.name}, {c.unit}" if c.name and c.unit else c.name or c.unit for c in table.columns]
    rows = table.rows if len(table.rows) <= _MOST_ROWS else table.rows[:_SHOWN]
    lines = [heads, ["---"] * len(heads), *([number(cell) for cell in row] for row in rows)]
    body = "\n".join("| " + " | ".join(_escaped(cell) for cell in line) + " |" for line in lines)
    left = len(table.rows) - len(rows)
    more = f"{left} more rows are in the stored run." if left else ""
    return "\n\n".join(
        part for part in (f"{table.title}:" if table.title else "", body, more, table.note) if part
    )


def _origin(result: Result) -> str:
    machine = result.machine
    cores = f", {machine.cores} cores" if machine.cores else ""
    load = f", load {machine.load:g} at the start" if machine.load is not None else ""
    remark = f" ({machine.remark})" if machine.remark else ""
    parts = [
        f"`{result.command}`",
        f"{result.date}, commit {result.commit}",
        f"{machine.processor}{cores}{load}{remark}",
    ]
    if result.versions:
        parts.append(", ".join(f"{name} {version}" for name, version in sorted(result.versions.items())))
    if result.wall_s is not None and result.processor_s is not None:
        parts.append(f"{result.wall_s:g} s by the clock, {result.processor_s:g} s of the processor")
    return "; ".join(parts) + "."


def section(result: Result) -> str:
    """A stored run as Markdown."""
    tables = "\n\n".join(_table(t) for t in result.tables)
    stored_run = f"[Stored run](results/{result.name}.json)"
    return f"### {result.name}\n\n{result.question} {stored_run}.\n\n{_origin(result)}\n\n{tables}\n"


def page(results: Sequence[Result]) -> str:
    """RESULTS.md of these runs."""
    parts = [_HEAD]
    for package, title in TITLES.items():
        parts.append(f"## {title}\n")
        parts += [section(r) for r in results if r.name.partition(".")[0] == package]
    return "\n".join(parts)


def main(folder: Path = RESULTS, out: Path = PAGE) -> None:
    """Write the page."""
    results = stored(folder)
    out.write_text(page(results), "utf-8")
    print(f"Wrote {len(results)} stored runs to {out}")


if __name__ == "__main__":
    main()
