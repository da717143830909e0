"""`soundspaces-sim plot`, `listen` and `report`: datasets and scenes for eyes and ears."""

from __future__ import annotations

import dataclasses
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from soundspaces_parameters.commands import NoiseOption, SpeechOption, speech_of
from soundspaces_parameters.registry import check_parameters

import soundspaces_pictures as viz
import soundspaces_sim as ss
from soundspaces_pictures.registry import PAGES, check_width
from soundspaces_sim import ConfigError, SoundSpacesSimError
from soundspaces_sim.parts import (
    DAMAGED,
    HrtfOption,
    Meter,
    RendererOption,
    ReplaceOption,
    TableEntry as Entry,
    check_entry_name as check_name,
    check_file_option as check_file,
    check_renderer_option,
    entry_names as names,
    install_hint,
    of_neighbour,
    output_file,
    output_folder,
)

_HTML = (".html", ".htm")
_RECEIVER_PAGE = Entry(
    "soundspaces_receiver_page:write_receiver_report",
    "a page on one receiver",
    "parameters renderers pictures receiver_page",
)


def need_matplotlib() -> None:
    """Raise `SoundSpacesSimError`, before any work, without what draws."""
    if find_spec("matplotlib") is None or find_spec("jinja2") is None:
        raise SoundSpacesSimError(f"pictures need matplotlib and jinja2: {install_hint('figures')}")


def plot(
    subject: Annotated[str, typer.Argument(help="Folder of a dataset, or a scene.")],
    what: Annotated[
        str | None, typer.Option(help=f"{names(PAGES)}; by default map, with --animate field.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="File to write, .png, .svg or .pdf; with --animate .gif. By default in the dataset's folder."
        ),
    ] = None,
    source: Annotated[int | None, typer.Option(help="Point of the source.")] = None,
    listener: Annotated[
        list[int] | None, typer.Option(help="Point of a listener; may be repeated.")
    ] = None,
    spacing: Annotated[float | None, typer.Option(help="Grid spacing of a scene, m.")] = None,
    animate: Annotated[bool, typer.Option("--animate", help="field: a GIF over sources.")] = False,
    parameter: Annotated[
        str | None, typer.Option(help="parameter: which one, as in c80, lf or sti; by default t30.")
    ] = None,
    band: Annotated[
        float | None,
        typer.Option(help="parameter: the octave's midband frequency, Hz; by default 1000."),
    ] = None,
    frequency: Annotated[
        float | None,
        typer.Option(help="modes: which frequency, Hz; by default that of the strongest mode."),
    ] = None,
    printed: Annotated[
        str | None,
        typer.Option("--print", help="For a journal: as wide as a column (8.4 cm) or a page (17.4 cm)."),
    ] = None,
    replace: ReplaceOption = False,
) -> None:
    """Draw a picture of a dataset or a scene."""
    page = what or ("field" if animate else "map" if parameter is None else "parameter")
    check_name("--what", PAGES, page)
    if animate and page != "field":
        raise ConfigError(f"--animate: only --what field can be animated, got --what {page}")
    if animate and source is not None:
        raise ConfigError(f"--source {source}: --animate moves the source itself")
    _check_page(page, parameter, band, frequency)
    kind = "gif" if animate else "pdf" if printed else "png"
    endings = (".gif",) if animate else (".png", ".svg", ".pdf")
    if out is not None:
        check_file(out, endings)
    if printed is not None:
        check_width(printed, "--print")
    need_matplotlib()
    from soundspaces_pictures import pages
    from soundspaces_pictures.plot_data import load_plot_data

    found = load_plot_data(subject, spacing)
    parameter, band = parameter or found.parameter, band or found.band_hz
    found = dataclasses.replace(found, parameter=parameter, band_hz=band, frequency_hz=frequency)
    path = output_file(out, f"{found.name}_{page}.{kind}", found.path, endings, replace)
    if animate:
        print(f"Wrote {path}: {pages.animate_field(found, path)} sources")
        return
    figure = pages.draw_page(found, page, source, tuple(listener or ()))
    _save(figure, path, printed)
    print(f"Wrote {path}")


def _check_page(page: str, parameter: str | None, band: float | None, frequency: float | None) -> None:
    """Raise `ConfigError` for options of other pages."""
    if page != "parameter" and (parameter is not None or band is not None):
        raise ConfigError(f"--parameter and --band belong to --what parameter, not to {page}")
    if page != "modes" and frequency is not None:
        raise ConfigError(f"--frequency belongs to --what modes, not to {page}")
    check_parameters(parameter)


def _save(figure: Any, path: Path, printed: str | None) -> None:
    """Write a picture for the screen, or for print; its caption is then printed."""
    if printed is not None:
        print(f"Caption: {viz.save_printed(figure, path, printed)}")
        return
    try:
        figure.savefig(path, dpi=90, bbox_inches="tight")
    except (OSError, ValueError) as error:
        raise SoundSpacesSimError(f"{path}: cannot write this picture ({error})") from error


def listen(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("listening"),
    speech: Annotated[Path | None, typer.Option(help="A recording instead of made syllables.")] = None,
    clap: Annotated[Path | None, typer.Option(help="A recording instead of a made clap.")] = None,
    music: Annotated[Path | None, typer.Option(help="A recording instead of made strings.")] = None,
    hrtf: HrtfOption = None,
    renderer: RendererOption = None,
    replace: ReplaceOption = False,
) -> None:
    """Write sounds at three places and four headings, mono beside binaural, with spectrograms."""
    need_matplotlib()
    own = {k: v for k, v in (("speech", speech), ("clap", clap), ("music", music)) if v is not None}
    check_renderer_option(renderer)
    output_folder(out, replace)
    with ss.open_dataset(dataset, None, hrtf, renderer) as ds, Meter("Rendering") as meter:
        count = viz.listening_folder(ds, out, own, meter.update)
    print(f"Wrote {count} sounds and their spectrograms to {out}; {out}/README.txt says which is which")


def report(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    out: Annotated[
        Path | None,
        typer.Option(help="HTML file to write; by default report.html in the dataset's folder."),
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="Compare every byte first (SHA-256).")] = False,
    hrtf: HrtfOption = None,
    receiver: Annotated[
        int | None, typer.Option(help="A page on this point alone: parameters, curves, reflections.")
    ] = None,
    source: Annotated[int | None, typer.Option(help="--receiver: point of the source.")] = None,
    speech_level: SpeechOption = 60.0,
    noise: NoiseOption = None,
    replace: ReplaceOption = False,
) -> None:
    """Write one HTML page on a dataset for the lab that receives it, or on one receiver."""
    need_matplotlib()
    if receiver is not None:
        _report_receiver(dataset, out, hrtf, receiver, source, speech_of(speech_level, noise), replace)
        return
    if source is not None:
        raise ConfigError(f"--source {source} belongs to --receiver")
    path = output_file(out, "report.html", dataset, _HTML, replace)
    with Meter("Writing the report") as meter:
        problems = viz.write_report(dataset, path, full, hrtf, meter.update)
    print(f"Wrote {path}")
    if problems:
        for line in problems:
            print(line, file=sys.stderr)
        raise typer.Exit(DAMAGED)


def _report_receiver(
    dataset: Path,
    out: Path | None,
    hrtf: Path | None,
    receiver: int,
    source: int | None,
    speech: Any,
    replace: bool,
) -> None:
    if out is not None:
        check_file(out, _HTML)
    write = of_neighbour("report --receiver", _RECEIVER_PAGE)
    with ss.open_dataset(dataset, hrtf=hrtf) as ds:
        chosen = source
        if chosen is None:
            subject = viz.dataset_subject(ds)
            chosen = viz.default_source(subject)
        if chosen == receiver and source is None:
            raise ConfigError(f"--receiver {receiver} is the default source: name another with --source")
        path = output_file(out, f"receiver_{receiver}_source_{chosen}.html", dataset, _HTML, replace)
        write(ds, chosen, receiver, path, speech)
    print(f"Wrote {path}")


plot_app, listen_app, report_app = (
    typer.Typer(add_completion=False, pretty_exceptions_enable=False) for _ in range(3)
)
plot_app.command()(plot)
listen_app.command()(listen)
report_app.command()(report)
