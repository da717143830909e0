"""`soundspaces-explorer DATASET`: see and hear datasets in the browser."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from soundspaces_explorer import ExplorerServer, export_explorer
from soundspaces_sim import open_dataset
from soundspaces_sim.parts import (
    HrtfOption,
    Meter,
    ReplaceOption,
    open_found,
    output_folder,
    run_app,
    size_text,
)

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def explore(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset, or of several.")],
    port: Annotated[
        int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.", min=0, max=65535)
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
    export_to: Annotated[
        Path | None,
        typer.Option("--export", help="Write a copy that opens from disk to this folder instead."),
    ] = None,
    points: Annotated[int, typer.Option(help="--export: how many of the points.")] = 12,
    rate: Annotated[int | None, typer.Option(help="Sampling rate, Hz; --export: 16000.")] = None,
    hrtf: HrtfOption = None,
    replace: ReplaceOption = False,
) -> None:
    """See and hear datasets in the browser: served on this machine alone, until Ctrl-C."""
    if export_to is not None:
        output_folder(export_to, replace, "--export")
        with open_dataset(dataset, rate or 16000, hrtf) as ds, Meter("Exporting") as meter:
            size = export_explorer(ds, export_to, points, meter.update)
        print(f"Wrote {size_text(size)} to {export_to}: open {export_to / 'index.html'}")
        return
    with ExplorerServer(open_found(dataset, rate, hrtf), port) as server:
        print(f"{server.url}\nCtrl-C ends it.", flush=True)
        if browser:
            webbrowser.open(server.url)
        with suppress(KeyboardInterrupt):
            server.serve_forever()


def main() -> None:
    """Entry point."""
    run_app(app)


if __name__ == "__main__":
    main()
