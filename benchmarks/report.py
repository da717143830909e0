"""Write benchmarks/RESULTS.md from the stored runs alone: ``python -m benchmarks.report``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.tools.record import RESULTS, ROOT, Cell, Result, Table, stored

PAGE = ROOT / "benchmarks" / "RESULTS.md"
_MOST_ROWS = 15  # of a table on the page
#: Words in the titles of a run's tables that are on the page; of other runs it is the first table.
_CHOSEN = {"speed.alternatives": "as labelled; 36 pairs, all"}
_BAND = "775 to 3409"  # Hz, of long tables by band: the middle one of speech
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
    rows = table.rows
    if len(rows) > _MOST_ROWS:
        rows = tuple(row for row in rows if row[0] == _BAND)[:_MOST_ROWS] or rows[:_MOST_ROWS]
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
    chosen = _CHOSEN.get(result.name)
    shown = [t for t in result.tables if chosen in t.title] if chosen else result.tables[:1]
    tables = "\n\n".join(_table(t) for t in shown)
    left = len(result.tables) - len(shown)
    more = f", with {left} more table{'s' * (left > 1)}" if left else ""
    stored_run = f"[Stored run](results/{result.name}.json){more}"
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
