"""`soundspaces-agents …`: the studies of agents that hear, and their parts: training, tests, report, replays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import (
    INTERRUPTED,
    Meter,
    RendererOption,
    check_renderer_option,
    run_app,
    shares,
)

if TYPE_CHECKING:
    from soundspaces_sim.nav import Episode

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)

_SOUND = "telephone"  # `parts.DEFAULT_SOUND`, which loads NumPy
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


@app.callback()
def studies() -> None:
    """Agents that hear: `make nav`, and its parts."""


def _three(homes: str | None) -> tuple[int, int, int] | None:
    """Numbers of homes by split. Raises `ConfigError`."""
    if homes is None:
        return None
    try:
        a, b, c = (int(word) for word in homes.split(","))
    except ValueError:
        raise ConfigError(
            f"--homes: expected three numbers with commas between, such as 8,1,4, got '{homes}'"
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
    homes: Annotated[
        str | None, typer.Option(help="Homes to train, validate and test with, e.g. 8,1,4.")
    ] = None,
) -> None:
    """Homes, datasets, views, episodes, agents, report.md; goes on where it was stopped."""
    shape = _three(homes)
    from soundspaces_agents.pipeline import run_study

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
    from soundspaces_agents import experiments, learn, presets
    from soundspaces_sim.nav import NavData

    (variant,), folder = experiments.choose_variants([kind]), out or Path("agents") / f"{kind}-{seed}"
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
        from soundspaces_agents import trained
        from soundspaces_sim import nav

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
    from soundspaces_sim.nav import evaluate

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
    to: Annotated[
        Path | None, typer.Option(help="Folder for the record, one replay and the page; default: OUT.")
    ] = None,
    about: Annotated[str, typer.Option(help="How the study was made, in a sentence.")] = "",
) -> None:
    """Write the record of what results there are, and its page, report.md."""
    from soundspaces_agents.pictures import copy_report, write_report

    if to is None:
        write_report(out, print, about)
    else:
        copy_report(out, to, print, about)


@app.command()
def page(
    record: Annotated[Path, typer.Argument(help="Record of a study, record.json.gz.")],
) -> None:
    """Write report.md and the learning curves of a record beside it; no datasets are needed."""
    from soundspaces_agents.pictures import write_page

    write_page(record, print)


@app.command()
@shares(_EvaluationOptions)
def replay(
    options: _EvaluationOptions,
    count: Annotated[int, typer.Option(help="How many episodes, from the first.")] = 1,
    max_steps: StepsOption = 100,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("replays"),
) -> None:
    """Write episodes as a GIF of the map and a WAV of what is heard."""
    from soundspaces_agents.pictures import write_replay

    actor, env, chosen = options.open(count, max_steps)
    for k, episode in enumerate(chosen[:count]):
        done = write_replay(actor, env, episode, out, f"{actor.name}-{episode.scene}-{k}", options.seed)
        print(f"Wrote {done.gif}, {done.wav.name}: {'' if done.metrics.success else 'not '}reached")


@app.command()
def continuous(
    data: DataArgument,
    out: Annotated[Path, typer.Option(help="Folder of the study.")] = Path("out/continuous-study"),
    seeds: Annotated[int, typer.Option(help="Runs of training per kind of ears.", min=1)] = 3,
    episodes: Annotated[int, typer.Option(help="Test episodes per scene.", min=1)] = 12,
) -> None:
    """Train and test agents in continuous space; goes on where it was stopped."""
    from soundspaces_agents.continuous_report import run_continuous_study

    try:
        path = run_continuous_study(data, out, seeds, episodes, lambda line: print(line, flush=True))
    except KeyboardInterrupt:
        print(f"Interrupted: what is finished is safe in {out}; run the same command to go on")
        raise typer.Exit(INTERRUPTED) from None
    print(f"Wrote {path}")


@app.command(name="continuous-ppo")
def continuous_ppo(
    data: DataArgument,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/continuous-ppo"),
    steps: Annotated[int, typer.Option(help="Steps of training.", min=1)] = 300_000,
    seed: SeedOption = 0,
) -> None:
    """Train with PPO of Stable-Baselines3 in continuous space, and test against the follower of sound."""
    from soundspaces_agents.learn.continuous_ppo import SbConfig, run_sb3

    config = SbConfig(steps=steps)
    print(f"Wrote {run_sb3(data, out, config, seed, lambda line: print(line, flush=True))}")


@app.command()
def homes(
    names: Annotated[list[str], typer.Argument(help="home-<number>.")],
    config: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/homes"),
    jobs: JobsOption = None,
) -> None:
    """Datasets of homes as studies have them: of the largest piece of floor that one can walk about in."""
    from soundspaces_agents.pipeline import build_home
    from soundspaces_sim import JobConfig, load_config

    settings = JobConfig() if config is None else load_config(config)
    for name in names:
        print(f"Wrote {build_home(name, out, settings, jobs)}")


def main() -> None:
    """Entry point."""
    run_app(app)


if __name__ == "__main__":
    main()
