"""`rooms`: simulate a list of rooms, each with pairs of its own, or random rooms for training."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

import soundspaces_sim as ss
from soundspaces_rooms.random_room_files import build_random_rooms
from soundspaces_rooms.room_files import build_rooms
from soundspaces_rooms.room_stream import RoomStream
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import (
    Meter,
    ProfileOption,
    adopt_profile as adopt,
    check_folder,
    of_simulation,
    read_settings,
    reported,
    run_app,
)

_OF_RANDOM = "Of --count. "
_List = Annotated[
    Path | None,
    typer.Argument(
        metavar="LIST",
        help="A room per line, JSON: name, sources, listeners, and scene, or size of a shoebox with "
        "absorption, scattering, transmission.",
    ),
]
_Out = Annotated[Path, typer.Option(help="Folder for files: NAME.h5 of each room of a list, or shards.")]
_Count = Annotated[
    int | None, typer.Option(help="Instead of a list: so many random rooms for training.")
]
_Format = Annotated[
    str | None,
    typer.Option("--format", help=_OF_RANDOM + "webdataset (default), hdf5 or wav."),
]
_Rate = Annotated[int | None, typer.Option(help=_OF_RANDOM + "Hz; default 16000.")]
_Sources = Annotated[
    tuple[int, int] | None, typer.Option(help=_OF_RANDOM + "Fewest and most talkers; default 1 4.")
]
_Microphones = Annotated[
    tuple[int, int] | None,
    typer.Option(help=_OF_RANDOM + "Fewest and most of the array; default 2 8."),
]
_Kind = Annotated[
    list[str] | None,
    typer.Option(help=_OF_RANDOM + "shoebox, polygon or furnished, one or several times; default all."),
]
_Low = Annotated[
    float | None,
    typer.Option(help=_OF_RANDOM + "Standard deviation of random gains below 200 Hz, dB; default 0."),
]
_PerFile = Annotated[int | None, typer.Option(help=_OF_RANDOM + "Rooms of a shard; default 100.")]

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def rooms(
    listed: _List = None,
    out: _Out = Path("rooms"),
    count: _Count = None,
    layout: _Format = None,
    rate: _Rate = None,
    sources: _Sources = None,
    microphones: _Microphones = None,
    kind: _Kind = None,
    low_equalisation: _Low = None,
    per_file: _PerFile = None,
    config: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    jobs: Annotated[
        int | None, typer.Option(help="Processes, of one thread each; default: one per core.")
    ] = None,
    target_error: Annotated[
        float | None,
        typer.Option(help="Relative error that every pair shall have; default 0.05, without a config."),
    ] = None,
    walks: Annotated[
        int | None, typer.Option(help="A fixed number of random subpaths per point instead.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of the random walks, and of random rooms.")
    ] = None,
    profile: ProfileOption = False,
) -> None:
    """Simulate the pairs of many rooms, one room a process. What is there is left alone.

    The rooms are those of a list, or with --count random ones with one to four talkers and an array of
    microphones each, written as shards of responses with labels and their standard errors."""
    if walks is not None and target_error is not None:
        raise ConfigError("expected --walks or --target-error, got both")
    flags = {
        "--walks": ("simulation", "walks", walks),
        "--target-error": ("simulation", "target_error", target_error),
        "--seed": ("dataset", "seed", seed),
    }
    settings = read_settings(config, flags)
    if config is None:
        error = None if walks is not None else settings.simulation.target_error
        transfer = ss.RadianceTransferConfig(subpaths="auto")
        asked = ss.SimulationConfig(walks=walks, target_error=error, radiance_transfer=transfer)
        settings = msgspec.structs.replace(settings, simulation=of_simulation(asked))
    if (listed is None) == (count is None):
        raise ConfigError("expected either LIST or --count N")
    check_folder(out)
    named: dict[str, Any] = {
        "layout": layout,
        "rate": rate,
        "sources": sources,
        "microphones": microphones,
    }
    named |= {"kinds": kind and tuple(kind), "per_file": per_file}
    named |= {"low_equalisation_db": low_equalisation}
    given = {name: value for name, value in named.items() if value is not None}
    if listed is None:
        _random(count, given, settings, out, jobs, profile)
    elif given:
        raise ConfigError(f"{next(iter(given))}: of random rooms alone (--count), not of a list")
    else:
        _of_list(listed, out, settings, jobs, profile)


def _of_list(listed: Path, out: Path, settings: ss.JobConfig, jobs: int | None, profile: bool) -> None:
    done = made = pairs = 0
    with reported("rooms", profile), Meter("Simulating") as meter:
        for room in build_rooms(listed, out, settings, jobs):
            adopt(room.profile)
            done, made, pairs = done + 1, made + room.made, pairs + room.pairs
            meter.update(done, room.rooms, f"{pairs:,} pairs")
    there = f" ({done - made} were there)" if made < done else ""
    print(f"Wrote {made} rooms to {out}{there}: {pairs:,} room impulse responses")


def _random(
    count: int | None,
    given: dict[str, Any],
    settings: ss.JobConfig,
    out: Path,
    jobs: int | None,
    profile: bool,
) -> None:
    if profile:
        raise ConfigError("--profile: expected LIST; random rooms are not told stage by stage")
    files = {name: given.pop(name) for name in ("layout", "per_file") if name in given}
    stream = RoomStream(settings.dataset.seed, count, config=settings.simulation, **given)
    with Meter("Simulating") as meter:
        for at in build_random_rooms(stream, out, jobs=jobs, **files):
            meter.update(at.done, at.rooms, f"{at.failed:,} failed" if at.failed else "")
    kept = f" ({at.there:,} were there)" if at.there else ""
    lost = f"; {at.failed:,} failed, as failed.jsonl says" if at.failed else ""
    print(f"Wrote {at.done - at.there:,} rooms to {out}{kept}{lost}; rooms.jsonl lists the responses")


def main() -> None:
    """Entry point."""
    run_app(app)


if __name__ == "__main__":
    main()
