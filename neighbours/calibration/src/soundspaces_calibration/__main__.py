"""`soundspaces-calibrate SCENE --measured FILE`: materials of a measured room."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from soundspaces_pictures.commands import need_matplotlib

import soundspaces_calibration as cal
from soundspaces_sim.parts import (
    Meter,
    ProfileOption,
    Read,
    ReplaceOption,
    make_folder,
    output_folder,
    publish_file as publish,
    read_settings,
    reported,
    run_app,
    takes_scene,
)

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
@takes_scene
def calibrate(
    scene: str,
    read: Read,
    measured: Annotated[
        Path,
        typer.Option(
            help="Table of parameters or of WAV files (.csv), SOFA file, or folder of them; README.md."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for materials.toml, report.html, pairs.csv.")] = Path(
        "calibrated"
    ),
    hold_out: Annotated[
        list[str] | None,
        typer.Option(
            help="Leave these pairs out of the fit: a source, a receiver, SOURCE:RECEIVER; may be repeated."
        ),
    ] = None,
    rounds: Annotated[int, typer.Option(help="Simulations at most.", min=2)] = 5,
    config: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    walks: Annotated[int | None, typer.Option(help="Random subpaths per point.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the random walks.")] = None,
    profile: ProfileOption = False,
    replace: ReplaceOption = False,
) -> None:
    """Fit the absorption of a scene's materials to room measures of it."""
    need_matplotlib()
    settings = read_settings(
        config, {"--walks": ("simulation", "walks", walks), "--seed": ("dataset", "seed", seed)}
    )
    room = cal.read_measured(measured)
    held = tuple(hold_out or ())
    room.pairs_of(held, "--hold-out ")
    output_folder(out, replace)
    with reported("calibrate", profile), Meter("Simulating and fitting") as meter:
        meter.stage(f"Loading {scene}")
        found = cal.calibrate(
            read(),
            room,
            settings.simulation,
            hold_out=held,
            seed=settings.dataset.seed,
            rounds=rounds,
            progress=meter.update,
        )
    make_folder(out)
    publish(out / "materials.toml", found.materials.encode())
    cal.write_calibration_pairs(found, out / "pairs.csv")
    cal.write_calibration_report(found, out / "report.html")
    print(found)
    print(f"Wrote {out}: materials.toml, report.html, pairs.csv")
    if not found.settled:
        print(
            f"The fit has not settled after {rounds} simulations: see {out / 'report.html'}",
            file=sys.stderr,
        )


def main() -> None:
    """Entry point."""
    run_app(app)


if __name__ == "__main__":
    main()
