"""`soundspaces-sim collection`: many generated buildings as one open collection."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from soundspaces_sim.parts import (
    DAMAGED,
    ENGINES,
    INTERRUPTED,
    Meter,
    check_entry_name as check_name,
    check_folder,
    entry_names as names,
    packaged_file as resource,
    read_settings,
    run_app,
    size_text,
)

if TYPE_CHECKING:
    from soundspaces_sim.parts import CollectionManifest

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def collection(
    out: Annotated[Path, typer.Option(help="Folder of the collection.")] = Path("out/collection"),
    homes: Annotated[int, typer.Option(help="How many buildings.")] = 1000,
    kind: Annotated[str, typer.Option(help="Type of building: home, room, office, …")] = "home",
    config: Annotated[
        Path | None, typer.Option(help="TOML file of settings; by default pipelines/collection.toml.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(help="Processes, a building each; default: all cores.")
    ] = None,
    walks: Annotated[int | None, typer.Option(help="Random subpaths per point.")] = None,
    episodes: Annotated[int, typer.Option(help="Navigation episodes per building.")] = 20,
    engine: Annotated[
        str, typer.Option(help=f"Engine that runs the tiles: {names(ENGINES)}.")
    ] = "local",
    engine_option: Annotated[
        list[str] | None, typer.Option(help="Of the engine, key=value; may be repeated.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="File for the report; by default report.md in the folder.")
    ] = None,
    finish: Annotated[
        bool, typer.Option("--finish", help="Make no more datasets: close with those that are there.")
    ] = False,
) -> None:
    """Build datasets of generated buildings with splits, episodes, statistics, checksums and a report."""
    from soundspaces_collections.pipeline import build_collection

    settings = read_settings(
        config or resource("pipelines", "collection.toml"), {"--walks": ("simulation", "walks", walks)}
    )
    check_name("engine", ENGINES, engine)
    check_folder(out)
    with Meter("Buildings") as meter:
        try:
            made = build_collection(
                out,
                homes,
                settings,
                jobs,
                engine,
                engine_option or (),
                kind,
                episodes,
                report,
                lambda line: print(line, flush=True),
                meter.update,
                finish,
            )
        except KeyboardInterrupt:
            print(f"Interrupted: what is finished is safe in {out}; run the same command to go on")
            raise typer.Exit(INTERRUPTED) from None
    _summary(made, out)


def _summary(made: CollectionManifest, out: Path) -> None:
    """Raises `typer.Exit` if something failed."""
    size = size_text(made.bytes)
    print(f"{out}: {len(made.scenes)} datasets, {made.pairs:,} room impulse responses, {size}")
    for failure in made.failures:
        print(f"{failure.scene} failed: {failure.error}")
    if made.failures:
        raise typer.Exit(DAMAGED)


def main() -> None:
    """Entry point."""
    run_app(app)


if __name__ == "__main__":
    main()
