"""Options that several commands have, once: how a scene is read, and how datasets are opened and heard."""

from __future__ import annotations

import inspect
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.core.numerics.bands import named_edges
from soundspaces_sim.core.profile import profiled
from soundspaces_sim.core.registry import check_name, names
from soundspaces_sim.rendering.renderers import RENDERERS

if TYPE_CHECKING:
    import numpy as np

    from soundspaces_sim.core.config import JobConfig


_log = logging.getLogger("soundspaces_sim.cli")

Read = Callable[[], Any]  # -> Scene
ProfileOption = Annotated[
    bool,
    typer.Option("--profile", help="Print where processor time and memory went, stage by stage."),
]
HrtfOption = Annotated[Path | None, typer.Option(help="SOFA file of the ears; MIT's KEMAR by default.")]
RendererOption = Annotated[
    str | None, typer.Option(help=f"{names(RENDERERS)}; as the dataset has it by default.")
]

ReplaceOption = Annotated[
    bool, typer.Option("--replace", help="Write over files that are there, without asking.")
]


def check_renderer_option(renderer: str | None) -> None:
    """Raise `ConfigError`, which blames the flag, for a name that is none."""
    if renderer is not None:
        check_name("--renderer", RENDERERS, renderer)


def check_folder(out: Path, flag: str = "--out") -> None:
    """Raise `ConfigError`, before any work, unless this is a folder that can be written to, or be made."""
    from soundspaces_sim.dataset.format.manifest import is_dataset

    place = out.absolute()
    while not (place.exists() or place.is_symlink()):
        place = place.parent
    if not place.is_dir():
        raise ConfigError(f"{flag} {out}: expected a folder, but {place} is none; choose another")
    if not os.access(place, os.W_OK | os.X_OK):
        raise ConfigError(f"{flag} {out}: {place} cannot be written to; choose another folder")
    for folder in (out.absolute(), out.absolute().parent):
        if is_dataset(folder):
            raise ConfigError(
                f"{flag} {out}: {folder} is a dataset, which holds nothing else; choose another folder"
            )


def check_file(out: Path, endings: tuple[str, ...]) -> None:
    """Raise `ConfigError`, before any work, unless a file of this name can be written."""
    if out.suffix.lower() not in endings:
        raise ConfigError(f"--out {out}: expected a name that ends in {', '.join(endings)}")
    if out.is_dir():
        raise ConfigError(f"--out {out}: expected a file, but this is a folder")
    if not out.absolute().parent.is_dir():
        raise ConfigError(f"--out {out}: there is no folder {out.parent}")
    if not os.access(out if out.exists() else out.absolute().parent, os.W_OK):
        raise ConfigError(f"--out {out}: this cannot be written to; choose another place")


def output_file(
    out: Path | None, name: str, dataset: Path | None, endings: tuple[str, ...], replace: bool
) -> Path:
    """The file of a command: `out`, or `name` in the dataset's folder or, of a scene, in the current one. One that
    is there is replaced with `replace`, or if the user says so. Raises `ConfigError`, before any work."""
    path = out or (dataset or Path()) / name
    check_file(path, endings)
    ask_to_replace([path], replace)
    return path


def output_folder(out: Path, replace: bool, flag: str = "--out") -> None:
    """As `output_file`, of a folder whose files are all the command's."""
    check_folder(out, flag)
    ask_to_replace([out], replace, flag)


def ask_to_replace(places: Sequence[Path], replace: bool, flag: str = "--out") -> None:
    """Raise `ConfigError` if files, or folders with anything in them, are there, unless `replace`, or the user
    says so."""
    there = [p for p in places if (any(p.iterdir()) if p.is_dir() else os.path.lexists(p))]
    if not there or replace:
        return
    more = f" and {len(there) - 1} more" if len(there) > 1 else ""
    if not sys.stdin.isatty():
        raise ConfigError(
            f"{flag} {there[0]}{more}: this is there already; give --replace, or another name"
        )
    typer.confirm(f"Write over {there[0]}{more}?", abort=True, err=True)


def open_found(
    folder: Path, rate: int | None, hrtf: Path | None = None, renderer: str | None = None
) -> dict[str, Any]:
    """The dataset in a folder by its scene's name, or those in the folders in it by theirs. Raises
    `DatasetError`."""
    from soundspaces_sim.dataset.format.manifest import NAME

    if not (folder / NAME).exists():
        return dict(ss.open_datasets(folder, rate, hrtf, renderer))
    ds = ss.open_dataset(folder, rate, hrtf, renderer)
    return {ds.scene: ds}


@contextmanager
def reported(command: str, wanted: bool) -> Iterator[None]:
    """Collect where the time of a command goes; log it at its end, and print it if `wanted`."""
    with profiled(command) as found:
        yield
    _log.debug("Profile", extra={"event": {"profile": found.stage.as_dict()}})
    if wanted:
        print(found.stage)


ReadOne = Callable[[str], Any]  # name -> Scene


def _how_to_load(
    scene: Annotated[str, typer.Argument(help="Built-in name, scene folder or mesh file.")],
    *,
    materials: Annotated[Path | None, typer.Option(help="TOML file of materials.")] = None,
    labels: Annotated[Path | None, typer.Option(help="TOML file of materials per label.")] = None,
    up: Annotated[str | None, typer.Option(help="Up axis of the file: y or z.")] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of the file: m, cm, mm, in, ft.")] = None,
    strict_materials: Annotated[
        bool, typer.Option("--strict-materials", help="A label without a material is an error.")
    ] = False,
    ceiling: Annotated[
        bool | None,
        typer.Option(
            "--ceiling/--no-ceiling",
            help="Add a synthetic ceiling over rooms without one; by default where it is missing.",
        ),
    ] = None,
    decimate: Annotated[float | None, typer.Option(help="Share of the faces to keep.")] = None,
) -> None:
    """What `load_scene` is told: its parameters, as typer reads them."""


def takes_scenes(command: Callable[..., None]) -> Callable[..., None]:
    """As `takes_scene`, of one or more scenes, or folders of scenes: its own first parameters are their names
    and a function that reads the scene of a name."""
    scenes = inspect.Parameter(
        "scenes",
        inspect.Parameter.POSITIONAL_OR_KEYWORD,
        annotation=Annotated[
            list[str],
            typer.Argument(help="Built-in names, scene folders, mesh files, or folders of scenes."),
        ],
    )
    return _taking(command, scenes)


def takes_scene(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of `_how_to_load`. Its own first parameters are the scene's name and a function
    that reads the scene as the options say."""
    first = next(iter(inspect.signature(_how_to_load, eval_str=True).parameters.values()))
    return _taking(command, first)


def _taking(command: Callable[..., None], argument: inspect.Parameter) -> Callable[..., None]:
    how = list(inspect.signature(_how_to_load, eval_str=True).parameters.values())[1:]
    own = list(inspect.signature(command, eval_str=True).parameters.values())[2:]

    @wraps(command)
    def run(**given: Any) -> None:
        chosen = {p.name: given.pop(p.name) for p in how}
        names = given.pop(argument.name)
        if isinstance(names, str):
            command(names, partial(ss.load_scene, names, **chosen), **given)
        else:
            command(names, partial(ss.load_scene, **chosen), **given)

    return _signed(run, [argument, *map(_keyword, own), *how])


def shares(record: Callable[..., Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the parameters of a record of options; its own first parameter is the record."""
    common = list(inspect.signature(record, eval_str=True).parameters.values())

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = list(inspect.signature(command, eval_str=True).parameters.values())[1:]

        @wraps(command)
        def run(**given: Any) -> None:
            command(record(**{p.name: given.pop(p.name) for p in common}), **given)

        return _signed(run, [*common, *map(_keyword, own)])

    return decorate


def _keyword(parameter: inspect.Parameter) -> inspect.Parameter:
    return parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)


def _signed(run: Callable[..., None], parameters: list[inspect.Parameter]) -> Callable[..., None]:
    """The function with the parameters that typer reads."""
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    return run


BandsOption = Annotated[
    str | None,
    typer.Option(help="Bands: paper, octaves, thirds, or their edges in Hz with commas between them."),
]


MaterialsOnReadingOption = Annotated[
    bool,
    typer.Option(
        "--materials-on-reading",
        help="Count reflections, so that other absorption can be chosen on reading: 2.3 to 3.5 times the time and "
        "about 2.6 times the bytes.",
    ),
]


def read_bands(asked: str | None) -> tuple[float, ...] | None:
    """Edges of `BandsOption`, Hz. Raises `ConfigError`."""
    try:
        return None if asked is None else named_edges(asked)
    except ConfigError as error:
        raise ConfigError(f"--bands {asked}: {error}") from None


def read_settings(config: Path | None, flags: Mapping[str, tuple[str, str, Any]]) -> JobConfig:
    """The config file's settings under those of flags (stage, name, value). Raises `ConfigError`, which
    names the file if the file is wrong, and the flag if a flag is."""
    flags = {flag: what for flag, what in flags.items() if what[2] is not None}
    path = config or resource("pipelines", "default.toml")
    settings = ss.load_config(path)
    overrides: dict[str, dict[str, Any]] = {}
    for flag, (stage, name, value) in flags.items():
        overrides.setdefault(stage, {})[name] = value
        try:
            settings = ss.load_config(path, **overrides)
        except ConfigError as error:
            raise ConfigError(f"{flag} {value}: {error}") from error
    return settings


def read_places(path: Path | None, settings: JobConfig) -> np.ndarray | None:
    """Points (N, 3) m that take the place of a grid, from a points.txt or a graph.pkl; None: a grid it is."""
    from soundspaces_sim.dataset.exporters.points import read_points

    if path is None:
        return None
    places = read_points(path)
    if path.suffix == ".pkl":
        places[:, 2] += settings.grid.height  # a graph's nodes lie on the floor
    return places
