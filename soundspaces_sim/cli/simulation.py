"""`rirs`: simulate a scene into a dataset."""

from __future__ import annotations

import logging
import shlex
import signal
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import Progress, TaskID

from soundspaces_sim.base.registry import names
from soundspaces_sim.cli.console import INTERRUPTED, console, memory_mb, progress_bar
from soundspaces_sim.cli.options import Read, takes_scene
from soundspaces_sim.jobs.engines import ENGINES

_log = logging.getLogger("soundspaces_sim.cli")


@takes_scene
def rirs(
    scene: str,
    read: Read,
    out: Annotated[Path, typer.Option(help="Folder for datasets.")] = Path("out"),
    spacing: Annotated[float | None, typer.Option(help="Grid spacing, m.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Threads; default: all cores.")] = None,
    rate: Annotated[int | None, typer.Option(help="Sampling rate of the reader, Hz.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the random walks.")] = None,
    points: Annotated[
        Path | None, typer.Option(help="points.txt or graph.pkl: these points instead of a grid.")
    ] = None,
    store: Annotated[str | None, typer.Option(help="echogram, waveform or both.")] = None,
    engine: Annotated[str, typer.Option(help=f"Who runs the tiles: {names(ENGINES)}.")] = "local",
) -> None:
    """Simulate the room impulse responses between all grid points of a scene."""
    from soundspaces_sim.base.config import load_config
    from soundspaces_sim.base.resources import resource
    from soundspaces_sim.exchange.points import read_points
    from soundspaces_sim.jobs.build import build_dataset

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
    console.print(f"Loading {scene}")
    loaded = read()
    with progress_bar() as bar:
        watch = _Watch(bar)
        signal.signal(signal.SIGINT, watch.interrupt)
        try:
            command = shlex.join(["soundspaces-sim", *sys.argv[1:]])
            result = build_dataset(loaded, out, settings, jobs, watch.report, places, command, engine)
        except KeyboardInterrupt:
            bar.stop()
            done = len(list((out / loaded.name).glob("[sw]*.h5")))
            print(
                f"Interrupted: {done} finished shards are safe in {out / loaded.name}; run the same "
                "command to go on",
                file=sys.stderr,
            )
            raise typer.Exit(INTERRUPTED) from None
    _summary(result)


class _Watch:
    """Shows and logs how far a job is, and ends it when Ctrl-C is pressed."""

    def __init__(self, bar: Progress) -> None:
        self._bar = bar
        self._task: TaskID = bar.add_task("Preparing", total=None, extra="")
        self._started = time.monotonic()
        self._interrupted = False

    def interrupt(self, *_: object) -> None:
        self._interrupted = True  # a callback of compiled code may swallow the exception
        raise KeyboardInterrupt

    def report(self, status: Any) -> None:
        """A `BuildProgress`."""
        if self._interrupted:
            raise KeyboardInterrupt
        seconds = time.monotonic() - self._started
        rate, memory = status.rirs / max(seconds, 1e-9), memory_mb()
        self._bar.update(
            self._task, description=status.stage, completed=status.done, total=status.total,
            extra=f"{rate:,.0f} RIRs/s, {memory:,.0f} MB",
        )  # fmt: skip
        _log.debug(
            "%s", status.stage,
            extra={"event": {
                "stage": status.stage, "done": status.done, "total": status.total, "rirs": status.rirs,
                "rirs_per_s": round(rate, 1), "seconds": round(seconds, 2), "memory_mb": round(memory),
            }},
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
