"""`soundspaces-sim cite` and `pack`: what to cite for a dataset, and one archive of it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from soundspaces_exports.citation import citation
from soundspaces_exports.pack import archive_path, existing, pack_dataset
from soundspaces_sim.parts import Meter, size_text

cite_app, pack_app = (typer.Typer(add_completion=False, pretty_exceptions_enable=False) for _ in "ab")


@cite_app.command()
def cite(dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")]) -> None:
    """Print BibTeX of what a dataset rests on: methods, standards, measured sets."""
    print(citation(dataset), end="")


@pack_app.command()
def pack(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    out: Annotated[
        Path | None, typer.Option(help="Archive to write; by default the folder's name with .zip.")
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace an archive that is there, without asking.")
    ] = False,
) -> None:
    """Pack a dataset into one archive with its checksum, for a repository such as Zenodo."""
    taken = existing(archive_path(dataset, out))
    if taken and not replace and sys.stdin.isatty():
        replace = typer.confirm(f"Replace {' and '.join(map(str, taken))}?", abort=True, err=True)
    with Meter("Packing") as meter:
        path = pack_dataset(dataset, out, meter.update, replace)
    print(f"Wrote {path} ({size_text(path.stat().st_size)}) and {path.name}.sha256")
