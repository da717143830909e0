"""`nav …`: what agents that hear are trained and tested with: episodes, what is heard and seen, sounds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from soundspaces_sim.cli.console import Meter
from soundspaces_sim.cli.options import ReplaceOption, ask_to_replace
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.extras import need
from soundspaces_sim.core.io.files import make_folder, publish

app = typer.Typer(no_args_is_help=True, help="Episodes and sounds for agents that hear.")

_SOUND = "telephone"  # `nav.sounds.DEFAULT`, which loads NumPy
DataArgument = Annotated[Path, typer.Argument(help="Folder of datasets, with splits.toml.")]
EpisodesOption = Annotated[
    Path | None,
    typer.Option("--episodes", help="Folder or file of a split of episodes; else they are drawn."),
]
SplitOption = Annotated[str, typer.Option("--split", help="Split of splits.toml.")]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed.")]


@app.command()
def episodes(
    data: DataArgument,
    count: Annotated[int, typer.Option(help="How many.")] = 1000,
    split: SplitOption = "train",
    seed: SeedOption = 0,
    sounds: Annotated[
        str, typer.Option(help="Names with commas between, or a split of the bank.")
    ] = _SOUND,
    layout: Annotated[
        str, typer.Option(help="replica or mp3d: names of scenes, height of the camera.")
    ] = "replica",
    goals: Annotated[
        int | None, typer.Option(help="Points per scene where sounds stand; default: all.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write <layout>/v1/<split> to.")] = Path(
        "datasets/audionav"
    ),
    replace: ReplaceOption = False,
) -> None:
    """Make episodes in SoundSpaces' and Habitat's format."""
    need("this command", "nav")
    from soundspaces_sim import nav
    from soundspaces_sim.dataset.exporters.points import HABITAT_HEIGHT

    if layout not in HABITAT_HEIGHT:
        raise ConfigError(f"--layout: expected {' or '.join(HABITAT_HEIGHT)}, got '{layout}'")
    folder = out / layout / "v1" / split
    ask_to_replace([folder], replace)
    found = nav.NavData(data)
    bank = nav.SoundBank(found.dataset(found.scenes(split)[0]).rate)
    names = bank.splits.get(sounds, tuple(sounds.split(",")))
    with Meter("Making episodes") as meter:
        made = nav.make_episodes(
            found,
            split,
            count,
            seed,
            sounds=names,
            bank=bank,
            goals=goals,
            layout=layout,  # type: ignore[arg-type]
            progress=meter.update,
        )
    path = nav.write_episodes(made, folder)
    print(f"Wrote {path}: {len(made):,} episodes in {len({e.scene for e in made})} scenes")


@app.command()
def bake(
    data: DataArgument,
    sound: Annotated[
        list[str] | None, typer.Option(help=f"A sound; may be repeated. Default: {_SOUND}.")
    ] = None,
    episodes: EpisodesOption = None,
    views: Annotated[bool, typer.Option("--views/--no-views", help="Draw depth pictures.")] = True,
) -> None:
    """Write views.h5, and what is heard of sounds at the episodes' goals, beside every dataset."""
    need("this command", "nav")
    from soundspaces_sim import nav

    found = nav.NavData(data)
    wanted: dict[str, set[int]] = {
        scene: set(found.graph(scene).nodes.tolist()) for scene in found.names
    }
    if episodes is not None:
        wanted = {}
        for episode in nav.read_episodes(episodes, found):
            wanted.setdefault(episode.scene, set()).add(episode.goal)
    for scene, goals in wanted.items():
        ds = found.dataset(scene)
        with Meter(f"Baking {scene}") as meter:
            if views:
                nav.bake_views(ds, progress=meter.update)
            bank = nav.SoundBank(ds.rate)
            for name in sound or [_SOUND]:
                meter.stage(f"Hearing {name} in {scene}")
                nav.bake_sound(ds, bank, name, sorted(goals), meter.update)
    print(f"Baked {len(wanted)} scenes in {data}")


@app.command()
def sounds(
    folder: Annotated[
        Path | None, typer.Argument(help="Folder of WAV or FLAC files; default: formulas.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write them to, to listen.")] = None,
    replace: ReplaceOption = False,
) -> None:
    """List the bank of sounds by split."""
    from soundspaces_sim import nav
    from soundspaces_sim.dataset.exporters.wav import wav_bytes

    bank = nav.SoundBank(16000, folder)
    for split, names in bank.splits.items():
        print(f"{split} ({len(names)}): {', '.join(names)}")
    if out is not None:
        ask_to_replace([out / f"{name}.wav" for name in bank], replace)
        make_folder(out)
        for name in bank:
            sound = bank[name]
            publish(out / f"{name}.wav", wav_bytes(0.9 * sound[None] / abs(sound).max(), bank.rate))
