"""The command line: `soundspaces-sim rirs SCENE` is what `make rirs` calls; more in `--help`."""

from __future__ import annotations

import logging
import shlex
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

from soundspaces_sim.errors import SoundSpacesSimError

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)
_console = Console(stderr=True)
_DAMAGED, _USAGE_ERROR, _INTERRUPTED = 1, 2, 130

# What says how a scene is read, wherever one is.
MaterialsOption = Annotated[Path | None, typer.Option("--materials", help="TOML file of materials.")]
LabelsOption = Annotated[Path | None, typer.Option("--labels", help="TOML file of materials per label.")]
UpOption = Annotated[str | None, typer.Option("--up", help="Up axis of the file: y or z.")]
UnitOption = Annotated[str | None, typer.Option("--unit", help="Unit of the file: m, cm, mm, in, ft.")]
StrictOption = Annotated[
    bool, typer.Option("--strict-materials", help="A label without a material is an error.")
]
LidOption = Annotated[
    bool | None,
    typer.Option("--lid/--no-lid", help="Cover what has no ceiling; by default where it is missing."),
]
DecimateOption = Annotated[float | None, typer.Option("--decimate", help="Share of the faces to keep.")]


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
    scene: Annotated[str, typer.Argument(help="Built-in name, scene folder or mesh file.")],
    out: Annotated[Path, typer.Option(help="Folder for datasets.")] = Path("out"),
    spacing: Annotated[float | None, typer.Option(help="Grid spacing, m.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Threads; default: all cores.")] = None,
    rate: Annotated[int | None, typer.Option(help="Sampling rate of the reader, Hz.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the random walks.")] = None,
    materials: MaterialsOption = None,
    labels: LabelsOption = None,
    up: UpOption = None,
    unit: UnitOption = None,
    strict_materials: StrictOption = False,
    lid: LidOption = None,
    decimate: DecimateOption = None,
    points: Annotated[
        Path | None, typer.Option(help="points.txt or graph.pkl: these points instead of a grid.")
    ] = None,
    store: Annotated[str | None, typer.Option(help="echogram, waveform or both.")] = None,
) -> None:
    """Simulate the room impulse responses between all grid points of a scene."""
    # Kernels load here, not when the help text is asked for.
    from soundspaces_sim.build import build_dataset
    from soundspaces_sim.config import load_config
    from soundspaces_sim.exchange.points import read_points
    from soundspaces_sim.loaders import load_scene
    from soundspaces_sim.resources import resource

    overrides: dict[str, dict[str, Any]] = {"grid": {}, "dataset": {}}
    for stage, name, value in (
        ("grid", "spacing", spacing), ("dataset", "rate", rate), ("dataset", "seed", seed),
        ("dataset", "store", store),
    ):  # fmt: skip
        if value is not None:
            overrides[stage][name] = value
    settings = load_config(config or resource("pipelines", "default.toml"), **overrides)
    places = read_points(points) if points is not None else None
    _console.print(f"Loading {scene}")
    loaded = load_scene(
        scene, materials=materials, labels=labels, up=up, unit=unit, strict_materials=strict_materials,
        lid=lid, decimate=decimate,
    )  # fmt: skip
    with _progress() as bar:
        task = bar.add_task("Preparing", total=None)

        def report(done: int, total: int) -> None:
            if interrupted:
                raise KeyboardInterrupt
            bar.update(task, description="Simulating", completed=done, total=total)

        def interrupt(*_: object) -> None:
            interrupted.append(True)  # a callback of compiled code may swallow the exception
            raise KeyboardInterrupt

        interrupted: list[bool] = []
        signal.signal(signal.SIGINT, interrupt)
        try:
            command = shlex.join(["soundspaces-sim", *sys.argv[1:]])
            result = build_dataset(loaded, out, settings, jobs, report, places, command)
        except KeyboardInterrupt:
            bar.stop()
            done = len(list((out / loaded.name).glob("*.h5")))
            print(
                f"Interrupted: {done} finished shards are safe in {out / loaded.name}; run the same "
                "command to go on",
                file=sys.stderr,
            )
            raise typer.Exit(_INTERRUPTED) from None
    _summary(result)


@app.command()
def inspect(
    scene: Annotated[str, typer.Argument(help="Built-in name, scene folder or mesh file.")],
    spacing: Annotated[float, typer.Option(help="Grid spacing, m.")] = 0.5,
    materials: MaterialsOption = None,
    labels: LabelsOption = None,
    up: UpOption = None,
    unit: UnitOption = None,
    strict_materials: StrictOption = False,
    lid: LidOption = None,
    decimate: DecimateOption = None,
) -> None:
    """Report geometry, materials and expected reverberation of a scene, with warnings."""
    from soundspaces_sim.config import GridConfig
    from soundspaces_sim.inspect import inspect_scene, report_text
    from soundspaces_sim.loaders import load_scene

    logging.getLogger("soundspaces_sim").setLevel(logging.WARNING)  # the report has the notes
    loaded = load_scene(
        scene, materials=materials, labels=labels, up=up, unit=unit, strict_materials=strict_materials,
        lid=lid, decimate=decimate,
    )  # fmt: skip
    print(report_text(inspect_scene(loaded, GridConfig(spacing=spacing))))


@app.command()
def verify(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    full: Annotated[bool, typer.Option("--full", help="Compare every byte (SHA-256).")] = False,
) -> None:
    """Check a dataset's files against its manifest and schema."""
    from soundspaces_sim.verify import rebuild_hint, verify_dataset

    manifest, problems = verify_dataset(dataset, full)
    if not problems:
        how = (
            "every byte is as it was written" if full else "sizes and schema; --full compares every byte"
        )
        print(f"{dataset}: {len(manifest.shards)} files are whole ({how}).")
        return
    for problem in problems:
        print(f"{dataset / problem.file} {problem.what}", file=sys.stderr)
    bad = " ".join(shlex.quote(str(dataset / p.file)) for p in problems)
    print(
        f"{len(problems)} of {len(manifest.shards)} files are wrong. To rebuild them and nothing else: "
        f"`rm -f {bad}`, then {rebuild_hint(manifest)}",
        file=sys.stderr,
    )
    raise typer.Exit(_DAMAGED)


@app.command()
def table(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    out: Annotated[Path, typer.Option(help="File to write, .csv or .parquet.")] = Path("pairs.csv"),
) -> None:
    """Write the table of pairs: positions, distances, room measures, error bars."""
    from soundspaces_sim.dataset import open_dataset
    from soundspaces_sim.table import write_table

    with open_dataset(dataset) as ds:
        rows = ds.table()
    write_table(rows, out)
    print(f"Wrote {out}: {len(rows):,} pairs")


@app.command()
def export(
    layout: Annotated[str, typer.Argument(help="soundspaces-v1, sofa or wav.")],
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset, or of several.")],
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("export"),
    rate: Annotated[int | None, typer.Option(help="Sampling rate, Hz.")] = None,
    name: Annotated[str, typer.Option(help="soundspaces-v1: replica or mp3d.")] = "replica",
) -> None:
    """Write a dataset, or every one in a folder, as others read it."""
    from soundspaces_sim.collection import open_datasets
    from soundspaces_sim.dataset import open_dataset
    from soundspaces_sim.errors import ConfigError
    from soundspaces_sim.exchange.sofa import export_sofa
    from soundspaces_sim.exchange.soundspaces1 import export_soundspaces1
    from soundspaces_sim.exchange.wav import export_wav
    from soundspaces_sim.manifest import NAME

    if layout not in ("soundspaces-v1", "sofa", "wav"):
        raise ConfigError(f"layout: expected soundspaces-v1, sofa or wav, got {layout!r}")
    one = (dataset / NAME).exists()
    for ds in [open_dataset(dataset, rate)] if one else open_datasets(dataset, rate).values():
        with ds, _progress() as bar:
            task = bar.add_task(f"Writing {ds.scene}", total=None)

            def report(done: int, total: int, bar: Progress = bar, task: TaskID = task) -> None:
                bar.update(task, completed=done, total=total)

            if layout == "soundspaces-v1":
                count = export_soundspaces1(ds, out, name, progress=report)
            elif layout == "sofa":
                count = export_sofa(ds, out, progress=report)
            else:
                count = export_wav(ds, out, ambisonics=True, progress=report)
        print(f"Wrote {count:,} files of {ds.scene} to {out}")


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
