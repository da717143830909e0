"""`plot` and `listen`: datasets and scenes for eyes and ears (extra ``figures``)."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from soundspaces_sim.base.errors import SoundSpacesSimError
from soundspaces_sim.base.registry import names
from soundspaces_sim.cli.console import progress_bar
from soundspaces_sim.figures.registry import PAGES


def plot(
    subject: Annotated[str, typer.Argument(help="Folder of a dataset, or a scene.")],
    what: Annotated[str, typer.Option(help=f"{names(PAGES)}.")] = "map",
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
    from soundspaces_sim.figures.pages import animate_field, draw_page
    from soundspaces_sim.figures.subject import load_subject

    found = load_subject(subject, spacing)
    path = out or Path(f"{found.name}_{what}.{'gif' if animate else 'png'}")
    if animate:
        print(f"Wrote {path}: {animate_field(found, path)} sources")
        return
    figure = draw_page(found, what, source, tuple(listener or ()))
    try:
        figure.savefig(path, dpi=90, bbox_inches="tight")
    except (OSError, ValueError) as error:
        raise SoundSpacesSimError(f"{path}: cannot write this picture ({error})") from error
    print(f"Wrote {path}")


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
    with open_dataset(dataset) as ds, progress_bar() as bar:
        task = bar.add_task("Rendering", total=None, extra="")
        count = listening_folder(
            ds, out, own, lambda done, total: bar.update(task, completed=done, total=total)
        )
    print(f"Wrote {count} sounds and their spectrograms to {out}; {out}/README.txt says which is which")


def _need_matplotlib() -> None:
    if find_spec("matplotlib") is None:
        raise SoundSpacesSimError("pictures need matplotlib: `pip install soundspaces-sim[figures]`")
