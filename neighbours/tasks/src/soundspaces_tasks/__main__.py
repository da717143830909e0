"""`soundspaces-tasks COLLECTION`: baselines of what a collection is for, scored again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from soundspaces_sim.parts import run_app
from soundspaces_tasks import score_tasks

_NAMES = "reverberation, location, prediction, dereverberation or audiogoal"  # of `registry`

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def tasks(
    collection: Annotated[Path, typer.Argument(help="Folder that `soundspaces-sim collection` made.")],
    task: Annotated[
        list[str] | None,
        typer.Option(help=f"{_NAMES}; one or several times; default: all."),
    ] = None,
    homes: Annotated[
        list[int] | None,
        typer.Option(help="Training homes; one or several times; default: 10, 30, 100, … and all."),
    ] = None,
    seeds: Annotated[int, typer.Option(help="Runs of everything that is trained.")] = 3,
    pairs: Annotated[int, typer.Option(help="Pairs of a home.")] = 32,
    updates: Annotated[int, typer.Option(help="Updates of a network in training.")] = 600,
    jobs: Annotated[
        int | None, typer.Option(help="Processes that render; default: one per core.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Markdown file to write; default: tasks.md in the folder.")
    ] = None,
) -> None:
    """Train and score the baselines of the tasks on a collection's homes, with intervals."""
    score_tasks(
        collection,
        task or (),
        homes=homes or (),
        seeds=seeds,
        pairs=pairs,
        updates=updates,
        jobs=jobs,
        report=report or collection / "tasks.md",
        say=lambda line: print(line, flush=True),
    )


def main() -> None:
    """Entry point."""
    run_app(app)


if __name__ == "__main__":
    main()
