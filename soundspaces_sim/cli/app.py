"""All commands together, and what they share: logging, errors, exit codes."""

from __future__ import annotations

from typing import Annotated

import typer

from soundspaces_sim.cli import datasets, jobs, nav, neighbours, simulation
from soundspaces_sim.cli.console import run_app, set_up_logging
from soundspaces_sim.core.version import version_text

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"soundspaces-sim {version_text()}")
        raise typer.Exit


@app.callback()
def main_options(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log details.")] = False,
    log_json: Annotated[
        bool,
        typer.Option(
            "--log-json", help="Log lines as JSON on stderr, with progress: for batch systems."
        ),
    ] = False,
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Build and read room-impulse-response datasets."""
    set_up_logging(verbose, log_json)


for command in (
    simulation.rirs,
    jobs.plan,
    jobs.status,
    jobs.finish,
    jobs.inspect,
    datasets.verify,
    datasets.table,
    datasets.export,
):
    app.command()(command)
for name, (_, text) in neighbours.COMMANDS.items():
    app.command(name, context_settings=neighbours.WITHOUT_OWN_OPTIONS, help=text)(neighbours.hand_over)
app.add_typer(nav.app, name="nav")


def main() -> None:
    """Entry point."""
    run_app(app)
