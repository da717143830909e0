"""The command line: `soundspaces-sim rirs SCENE`, what `make rirs` calls."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from soundspaces_sim.errors import SoundSpacesSimError

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)
_console = Console(stderr=True)
_USAGE_ERROR, _INTERRUPTED = 2, 130


@app.callback()
def main_options(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log details.")] = False,
) -> None:
    """Build and read room-impulse-response datasets."""
    logging.basicConfig(
        level=logging.DEBUG if verbose else logging.INFO,
        format="%(message)s",
        handlers=[RichHandler(console=_console, show_path=False, show_time=False)],
    )
    logging.getLogger("numba").setLevel(logging.WARNING)
    logging.getLogger("trimesh").setLevel(logging.ERROR)


@app.command()
def rirs(
    scene: Annotated[str, typer.Argument(help="Built-in name, Replica folder or mesh file.")],
    out: Annotated[Path, typer.Option(help="Folder for datasets.")] = Path("out"),
    spacing: Annotated[float | None, typer.Option(help="Grid spacing, m.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Threads; default: all cores.")] = None,
    rate: Annotated[int | None, typer.Option(help="Sampling rate of the reader, Hz.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the random walks.")] = None,
    materials: Annotated[Path | None, typer.Option(help="TOML file of materials.")] = None,
    labels: Annotated[Path | None, typer.Option(help="TOML file of materials per label.")] = None,
    up: Annotated[str | None, typer.Option(help="Up axis of the file: y or z.")] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of the file: m, cm, mm, in, ft.")] = None,
) -> None:
    """Simulate the room impulse responses between all grid points of a scene."""
    # Kernels load here, not when the help text is asked for.
    from soundspaces_sim.build import build_dataset
    from soundspaces_sim.config import load_config
    from soundspaces_sim.loaders import load_scene
    from soundspaces_sim.resources import resource

    overrides: dict[str, dict[str, Any]] = {"grid": {}, "dataset": {}}
    for stage, name, value in (
        ("grid", "spacing", spacing), ("dataset", "rate", rate), ("dataset", "seed", seed),
    ):  # fmt: skip
        if value is not None:
            overrides[stage][name] = value
    settings = load_config(config or resource("pipelines", "default.toml"), **overrides)
    _console.print(f"Loading {scene}")
    loaded = load_scene(scene, materials=materials, labels=labels, up=up, unit=unit)
    with _progress() as bar:
        task = bar.add_task("Preparing", total=None)

        def report(done: int, total: int) -> None:
            bar.update(task, description="Simulating", completed=done, total=total)

        try:
            result = build_dataset(loaded, out, settings, jobs, report)
        except KeyboardInterrupt:
            bar.stop()
            done = len(list((out / loaded.name).glob("s*.h5")))
            print(
                f"Interrupted: {done} finished shards are safe in {out / loaded.name}; run the same "
                "command to go on",
                file=sys.stderr,
            )
            raise typer.Exit(_INTERRUPTED) from None
    _summary(result)


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn(),
        console=_console, disable=not _console.is_terminal,
    )  # fmt: skip


def _summary(result: Any) -> None:
    manifest = result.manifest
    n = len(manifest.points)
    size = sum(e.bytes for e in manifest.shards)
    if result.built == 0:
        print(f"Nothing to do: {result.folder} is complete.")
    else:
        reused = result.shards - result.built
        kept = f" ({reused} of {result.shards} shards were there)" if reused else ""
        print(f"Wrote {result.folder}{kept}")
    print(
        f"  {n * n:,} room impulse responses between {n} points, {manifest.duration:.1f} s each, "
        f"{size / 1e6:.1f} MB"
    )
    example = (
        f"import soundspaces_sim as ss; ds = ss.open_dataset('{result.folder}'); "
        f"print(ds.binaural(0, {n - 1}, heading_deg=90.0).shape)"
    )
    print(f'Next: {_python()} -c "{example}"')


def _python() -> str:
    """The interpreter as a user would type it from here."""
    path = Path(sys.executable)
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)


def main() -> None:
    """Entry point: an error of ours is one line on stderr and exit code 2; Ctrl-C is exit code 130."""
    try:
        app()
    except SoundSpacesSimError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        sys.exit(_USAGE_ERROR)


if __name__ == "__main__":
    main()
