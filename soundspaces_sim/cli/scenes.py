"""`inspect`: what a scene is like, before it is simulated."""

from __future__ import annotations

import logging
from typing import Annotated

import typer

from soundspaces_sim.cli.options import Read, takes_scene


@takes_scene
def inspect(
    _scene: str,
    read: Read,
    spacing: Annotated[float, typer.Option(help="Grid spacing, m.")] = 0.5,
) -> None:
    """Report geometry, materials and expected reverberation of a scene, with warnings."""
    from soundspaces_sim.base.config import GridConfig
    from soundspaces_sim.places.survey import inspect_scene, report_text

    logging.getLogger("soundspaces_sim").setLevel(logging.WARNING)  # the report has the notes
    loaded = read()
    print(report_text(inspect_scene(loaded, GridConfig(spacing=spacing))))
