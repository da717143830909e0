"""`verify`, `table`, `export`: commands on datasets that are there."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

import soundspaces_sim as ss
from soundspaces_sim import rendering
from soundspaces_sim.cli.console import DAMAGED, Meter, console, size_text
from soundspaces_sim.cli.options import (
    HrtfOption,
    RendererOption,
    ReplaceOption,
    ask_to_replace,
    check_folder,
    check_renderer_option,
    open_found,
    output_file,
)
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.registry import names
from soundspaces_sim.dataset.exporters import EXPORTERS, find_exporter

if TYPE_CHECKING:
    from soundspaces_sim.dataset.exporters.plan import ExportPlan
    from soundspaces_sim.dataset.format.manifest import Manifest


def verify(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset, or of a collection.")],
    full: Annotated[bool, typer.Option("--full", help="Compare every byte (SHA-256).")] = False,
) -> None:
    """Check a dataset's files against its manifest and schema, or a collection's against collection.json."""
    from soundspaces_sim.dataset.format import collection_manifest, verify as verification

    if (dataset / collection_manifest.NAME).is_file():
        made, problems = collection_manifest.verify_collection(dataset, full)
        for problem in problems:
            print(f"{dataset / problem.file} {problem.what}", file=sys.stderr)
        if problems:
            print("Delete them and run the same `soundspaces-sim collection` again.", file=sys.stderr)
            raise typer.Exit(DAMAGED)
        print(
            f"{dataset}: {len(made.scenes)} datasets and {len(made.files)} files beside them are whole."
        )
        _say_not_compared(collection_manifest.not_compared(dataset))
        return
    manifest, problems = verification.verify_dataset(dataset, full)
    if not problems:
        how = (
            "every byte is as it was written" if full else "sizes and schema; --full compares every byte"
        )
        print(f"{dataset}: {len(manifest.shards)} files are whole ({how}).")
        _say_not_compared(verification.not_compared(dataset))
        print_doubts(manifest)
        _print_undefined(dataset)
        return
    for problem in problems:
        print(f"{dataset / problem.file} {problem.what}", file=sys.stderr)
    bad = " ".join(shlex.quote(str(dataset / p.file)) for p in problems)
    print(
        f"{len(problems)} of {len(manifest.shards)} files are wrong. To rebuild them and nothing else: "
        f"`rm -f {bad}`, then {verification.rebuild_hint(manifest)}",
        file=sys.stderr,
    )
    raise typer.Exit(DAMAGED)


def _say_not_compared(files: list[str]) -> None:
    names = list(dict.fromkeys(name.rpartition("/")[2] for name in files))
    if names:
        more = ", …" if len(names) > 8 else ""
        print(
            f"Not compared, for no manifest names them: {len(files)} files ({', '.join(names[:8])}{more})."
        )


def print_doubts(manifest: Manifest) -> None:
    """What was cut, and what is in doubt."""
    for note in manifest.notes:
        if note.startswith(("cut: ", "in doubt: ")):
            print(f"  {note}")


def _print_undefined(dataset: Path) -> None:
    """Which measures are not defined, why, and what to set."""
    from soundspaces_sim.dataset.undefined import undefined_times

    with ss.open_dataset(dataset) as ds:
        for line in undefined_times(ds, ds.table()):
            print(f"  {line}")


def table(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    out: Annotated[
        Path | None,
        typer.Option(help="File to write, .csv or .parquet; by default in the dataset's folder."),
    ] = None,
    collocated: Annotated[
        bool, typer.Option("--collocated", help="Also pairs whose source and listener are one point.")
    ] = False,
    spreads: Annotated[
        bool, typer.Option("--spreads", help="Also what measures owe to how well absorption is known.")
    ] = False,
    replace: ReplaceOption = False,
) -> None:
    """Write the table of pairs: positions, distances, room measures, error bars."""
    from soundspaces_sim.dataset.format.table import write_table

    path = output_file(out, "pairs.csv", dataset, (".csv", ".parquet"), replace)
    with ss.open_dataset(dataset) as ds:
        rows, columns = ds.table(collocated=collocated), ds.columns(spreads)
        rows = ds.with_spreads(rows) if spreads else rows
    written = write_table(rows, path, columns)
    print(f"Wrote {' and '.join(str(path) for path in written)}: {len(rows):,} pairs")
    print_doubts(ds.manifest)


NameOption = Annotated[str | None, typer.Option(help="soundspaces-v1: replica (the default) or mp3d.")]
PerOption = Annotated[
    str | None, typer.Option(help="sofa: a file per source (the default) or per listener.")
]
OrderOption = Annotated[int | None, typer.Option(help="ambisonics: 3 to 7 (the default).")]
ConventionOption = Annotated[
    str | None, typer.Option(help="ambisonics: sn3d (the default) or n3d; sofa: these and others.")
]


def export(
    layout: Annotated[str, typer.Argument(help=f"{names(EXPORTERS)}.")],
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset, or of several.")],
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("export"),
    rate: Annotated[int | None, typer.Option(help="Sampling rate, Hz.")] = None,
    name: NameOption = None,
    pairs: Annotated[
        str,
        typer.Option(help="nodes (of the navigation graph), all, or a file of lines `source listener`."),
    ] = "nodes",
    per: PerOption = None,
    heading: Annotated[
        list[float] | None,
        typer.Option(help="Heading of a head, degrees (soundspaces-v1: azimuth); may be repeated."),
    ] = None,
    ambisonics: Annotated[
        bool | None,
        typer.Option("--ambisonics/--no-ambisonics", help="The ambisonic responses as well."),
    ] = None,
    order: OrderOption = None,
    convention: ConventionOption = None,
    episodes: Annotated[
        int | None,
        typer.Option(
            help="soundspaces-v1: navigation episodes per split as well, from a folder of datasets."
        ),
    ] = None,
    hrtf: HrtfOption = None,
    renderer: RendererOption = None,
    replace: ReplaceOption = False,
) -> None:
    """Write a dataset, or every one in a folder, as others read it."""
    from soundspaces_sim.dataset.exporters.plan import check_headings

    if rate is not None:
        from soundspaces_sim.core.config import check_rate

        check_rate(rate, "--rate")
    check_folder(out)
    given = {
        "name": name,
        "per": per,
        "headings": tuple(heading) if heading else None,
        "ambisonics": ambisonics,
        "order": order,
        "convention": convention,
    }
    options = {key: value for key, value in given.items() if value is not None}
    if heading:
        check_headings(tuple(heading), "--heading")
    plan_of = find_exporter(layout, {"pairs": pairs, **options}, {"headings": "--heading"})
    if episodes is not None and layout != "soundspaces-v1":
        raise ConfigError(f"--episodes belongs to soundspaces-v1, not to {layout}")
    check_renderer_option(renderer)
    if hrtf is not None:
        rendering.load_hrtf(hrtf)
    found = list(open_found(dataset, rate, hrtf, renderer).values())
    plans = [(ds, plan_of(ds, out)) for ds in found]
    kind: Literal["replica", "mp3d"] = "mp3d" if name == "mp3d" else "replica"
    of_episodes = [] if episodes is None else [out / "datasets" / "audionav" / kind]
    ask_to_replace([*(place for _, plan in plans for place in plan.places), *of_episodes], replace)
    _carry_out(plans, out)
    if episodes is not None:
        _export_episodes(dataset, out / "datasets", kind, episodes)


def _carry_out(plans: Sequence[tuple[Any, ExportPlan]], out: Path) -> None:
    from soundspaces_sim.dataset.exporters.plan import carry_out, check_space

    size, files = sum(plan.bytes for _, plan in plans), sum(plan.files for _, plan in plans)
    console.print(f"{files:,} files, about {size_text(size)}", highlight=False)
    check_space(out, size)
    for ds, plan in plans:
        with ds, Meter(f"Writing {ds.scene}") as meter:
            count = carry_out(plan, meter.update)
        print(f"Wrote {count:,} files of {ds.scene} to {out}")


def _export_episodes(data: Path, out: Path, kind: Literal["replica", "mp3d"], count: int) -> None:
    from soundspaces_sim.nav.generate import write_splits_episodes

    with Meter("Making episodes") as meter:
        for path in write_splits_episodes(data, out, kind, count, meter.update):
            print(f"Wrote {path}")
