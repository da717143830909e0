"""`nav continuous`: the study of agents in continuous space."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from soundspaces_sim.cli.console import INTERRUPTED
from soundspaces_sim.cli.nav import DataArgument, need_extras


def continuous(
    data: DataArgument,
    out: Annotated[Path, typer.Option(help="Folder of the study.")] = Path("out/continuous-study"),
    seeds: Annotated[int, typer.Option(help="Runs of training per kind of ears.", min=1)] = 3,
    episodes: Annotated[int, typer.Option(help="Test episodes per scene.", min=1)] = 12,
) -> None:
    """Train and test agents in continuous space; goes on where it was stopped."""
    need_extras("nav", "train")
    from soundspaces_sim.nav.continuous.study_report import run_continuous_study

    try:
        path = run_continuous_study(data, out, seeds, episodes, lambda line: print(line, flush=True))
    except KeyboardInterrupt:
        print(f"Interrupted: what is finished is safe in {out}; run the same command to go on")
        raise typer.Exit(INTERRUPTED) from None
    print(f"Wrote {path}")
