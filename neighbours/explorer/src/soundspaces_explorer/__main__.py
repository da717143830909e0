"""`soundspaces-explorer SUBJECT`: see and hear a scene, or datasets, in the browser."""

from __future__ import annotations

import threading
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from soundspaces_explorer import ExplorerServer, export_explorer
from soundspaces_sim import ConfigError, open_dataset
from soundspaces_sim.parts import (
    MANIFEST_NAME,
    HrtfOption,
    Meter,
    Read,
    ReplaceOption,
    check_rate,
    compile_ahead,
    open_found,
    output_folder,
    run_app,
    size_text,
    takes_scene,
)

if TYPE_CHECKING:
    from soundspaces_explorer.live_api import LiveSession

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
@takes_scene
def explore(
    scene: str,
    read: Read,
    port: Annotated[
        int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.", min=0, max=65535)
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
    out: Annotated[
        Path, typer.Option(help="Scene: folder for the settings of a dataset, if the page is asked for.")
    ] = Path("out"),
    export_to: Annotated[
        Path | None,
        typer.Option(
            "--export", help="Dataset: write a copy that opens from disk to this folder instead."
        ),
    ] = None,
    points: Annotated[int, typer.Option(help="--export: how many of the points.")] = 12,
    rate: Annotated[int | None, typer.Option(help="Sampling rate, Hz; --export: 16000.")] = None,
    hrtf: HrtfOption = None,
    replace: ReplaceOption = False,
) -> None:
    """See and hear a scene while it is simulated, or datasets: served on this machine alone, until Ctrl-C.

    SCENE may also be the folder of a dataset, or of several.
    """
    folder = Path(scene)
    if not _holds_datasets(folder):
        if export_to is not None:
            raise ConfigError(f"--export: {scene} is a scene; only datasets can be exported")
        _serve(ExplorerServer({}, port, _live(scene, read, out, rate or 44100, hrtf)), browser)
        return
    if export_to is not None:
        output_folder(export_to, replace, "--export")
        with open_dataset(folder, rate or 16000, hrtf) as ds, Meter("Exporting") as meter:
            size = export_explorer(ds, export_to, points, meter.update)
        print(f"Wrote {size_text(size)} to {export_to}: open {export_to / 'index.html'}")
        return
    _serve(ExplorerServer(open_found(folder, rate, hrtf), port), browser)


def _holds_datasets(folder: Path) -> bool:
    return (folder / MANIFEST_NAME).is_file() or any(folder.glob(f"*/{MANIFEST_NAME}"))


def _live(name: str, read: Read, out: Path, rate: int, hrtf: Path | None) -> LiveSession:
    from soundspaces_explorer.job import JobMaker
    from soundspaces_explorer.live import LiveScene
    from soundspaces_explorer.live_api import LiveSession

    check_rate(rate)
    compiling = compile_ahead(soon=True)
    with Meter("Loading the scene"):
        scene = read()
        live = LiveScene(scene, hrtf=hrtf, compiling=compiling)
    options = getattr(read, "keywords", {})
    session = LiveSession(live, JobMaker(scene, name, options, out, live.bands), rate)
    threading.Thread(target=session.warm_up, daemon=True).start()
    return session


def _serve(server: ExplorerServer, browser: bool) -> None:
    with server:
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
