"""`explore`: hands over to the explorer, a distribution of its own that an entry point names."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Annotated

import typer

from soundspaces_sim.cli.console import run_app
from soundspaces_sim.core.errors import ConfigError

GROUP = "soundspaces_sim.explorer"  # of entry points; each is a typer app
WITHOUT_OWN_OPTIONS = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "help_option_names": [],  # the explorer's own help is the one that is asked for
}


def explore(
    context: typer.Context,
    _subject: Annotated[
        list[str] | None, typer.Argument(metavar="SCENE|DATASET", help="And options: --help.")
    ] = None,
) -> None:
    """Hear a scene in the browser while it is simulated, or a dataset."""
    found = list(entry_points(group=GROUP))
    if not found:
        raise ConfigError(
            "explore: the explorer is not installed; in a clone: .venv/bin/pip install ./neighbours/explorer"
        )
    app = found[0].load()
    run_app(app, [*(_subject or []), *context.args], "soundspaces-sim explore")
