"""`rooms`: simulate a list of rooms, each with pairs of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import typer

import soundspaces_sim as ss
from soundspaces_sim.cli.console import Meter
from soundspaces_sim.cli.options import ProfileOption, check_folder, reported
from soundspaces_sim.cli.settings import read_settings
from soundspaces_sim.core.profile import adopt


def rooms(
    listed: Annotated[
        Path,
        typer.Argument(
            metavar="LIST",
            help="A room per line, JSON: name, sources, listeners, and scene, or size of a shoebox with "
            "absorption, scattering, transmission.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for files, NAME.h5 of each room.")] = Path("rooms"),
    config: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    jobs: Annotated[
        int | None, typer.Option(help="Processes, of one thread each; default: one per core.")
    ] = None,
    walks: Annotated[int | None, typer.Option(help="Random subpaths per point.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the random walks.")] = None,
    profile: ProfileOption = False,
) -> None:
    """Simulate the pairs of many rooms, one room a process. Rooms whose files are there are left alone."""
    settings = read_settings(
        config, {"--walks": ("simulation", "walks", walks), "--seed": ("dataset", "seed", seed)}
    )
    if config is None:  # estimators by the number of a room's points
        transfer = msgspec.structs.replace(settings.simulation.radiance_transfer, subpaths="auto")
        simulation = msgspec.structs.replace(settings.simulation, radiance_transfer=transfer)
        settings = msgspec.structs.replace(settings, simulation=simulation)
    check_folder(out)
    done = made = pairs = 0
    with reported("rooms", profile), Meter("Simulating") as meter:
        for room in ss.build_rooms(listed, out, settings, jobs):
            adopt(room.profile)
            done, made, pairs = done + 1, made + room.made, pairs + room.pairs
            meter.update(done, room.rooms, f"{pairs:,} pairs")
    there = f" ({done - made} were there)" if made < done else ""
    print(f"Wrote {made} rooms to {out}{there}: {pairs:,} room impulse responses")
