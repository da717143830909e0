"""`python -m soundspaces_pictures plot|listen|report`."""

import typer

from soundspaces_pictures.commands import listen, plot, report
from soundspaces_sim.parts import run_app

if __name__ == "__main__":
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    for command in (plot, listen, report):
        app.command()(command)
    run_app(app)
