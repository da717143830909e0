"""`nav …`: agents that hear: episodes, baking, training, evaluation, report, replay."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import soundspaces_sim as ss
from soundspaces_sim.cli.console import INTERRUPTED, Meter
from soundspaces_sim.cli.options import RendererOption, check_renderer_option, shares
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.extras import need
from soundspaces_sim.core.io.files import make_folder, publish

if TYPE_CHECKING:
    from soundspaces_sim.nav.episodes import Episode

app = typer.Typer(no_args_is_help=True, help="Agents that hear: make nav, and its parts.")

_SOUND = "telephone"  # `nav.sounds.DEFAULT`, which loads NumPy
DataArgument = Annotated[Path, typer.Argument(help="Folder of datasets, with splits.toml.")]
EpisodesOption = Annotated[
    Path | None,
    typer.Option("--episodes", help="Folder or file of a split of episodes; else they are drawn."),
]
SplitOption = Annotated[str, typer.Option("--split", help="Split of splits.toml.")]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed.")]
AgentOption = Annotated[
    str, typer.Option("--agent", help="A baseline's name, or a trained agent's checkpoint.")
]
JobsOption = Annotated[int | None, typer.Option("--jobs", help="Processes; default: all cores.")]
StepsOption = Annotated[int, typer.Option("--max-steps", help="Actions after which an episode ends.")]


def need_extras(*extras: str) -> None:
    """Raise `MissingExtraError` unless the packages of these extras are there."""
    need("this command", *extras)


def _three(flats: str | None) -> tuple[int, int, int] | None:
    """Numbers of flats by split. Raises `ConfigError`."""
    if flats is None:
        return None
    try:
        a, b, c = (int(word) for word in flats.split(","))
    except ValueError:
        raise ConfigError(
            f"--flats: expected three numbers with commas between, such as 8,1,4, got '{flats}'"
        ) from None
    return a, b, c


@app.command()
def run(
    preset: Annotated[str, typer.Option(help="quick, small or paper.")] = "small",
    out: Annotated[Path, typer.Option(help="Folder of the study.")] = Path("out/nav"),
    seeds: Annotated[int, typer.Option(help="Runs of training per kind of agent.")] = 1,
    jobs: JobsOption = None,
    agents: Annotated[str | None, typer.Option(help="Some kinds alone, e.g. AG,PG.")] = None,
    updates: Annotated[int | None, typer.Option(help="Shorter (or longer) training.")] = None,
    flats: Annotated[
        str | None, typer.Option(help="Flats to train, validate and test with, e.g. 8,1,4.")
    ] = None,
) -> None:
    """Flats, datasets, views, episodes, agents, report.md; goes on where it was stopped."""
    shape = _three(flats)
    from soundspaces_sim.nav.pipeline import run_study

    kinds = agents.split(",") if agents else None
    try:
        run_study(
            preset,
            out,
            seeds,
            jobs,
            kinds,
            updates,
            lambda line: print(line, flush=True),
            shape,
        )
    except KeyboardInterrupt:
        print(f"Interrupted: what is finished is safe in {out}; run the same command to go on")
        raise typer.Exit(INTERRUPTED) from None


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
) -> None:
    """Make episodes in SoundSpaces' and Habitat's format."""
    need_extras("nav")
    from soundspaces_sim import nav
    from soundspaces_sim.dataset.exporters.points import HABITAT_HEIGHT

    if layout not in HABITAT_HEIGHT:
        raise ConfigError(f"--layout: expected {' or '.join(HABITAT_HEIGHT)}, got '{layout}'")
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
    path = nav.write_episodes(made, out / layout / "v1" / split)
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
    need_extras("nav")
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
def train(
    data: DataArgument,
    kind: Annotated[
        str, typer.Option("--agent", help="A kind of agent: AG, PG, APG, AG-blind, …")
    ] = "AG",
    preset: Annotated[str, typer.Option(help="quick, small or paper.")] = "small",
    method: Annotated[str | None, typer.Option(help="ppo or dagger; default: the agent's.")] = None,
    start: Annotated[Path | None, typer.Option(help="A checkpoint to begin from.")] = None,
    sounds: Annotated[str, typer.Option(help="A sound, or a split of the bank.")] = _SOUND,
    episodes: EpisodesOption = None,
    seed: SeedOption = 0,
    updates: Annotated[int | None, typer.Option(help="Shorter (or longer) training.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder; default: agents/<agent>-<seed>.")] = None,
    device: Annotated[str, typer.Option(help="Where PyTorch computes: cpu, cuda, …")] = "cpu",
) -> None:
    """Train an agent; goes on where it was stopped."""
    from soundspaces_sim.nav import NavData, experiments, learn, presets

    (variant,), folder = experiments.choose_variants([kind]), out or Path("agents") / f"{kind}-{seed}"
    need_extras("nav", "train")
    begin = str(start) if start is not None else None
    by: Any = method or variant.method
    task = learn.Run(variant.name, variant.task, variant.sensors, by, sounds, variant.ears, begin)
    with Meter(f"Training {kind}") as meter:

        def report(row: dict[str, Any]) -> None:
            meter.update(
                row["update"],
                row["updates"],
                f"{row['steps_per_s']:,.0f} steps/s, {row['episodes'] / row['seconds']:.1f} episodes/s, "
                f"success {row['success']:.2f}, SPL {row['spl']:.2f}",
            )

        try:
            heard = NavData(data, experiments.ACOUSTICS[variant.acoustics].renderer)
            config = learn.shortened(presets.preset(preset), updates)
            path = learn.train_agent(task, config, heard, folder, seed, episodes, report, device)
        except KeyboardInterrupt:
            print(f"Interrupted: the last checkpoint is safe in {folder}; run the same command to go on")
            raise typer.Exit(INTERRUPTED) from None
    print(f"Wrote {path}")


@dataclass(frozen=True)
class _EvaluationOptions:
    """Options of `eval` and `replay`: the agent, and the episodes it is tested in."""

    data: DataArgument
    agent: AgentOption = "EarFollower"
    episodes: EpisodesOption = None
    split: SplitOption = "train"
    renderer: RendererOption = None
    seed: SeedOption = 0

    def open(self, count: int, max_steps: int, sigma: float = 0.0) -> tuple[Any, Any, list[Episode]]:
        """(agent, environment with the sensors that it needs, episodes)."""
        from soundspaces_sim import nav
        from soundspaces_sim.nav import trained

        check_renderer_option(self.renderer)
        data = nav.NavData(self.data, self.renderer)
        agent, sensors, depth_size = trained.make_agent(self.agent, "--agent")
        chosen = (
            nav.read_episodes(self.episodes, data)
            if self.episodes
            else nav.make_episodes(data, self.split, count, self.seed)
        )
        env = nav.AudioNavEnv(
            data,
            split=self.split,
            episodes=chosen,
            sensors=sensors,
            depth_size=depth_size,
            max_steps=max_steps,
            gps_sigma=sigma,
        )
        return agent, env, chosen


@app.command(name="eval")
@shares(_EvaluationOptions)
def evaluate_command(
    options: _EvaluationOptions,
    count: Annotated[int, typer.Option(help="Episodes to draw if no file is given.")] = 200,
    max_steps: StepsOption = 500,
    gps_sigma: Annotated[float, typer.Option(help="Noise of the GPS, m.")] = 0.0,
    out: Annotated[Path | None, typer.Option(help="JSON file for rows.")] = None,
) -> None:
    """Test an agent: every measure with its 95 % interval."""
    need_extras("nav")
    from soundspaces_sim.nav.evaluate import evaluate

    actor, env, chosen = options.open(count, max_steps, gps_sigma)
    with Meter("Walking") as meter:
        result = evaluate(
            actor,
            env,
            chosen,
            options.seed,
            lambda r: meter.update(
                int(r["episodes"]),
                len(chosen),
                f"{r['per_s']:.1f} episodes/s, success {r['success']:.2f}, SPL {r['spl']:.2f}",
            ),
        )
    print(f"{actor.name}, {len(chosen)} episodes")
    for name, interval in result.summary().items():
        print(f"  {name:<28s}{interval}")
    if out is not None:
        result.save(out)


@app.command()
def report(
    out: Annotated[Path, typer.Argument(help="Folder of a study.")] = Path("out/nav"),
) -> None:
    """Write report.md of what results there are."""
    need_extras("nav", "figures")
    from soundspaces_sim.nav.pictures import write_report

    write_report(out, print)


@app.command()
@shares(_EvaluationOptions)
def replay(
    options: _EvaluationOptions,
    count: Annotated[int, typer.Option(help="How many episodes, from the first.")] = 1,
    max_steps: StepsOption = 100,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("replays"),
) -> None:
    """Write episodes as a GIF of the map and a WAV of what is heard."""
    need_extras("nav", "figures")
    from soundspaces_sim.nav.pictures import write_replay

    actor, env, chosen = options.open(count, max_steps)
    for k, episode in enumerate(chosen[:count]):
        done = write_replay(actor, env, episode, out, f"{actor.name}-{episode.scene}-{k}", options.seed)
        print(f"Wrote {done.gif}, {done.wav.name}: {'' if done.metrics.success else 'not '}reached")


@app.command()
def sounds(
    folder: Annotated[
        Path | None, typer.Argument(help="Folder of WAV or FLAC files; default: formulas.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write them to, to listen.")] = None,
) -> None:
    """List the bank of sounds by split."""
    from soundspaces_sim import nav
    from soundspaces_sim.dataset.exporters.wav import wav_bytes

    bank = nav.SoundBank(16000, folder)
    for split, names in bank.splits.items():
        print(f"{split} ({len(names)}): {', '.join(names)}")
    if out is not None:
        make_folder(out)
        for name in bank:
            sound = bank[name]
            publish(out / f"{name}.wav", wav_bytes(0.9 * sound[None] / abs(sound).max(), bank.rate))


@app.command()
def flats(
    count: Annotated[int, typer.Option(help="How many.", min=1, max=100)] = 30,
    first: Annotated[int, typer.Option(help="Number of the first.")] = 0,
    out: Annotated[Path, typer.Option(help="PNG to write.")] = Path("flats.png"),
) -> None:
    """Draw the scenes flat-<number>, furnished flats made by code, from above."""
    need_extras("figures")
    from soundspaces_sim.viz.axonometric import write_gallery

    write_gallery([ss.load_scene(f"flat-{k}") for k in range(first, first + count)], out)
    print(f"Wrote {out}")
