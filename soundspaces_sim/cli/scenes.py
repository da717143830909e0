"""`inspect`: what a scene is like, before it is simulated."""

from __future__ import annotations

import logging
import sys
from typing import Annotated

import typer

import soundspaces_sim as ss
from soundspaces_sim.cli.console import DAMAGED, Meter
from soundspaces_sim.cli.options import Read, takes_scene


@takes_scene
def inspect(
    scene: str,
    read: Read,
    spacing: Annotated[float, typer.Option(help="Grid spacing, m.")] = 0.5,
) -> None:
    """Report geometry, materials and expected reverberation of a scene, with warnings."""
    from soundspaces_sim.build.inspect import report_text

    config = ss.GridConfig(spacing=spacing)
    logging.getLogger("soundspaces_sim").setLevel(logging.WARNING)  # the report has the notes
    with Meter("Inspecting") as meter:
        meter.stage(f"Loading {scene}")
        report = ss.inspect_scene(read(), config, meter.stage)
    print(report_text(report))
    if report.points == 0:
        print(f"{report.name}: `rirs` has nothing to do here: no grid point survives", file=sys.stderr)
        raise typer.Exit(DAMAGED)
