"""Jobs and what comes before them: `inspect` a scene, `plan`, `status`, `finish`."""

from __future__ import annotations

import json
import logging
import math
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Column, Table

import soundspaces_sim as ss
from soundspaces_sim.cli.console import DAMAGED, Meter, duration, size_text
from soundspaces_sim.cli.options import (
    BandsOption,
    MaterialsOnReadingOption,
    Read,
    ReadOne,
    read_bands,
    read_places,
    read_settings,
    takes_scene,
    takes_scenes,
)
from soundspaces_sim.core.errors import DatasetError

if TYPE_CHECKING:
    from soundspaces_sim.build.engines import BuildProgress
    from soundspaces_sim.build.forecast import Forecast


_WIDTH = 110  # of tables that go to a file

# Engine, workers, threads of each, and seconds that it adds to a tile (docs/clusters.md says how measured).
_CREWS = (("dask", 8, 1), ("dask", 32, 1), ("slurm", 64, 4), ("slurm", 256, 4))
_OVERHEAD_S = {"local": 0.0, "dask": 0.01, "slurm": 0.0}
# Until a worker begins, without the wait in a queue.
_START_S = {"local": 0.0, "dask": 5.0, "slurm": 15.0}


def _print(table: Table) -> None:
    out = Console()
    Console(width=None if out.is_terminal else max(out.width, _WIDTH)).print(table)


@takes_scenes
def plan(
    scenes: list[str],
    read: ReadOne,
    spacing: Annotated[float | None, typer.Option(help="Grid spacing, m.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    walks: Annotated[int | None, typer.Option(help="Random subpaths per point.")] = None,
    bands: BandsOption = None,
    points: Annotated[
        Path | None,
        typer.Option(help="Text of lines `x y z` (m), or graph.pkl: these points instead of a grid."),
    ] = None,
    store: Annotated[str | None, typer.Option(help="echogram, waveform or both.")] = None,
    materials_on_reading: MaterialsOnReadingOption = False,
    workers: Annotated[
        list[int] | None,
        typer.Option(help="Also the wall time of so many one-core workers; may be repeated."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="As JSON, one object per scene.")] = False,
) -> None:
    """Say how many pairs, bytes and core-hours a job would take, from a short measurement; write nothing."""
    from soundspaces_sim.build.forecast import forecast
    from soundspaces_sim.scene.load import find_scenes

    flags = {
        "--spacing": ("grid", "spacing", spacing),
        "--walks": ("simulation", "walks", walks),
        "--bands": ("simulation", "bands", read_bands(bands)),
        "--store": ("dataset", "store", store),
        "--materials-on-reading": ("simulation", "materials", materials_on_reading or None),
    }
    settings = read_settings(config, flags)
    places = read_places(points, settings)
    found = find_scenes(scenes)
    logging.getLogger("soundspaces_sim").setLevel(logging.WARNING)
    forecasts = []
    with Meter("Planning") as meter:
        for name in found:
            meter.stage(f"Loading {name}")
            forecasts.append(forecast(read(name), settings, places, partial(_tell, meter, name)))
    if as_json:
        for f in forecasts:
            print(json.dumps({**asdict(f), "pairs": f.pairs, "core_hours": f.core_hours}))
        return
    _print(_scenes_table(forecasts))
    _print(_crews_table(forecasts, workers or []))
    for f in forecasts:
        tiles = " and ".join(map(str, f.measured))
        print(
            f"{f.scene}: measured on {'tiles' if len(f.measured) > 1 else 'a tile'} of {tiles} of its points."
        )
    print("Wall times are those of the most core-hours. Small tiles do not tell more than these bounds.")
    if settings.dataset.store != "echogram":
        print("The rendering of waveforms is in the bytes, not in the times.")


def _tell(meter: Meter, scene: str, status: BuildProgress) -> None:
    """Show a step of a scene's plan."""
    meter.stage(f"{scene}: {status.stage[0].lower()}{status.stage[1:]}")
    if status.total:
        meter.update(status.done, status.total)


def _scenes_table(forecasts: list[Forecast]) -> Table:
    table = Table("scene", *(_right(h) for h in "points pairs length tiles bytes core-hours".split()))
    for f in forecasts:
        table.add_row(
            f.scene,
            f"{f.points:,}",
            f"{f.pairs:,}",
            f"{f.duration:.1f} s",
            f"{len(f.tiles):,}",
            size_text(f.bytes),
            _range(f.least_core_hours, f.core_hours),
        )
    if len(forecasts) > 1:
        total = [
            sum(getattr(f, n) for f in forecasts)
            for n in ("points", "pairs", "bytes", "least_core_hours", "core_hours")
        ]
        tiles = sum(len(f.tiles) for f in forecasts)
        table.add_section()
        table.add_row(
            "all",
            f"{total[0]:,}",
            f"{total[1]:,}",
            "",
            f"{tiles:,}",
            size_text(total[2]),
            _range(*total[3:]),
        )
    return table


def _crews_table(forecasts: list[Forecast], workers: list[int]) -> Table:
    from soundspaces_sim.build.forecast import ALONE, local_shape, wall_time
    from soundspaces_sim.core.numerics.threads import core_count

    tiles = [t for f in forecasts for t in f.tiles]
    here = local_shape(len(tiles))
    table = Table("engine", *(_right(h) for h in ("workers × threads", "wall time")))
    for name, count, threads in (("local", *here), *_CREWS, *(("dask", n, 1) for n in workers)):
        shared = (core_count(), ALONE) if name == "local" else (None, 0.0)
        seconds = wall_time(tiles, count, threads, _OVERHEAD_S[name], *shared) + _START_S[name]
        table.add_row(name, f"{count} × {threads}", duration(seconds))
    return table


def _right(name: str) -> Column:
    return Column(name, justify="right")


def _range(least: float, most: float) -> str:
    """Of hours, or the one number that both show as."""
    low, high = _hours(least), _hours(most)
    return high if low == high else f"{low} to {high}"


def _hours(hours: float) -> str:
    return f"{hours:,.1f}" if hours >= 10.0 else f"{hours:.2g}"


def status(
    out: Annotated[Path, typer.Argument(help="Folder of a dataset, or of several.")] = Path("out"),
    as_json: Annotated[bool, typer.Option("--json", help="As JSON, one object per dataset.")] = False,
) -> None:
    """Say how far jobs are, from their folders alone; also while they run."""
    from soundspaces_sim.build import status as folders

    found = [folders.read_status(folder) for folder in folders.find_datasets(out)]
    if as_json:
        for one in found:
            numbers = {
                k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(one).items()
            }
            print(json.dumps({**numbers, "folder": str(one.folder)}))
        return
    table = Table(
        "scene", "state", *(_right(h) for h in ("tiles", "RIRs", "error", "bytes", "last shard"))
    )
    for one in found:
        share = f"{100 * one.tiles[0] // max(one.tiles[1], 1)} %"
        table.add_row(
            one.scene,
            "complete" if one.complete else share,
            f"{one.tiles[0]:,} of {one.tiles[1]:,}",
            f"{one.rirs[0]:,} of {one.rirs[1]:,}",
            "" if math.isnan(one.error) else f"{100 * one.error:.1f} %",
            size_text(one.bytes),
            "none yet" if math.isnan(one.age_s) else f"{duration(one.age_s)} ago",
        )
    _print(table)


def finish(
    out: Annotated[Path, typer.Argument(help="Folder of a dataset, or of several.")] = Path("out"),
) -> None:
    """Close jobs whose tiles are all made, by any machine: write the manifest with sizes and SHA-256."""
    from soundspaces_sim.build.finish import finish_folder
    from soundspaces_sim.build.status import find_datasets
    from soundspaces_sim.dataset.format.card import write_cards

    problems = []
    for folder in find_datasets(out):
        try:
            manifest = finish_folder(folder)
            write_cards(folder)
        except DatasetError as error:
            problems.append(str(error))
            continue
        print(
            f"{folder}: {len(manifest.points) ** 2:,} room impulse responses, {len(manifest.shards)} shards"
        )
    if problems:
        raise DatasetError("; ".join(problems))


@takes_scene
def inspect(
    scene: str,
    read: Read,
    spacing: Annotated[float, typer.Option(help="Grid spacing, m.")] = 0.5,
) -> None:
    """Report geometry, materials and expected reverberation of a scene, with warnings."""
    from soundspaces_sim.build.inspect import report_text

    config = ss.GridConfig(spacing=spacing)
    logging.getLogger("soundspaces_sim").setLevel(logging.WARNING)  # the report has the notes
    with Meter("Inspecting") as meter:
        meter.stage(f"Loading {scene}")
        report = ss.inspect_scene(read(), config, meter.stage)
    print(report_text(report))
    if report.points == 0:
        print(f"{report.name}: `rirs` has nothing to do here: no grid point survives", file=sys.stderr)
        raise typer.Exit(DAMAGED)
