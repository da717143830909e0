"""Commands of distributions of their own: `soundspaces-sim` hands over to what an entry point names."""

from __future__ import annotations

from typing import Annotated

import typer

from soundspaces_sim.cli.console import run_app
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.extras import neighbour_hint
from soundspaces_sim.core.registry import installed_by_name

GROUP = "soundspaces_sim.commands"  # of entry points; each is a typer app, by the command's name
#: Folders in neighbours/ and help of every command.
COMMANDS = {
    "collection": (
        "buildings exports rooms parameters renderers pictures collections",
        "Build datasets of many generated buildings: splits, episodes, report.",
    ),
    "rooms": (
        "buildings exports rooms",
        "Simulate many rooms: random ones for speech, or those of a list.",
    ),
    "cite": ("exports", "Print BibTeX of what a dataset rests on: methods, standards, measured sets."),
    "pack": ("exports", "Pack a dataset into one archive with its checksum."),
    "parameters": ("parameters", "Write room-acoustic parameters of pairs, in octaves or thirds."),
    "plot": ("parameters renderers pictures", "Draw a picture of a dataset or a scene."),
    "listen": (
        "parameters renderers pictures",
        "Write sounds at three places and four headings, to listen.",
    ),
    "report": ("parameters renderers pictures", "Write one HTML page on a dataset, or on one receiver."),
    "explore": (
        "parameters renderers explorer",
        "Hear a scene in the browser while it is simulated, or a dataset.",
    ),
}
WITHOUT_OWN_OPTIONS = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "help_option_names": [],  # the neighbour's own help is the one that is asked for
}


def hand_over(
    context: typer.Context,
    _arguments: Annotated[
        list[str] | None, typer.Argument(metavar="…", help="Arguments and options: --help.")
    ] = None,
) -> None:
    """Run the neighbour's command. Raises `ConfigError` if it is not installed."""
    name = context.info_name or ""
    found = installed_by_name(GROUP, name)
    if found is None:
        raise ConfigError(f"{name}: not installed; {neighbour_hint(*COMMANDS[name][0].split())}")
    run_app(found, [*(_arguments or []), *context.args], f"soundspaces-sim {name}")
