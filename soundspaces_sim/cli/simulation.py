"""`rirs`: simulate a scene into a dataset."""

from __future__ import annotations

import logging
import math
import shlex
import signal
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import soundspaces_sim as ss
from soundspaces_sim.build.engines import ENGINES
from soundspaces_sim.cli.console import INTERRUPTED, Meter, console, duration, size_text
from soundspaces_sim.cli.options import (
    BandsOption,
    MaterialsOnReadingOption,
    ProfileOption,
    ReadOne,
    check_folder,
    read_bands,
    read_places,
    read_settings,
    reported,
    takes_scenes,
)
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.interrupts import check, deferred
from soundspaces_sim.core.platforms import peak_memory_mb
from soundspaces_sim.core.registry import check_name, names

if TYPE_CHECKING:
    from soundspaces_sim.scene.scene import Scene

_log = logging.getLogger("soundspaces_sim.cli")
_WHO = ("--jobs", "--engine", "--engine-option", "--tiles")  # options that change no byte


@takes_scenes
def rirs(
    scenes: list[str],
    read: ReadOne,
    out: Annotated[Path, typer.Option(help="Folder for datasets.")] = Path("out"),
    spacing: Annotated[float | None, typer.Option(help="Grid spacing, m.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Cores to use here; default: all.")] = None,
    walks: Annotated[int | None, typer.Option(help="Random subpaths per point.")] = None,
    bands: BandsOption = None,
    rate: Annotated[int | None, typer.Option(help="Sampling rate of the reader, Hz.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the random walks.")] = None,
    points: Annotated[
        Path | None,
        typer.Option(help="Text of lines `x y z` (m), or graph.pkl: these points instead of a grid."),
    ] = None,
    store: Annotated[str | None, typer.Option(help="echogram, waveform or both.")] = None,
    engine: Annotated[
        str, typer.Option(help=f"Engine that runs the tiles: {names(ENGINES)}.")
    ] = "local",
    engine_option: Annotated[
        list[str] | None,
        typer.Option(help="Of the engine, key=value, such as address=tcp://host:8786; may be repeated."),
    ] = None,
    tiles: Annotated[
        str | None,
        typer.Option(help="k/n: share k of n of the tiles, for another machine each; then `finish`."),
    ] = None,
    materials_on_reading: MaterialsOnReadingOption = False,
    profile: ProfileOption = False,
) -> None:
    """Simulate the room impulse responses between all grid points of one or more scenes."""
    from soundspaces_sim.scene.load import find_scenes

    flags = {
        "--spacing": ("grid", "spacing", spacing),
        "--walks": ("simulation", "walks", walks),
        "--bands": ("simulation", "bands", read_bands(bands)),
        "--rate": ("dataset", "rate", rate),
        "--seed": ("dataset", "seed", seed),
        "--store": ("dataset", "store", store),
        "--materials-on-reading": ("simulation", "materials", materials_on_reading or None),
    }
    settings = read_settings(config, flags)
    check_name("engine", ENGINES, engine)
    check_folder(out)
    places = read_places(points, settings)
    share, found = _share(tiles), find_scenes(scenes)
    if places is not None and len(found) > 1:
        raise ConfigError(
            f"--points {points}: these are points of one scene, and there are {len(found)}"
        )

    with reported("rirs", profile):
        load = partial(_load, read)
        to_build = [load(found[0])] if len(found) == 1 else [partial(load, name) for name in found]

        def build(watch: _Watch) -> Sequence[Any]:
            command, options = _command(sys.argv[1:]), engine_option or ()
            report, announce = watch.report, watch.announce
            job = out, settings, jobs, report, places, command, engine, announce, options, share
            return ss.build_datasets(to_build, *job)

        where = out if len(found) > 1 else out / getattr(to_build[0], "name", "")
        for result in _watched(build, where):
            _summary(result, share)


def _load(read: ReadOne, name: str) -> Scene:
    console.print(f"Loading {name}", highlight=False)
    return read(name)


def _watched(build: Callable[[_Watch], Sequence[Any]], where: Path) -> Sequence[Any]:
    """What `build` gives, under a progress bar; Ctrl-C ends the command and reports the shards in `where`."""
    with Meter("Preparing") as meter:
        try:
            # shells have what they start in the background ignore SIGINT: `kill -INT` shall stop it too
            signal.signal(signal.SIGINT, signal.default_int_handler)
            with deferred():
                return build(_Watch(meter))
        except KeyboardInterrupt:
            meter.__exit__(None, None, None)
            done = len([*where.glob("[sw]*.h5"), *where.glob("*/[sw]*.h5")])
            print(
                f"Interrupted: {done} finished shards are safe in {where}; run the same command to go on",
                file=sys.stderr,
            )
            raise typer.Exit(INTERRUPTED) from None


def _share(text: str | None) -> tuple[int, int] | None:
    """``3/40`` as (3, 40). Raises `ConfigError`."""
    if text is None:
        return None
    k, _, n = text.partition("/")
    if not (k.isdecimal() and n.isdecimal() and 1 <= int(k) <= int(n)):
        raise ConfigError(f"--tiles {text}: expected k/n with 1 <= k <= n, such as 3/40")
    return int(k), int(n)


def _command(arguments: Sequence[str]) -> str:
    """The command without options that change no byte of the dataset, so that manifests agree on any machine."""
    kept, skip = ["soundspaces-sim"], False
    for argument in arguments:
        name, sign, _ = argument.partition("=")
        if not skip and name not in (*_WHO, "--profile"):
            kept.append(argument)
        skip = not skip and name in _WHO and not sign
    return shlex.join(kept)


class _Watch:
    """Shows and logs how far a job is."""

    def __init__(self, meter: Meter) -> None:
        self._meter = meter
        self._started = time.monotonic()

    def announce(self, expected: Any) -> None:
        """An `Estimate`: what is to come."""
        text = f"{expected.points:,} points, {expected.pairs:,} room impulse responses of {expected.duration:g} s"
        if math.isfinite(expected.seconds):
            text += (
                f": about {duration(expected.seconds)} of idle cores, and {size_text(expected.bytes)}"
            )
        console.print(text, highlight=False, soft_wrap=True)
        _log.debug(
            "Expected",
            extra={
                "event": {
                    "points": expected.points,
                    "pairs": expected.pairs,
                    "expected_bytes": expected.bytes,
                    "expected_s": expected.seconds if math.isfinite(expected.seconds) else None,
                }
            },
        )
        self._started = time.monotonic()

    def report(self, status: Any) -> None:
        """A `BuildProgress`."""
        check()
        seconds = time.monotonic() - self._started
        rate, memory = (status.rirs + status.under_way) / max(seconds, 1e-9), peak_memory_mb()
        if status.total == 0:
            self._meter.stage(status.stage)
        else:
            simulating = status.stage in ("Simulating", "Stored")
            self._meter.stage("Simulating" if simulating else status.stage)
            extra = f"{rate:,.0f} RIRs/s, {memory:,.0f} MB" if simulating else ""
            self._meter.update(status.done, status.total, extra)
        _log.debug(
            "%s",
            status.stage,
            extra={
                "event": {
                    "stage": status.stage,
                    "done": status.done,
                    "total": status.total,
                    "rirs": status.rirs,
                    "rirs_per_s": round(rate, 1),
                    "seconds": round(seconds, 2),
                    "memory_mb": round(memory),
                }
            },
        )


def _summary(result: Any, share: tuple[int, int] | None) -> None:
    from soundspaces_sim.dataset.format.card import write_cards

    manifest = result.manifest
    if not manifest.complete:
        what = (
            "The tiles were handed over" if share is None else f"Share {share[0]} of {share[1]} is made"
        )
        print(
            f"{what}: {result.built} of {result.shards} shards of {result.folder} are new. When all are there: "
            f"`soundspaces-sim finish {shlex.quote(str(result.folder))}`"
        )
        return
    write_cards(result.folder)
    n = len(manifest.points)
    size = sum(e.bytes for e in manifest.shards)
    if result.built == 0 and result.changed:
        print(
            f"Wrote the manifest of {result.folder}: {'; '.join(result.changed)}. All shards stay as they were."
        )
    elif result.built == 0:
        print(f"Nothing to do: {result.folder} is complete.")
    else:
        reused = result.shards - result.built
        kept = f" ({reused} of {result.shards} shards were there)" if reused else ""
        print(f"Wrote {result.folder}{kept}")
    print(
        f"  {n * n:,} room impulse responses between {n} points, {manifest.duration:.1f} s each, "
        f"{size_text(size)}"
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
