"""The command line: `soundspaces-sim rirs SCENE` is what `make rirs` calls; more in `--help`."""

from __future__ import annotations

import json
import logging
import resource as process
import shlex
import signal
import sys
import time
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

from soundspaces_sim.base.errors import SoundSpacesSimError

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)
_console = Console(stderr=True)
_log = logging.getLogger("soundspaces_sim.cli")
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
    log_json: Annotated[
        bool,
        typer.Option(
            "--log-json", help="Log lines as JSON on stderr, with progress: for batch systems."
        ),
    ] = False,
) -> None:
    """Build and read room-impulse-response datasets."""
    handler: logging.Handler
    if log_json:
        _console.quiet = True
        handler = logging.StreamHandler()
        handler.setFormatter(_JsonLines())
    else:
        handler = RichHandler(console=_console, show_path=False, show_time=False)
        handler.addFilter(lambda record: not hasattr(record, "event"))  # the progress bar shows these
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[handler])
    logging.getLogger("soundspaces_sim").setLevel(logging.DEBUG if verbose or log_json else logging.INFO)
    logging.getLogger("trimesh").setLevel(logging.ERROR)
    logging.getLogger("matplotlib").setLevel(logging.WARNING)


class _JsonLines(logging.Formatter):
    """One JSON object per line: time, level, logger, message, and what an event carries."""

    def format(self, record: logging.LogRecord) -> str:
        line = {
            "time": round(record.created, 3),
            "level": record.levelname.lower(),
            "logger": record.name,
        }
        return json.dumps({**line, "message": record.getMessage(), **getattr(record, "event", {})})


def _memory_mb() -> float:
    """Largest resident size so far; macOS counts in bytes, Linux in kB."""
    peak = process.getrusage(process.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


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
    from soundspaces_sim.base.config import load_config
    from soundspaces_sim.base.resources import resource
    from soundspaces_sim.exchange.points import read_points
    from soundspaces_sim.jobs.build import BuildProgress, build_dataset
    from soundspaces_sim.loaders import load_scene

    overrides: dict[str, dict[str, Any]] = {"grid": {}, "dataset": {}}
    for stage, name, value in (
        ("grid", "spacing", spacing), ("dataset", "rate", rate), ("dataset", "seed", seed),
        ("dataset", "store", store),
    ):  # fmt: skip
        if value is not None:
            overrides[stage][name] = value
    settings = load_config(config or resource("pipelines", "default.toml"), **overrides)
    places = read_points(points) if points is not None else None
    if places is not None and points is not None and points.suffix == ".pkl":
        places[:, 2] += settings.grid.height  # a graph's nodes lie on the floor
    _console.print(f"Loading {scene}")
    loaded = load_scene(
        scene, materials=materials, labels=labels, up=up, unit=unit, strict_materials=strict_materials,
        lid=lid, decimate=decimate,
    )  # fmt: skip
    with _progress() as bar:
        task = bar.add_task("Preparing", total=None, extra="")

        started = time.monotonic()

        def report(status: BuildProgress) -> None:
            if interrupted:
                raise KeyboardInterrupt
            seconds = time.monotonic() - started
            rate, memory = status.rirs / max(seconds, 1e-9), _memory_mb()
            bar.update(
                task, description=status.stage, completed=status.done, total=status.total,
                extra=f"{rate:,.0f} RIRs/s, {memory:,.0f} MB",
            )  # fmt: skip
            _log.debug(
                "%s", status.stage,
                extra={"event": {
                    "stage": status.stage, "done": status.done, "total": status.total, "rirs": status.rirs,
                    "rirs_per_s": round(rate, 1), "seconds": round(seconds, 2), "memory_mb": round(memory),
                }},
            )  # fmt: skip

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
            done = len(list((out / loaded.name).glob("[sw]*.h5")))
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
    from soundspaces_sim.base.config import GridConfig
    from soundspaces_sim.loaders import load_scene
    from soundspaces_sim.places.survey import inspect_scene, report_text

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
    from soundspaces_sim.storage.verify import rebuild_hint, verify_dataset

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
    from soundspaces_sim.reading.dataset import open_dataset
    from soundspaces_sim.storage.table import write_table

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
    from soundspaces_sim.base.errors import ConfigError
    from soundspaces_sim.exchange.sofa import export_sofa
    from soundspaces_sim.exchange.soundspaces1 import export_soundspaces1
    from soundspaces_sim.exchange.wav import export_wav
    from soundspaces_sim.reading.collection import open_datasets
    from soundspaces_sim.reading.dataset import open_dataset
    from soundspaces_sim.storage.manifest import NAME

    if layout not in ("soundspaces-v1", "sofa", "wav"):
        raise ConfigError(f"layout: expected soundspaces-v1, sofa or wav, got {layout!r}")
    one = (dataset / NAME).exists()
    for ds in [open_dataset(dataset, rate)] if one else open_datasets(dataset, rate).values():
        with ds, _progress() as bar:
            task = bar.add_task(f"Writing {ds.scene}", total=None, extra="")

            def report(done: int, total: int, bar: Progress = bar, task: TaskID = task) -> None:
                bar.update(task, completed=done, total=total)

            if layout == "soundspaces-v1":
                count = export_soundspaces1(ds, out, name, progress=report)
            elif layout == "sofa":
                count = export_sofa(ds, out, progress=report)
            else:
                count = export_wav(ds, out, ambisonics=True, progress=report)
        print(f"Wrote {count:,} files of {ds.scene} to {out}")


@app.command()
def plot(
    subject: Annotated[str, typer.Argument(help="Folder of a dataset, or a scene.")],
    what: Annotated[str, typer.Option(help="map, field, lobes, decay, rir or error.")] = "map",
    out: Annotated[Path | None, typer.Option(help="File to write, .png, .svg or .pdf.")] = None,
    source: Annotated[int | None, typer.Option(help="Point of the source.")] = None,
    listener: Annotated[
        list[int] | None, typer.Option(help="Point of a listener; may be repeated.")
    ] = None,
    spacing: Annotated[float | None, typer.Option(help="Grid spacing of a scene, m.")] = None,
    animate: Annotated[bool, typer.Option("--animate", help="field: a GIF over sources.")] = False,
) -> None:
    """Draw a picture of a dataset or a scene."""
    _need_matplotlib()
    from soundspaces_sim.figures.pages import animate_field, draw_page, load_subject

    found = load_subject(subject, spacing)
    path = out or Path(f"{found.name}_{what}.{'gif' if animate else 'png'}")
    if animate:
        print(f"Wrote {path}: {animate_field(found, path)} sources")
        return
    figure = draw_page(found, what, source, tuple(listener or ()))  # type: ignore[arg-type]
    try:
        figure.savefig(path, dpi=90, bbox_inches="tight")
    except (OSError, ValueError) as error:
        raise SoundSpacesSimError(f"{path}: cannot write this picture ({error})") from error
    print(f"Wrote {path}")


@app.command()
def listen(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("listening"),
    speech: Annotated[Path | None, typer.Option(help="A recording instead of made syllables.")] = None,
    clap: Annotated[Path | None, typer.Option(help="A recording instead of a made clap.")] = None,
    music: Annotated[Path | None, typer.Option(help="A recording instead of made strings.")] = None,
) -> None:
    """Write sounds at three places and four headings, mono beside binaural, with spectrograms."""
    _need_matplotlib()
    from soundspaces_sim.figures.listen import listening_folder
    from soundspaces_sim.reading.dataset import open_dataset

    own = {k: v for k, v in (("speech", speech), ("clap", clap), ("music", music)) if v is not None}
    with open_dataset(dataset) as ds, _progress() as bar:
        task = bar.add_task("Rendering", total=None, extra="")
        count = listening_folder(
            ds, out, own, lambda done, total: bar.update(task, completed=done, total=total)
        )
    print(f"Wrote {count} sounds and their spectrograms to {out}; {out}/README.txt says which is which")


def _need_matplotlib() -> None:
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        raise SoundSpacesSimError("pictures need matplotlib: `pip install soundspaces-sim[figures]`")


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[extra]}"), console=_console, disable=not _console.is_terminal,
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
