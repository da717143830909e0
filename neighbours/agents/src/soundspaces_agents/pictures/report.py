"""The report of a study: what was run, tables with intervals, the paper's orderings, curves, maps, replays."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from soundspaces_agents.experiments import (
    ACOUSTICS,
    HEARD,
    IN,
    NOISY,
    PLAIN,
    SIGMAS,
    UNHEARD,
    VARIANTS,
    Condition,
    Trial,
    Variant,
    claims,
)
from soundspaces_agents.learn import run_files
from soundspaces_agents.pictures.curves import curves_of, draw_curves
from soundspaces_agents.pictures.impact import write_impact
from soundspaces_agents.pictures.order import in_turn
from soundspaces_agents.pictures.provenance import data_lines
from soundspaces_agents.pictures.replay import write_replay
from soundspaces_agents.presets import preset
from soundspaces_agents.study import (
    Log,
    RunSpec,
    Study,
    agent_folder,
    load_results,
    open_test,
    read_specs,
)
from soundspaces_sim.nav import NavData, Result
from soundspaces_sim.parts import Interval, draw_trail
from soundspaces_sim.parts import merge_results as merge
from soundspaces_sim.parts import publish_file as publish

matplotlib.use("Agg")
Results = dict[tuple[str, Condition], Result]


def write_replays(plan: Study, out: Path, variants: Sequence[Variant], log: Log) -> None:
    """GIF and WAV of the first arm's first seed on some test episodes of different flats."""
    folder = out / "replays"
    if not variants or len(list(folder.glob("*.gif"))) >= plan.replays:
        return
    condition = HEARD if variants[0].varied else PLAIN
    agent, env, episodes = open_test(plan, out, Trial(variants[0].name, 0, condition))
    for k, episode in enumerate(in_turn(episodes)[: plan.replays]):
        replay = write_replay(agent, env, episode, folder, f"{variants[0].name}-{k}")
        m = replay.metrics
        log(f"replay {replay.gif.name}: {'' if m.success else 'not '}reached, SPL {m.spl:.2f}")


def write_report(out: Path, log: Log) -> Path:
    """`report.md` of what results there are."""
    specs = read_specs(out)
    plan = specs[-1].plan
    results = {key: merge(rs) for key, rs in load_results(out).items()}
    lines = [
        *_head(specs, plan),
        *_agents(results),
        *_noise_table(results),
        *_sounds_table(results),
        *_acoustics_table(results),
        *_claims(results, plan.walks),
        *_runs(out),
        *data_lines(out),
        *_curves(out),
        *_maps(specs, out),
        *_impact(specs, out),
        *_replays(out),
    ]
    path = out / "report.md"
    publish(path, ("\n".join(lines) + "\n").encode())
    log(f"Wrote {path}")
    return path


def _head(specs: Sequence[RunSpec], plan: Study) -> list[str]:
    return [
        f"# Agents that hear: preset `{plan.preset}`",
        "",
        f"{plan.flats[0]} + {plan.flats[1]} + {plan.flats[2]} generated flats (train, val, test), {plan.walks} "
        f"walks a point, {plan.rate} Hz, {plan.spacing:g} m grid; {plan.train_episodes:,} episodes to train with, "
        f"{plan.test_episodes} to test with in flats never seen, at most {preset(plan.preset).max_steps} actions. "
        "Brackets are 95 % intervals over scenes and seeds, by Student's quantile. Actions are sampled.",
        "",
        "```sh",
        *(spec.command for spec in specs),
        "```",
        "",
    ]


def _agents(results: Results) -> list[str]:
    lines = [
        "| agent | | SPL | by seed | success | SNA | actions | bumps |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for (agent, condition), result in sorted(
        results.items(), key=lambda item: -item[1].rows["spl"].mean()
    ):
        if condition in (PLAIN, HEARD):
            s = result.summary()
            seeds = ", ".join(f"{mean:.3f}" for mean in result.by_seed()) if agent in VARIANTS else ""
            about = VARIANTS[agent].about if agent in VARIANTS else "baseline"
            lines.append(
                f"| {agent} | {about} | {s['spl']} | {seeds} | {s['success']} | {s['sna']} "
                f"| {s['na'].mean:.0f} | {s['collisions'].mean:.1f} |"
            )
    return [*lines, ""]


def _noise_table(results: Results) -> list[str]:
    conditions = [PLAIN, *NOISY.values()]
    variants = [a for a in VARIANTS if any((a, c) in results for c in NOISY.values())]
    if not variants:
        return []
    lines = [
        "## Noise in the GPS",
        "",
        "SPL with normal noise in both components of the displacement, m:",
        "",
        "| agent | 0 | " + " | ".join(f"{s:g}" for s in SIGMAS) + " |",
        "|---" * (len(SIGMAS) + 2) + "|",
    ]
    for name in ("AG", "AG-dagger"):
        if (name, PLAIN) in results:
            spl = str(results[name, PLAIN].summary()["spl"])
            lines.append(f"| {name}, which has no GPS | {' | '.join([spl] * (len(SIGMAS) + 1))} |")
    for variant in variants:
        cells = [
            str(results[variant, c].summary()["spl"]) if (variant, c) in results else ""
            for c in conditions
        ]
        lines.append(f"| {variant} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _sounds_table(results: Results) -> list[str]:
    variants = [a for a in VARIANTS if (a, HEARD) in results and (a, UNHEARD) in results]
    if not variants:
        return []
    lines = [
        "## Sounds never heard",
        "",
        "SPL of agents trained with 73 sounds, in the same test episodes with those and with 18 others, of "
        "families that were not in training:",
        "",
        "| agent | heard | unheard |",
        "|---|---|---|",
    ]
    for variant in variants:
        heard, unheard = (results[variant, c].summary()["spl"] for c in (HEARD, UNHEARD))
        lines.append(f"| {variant} | {heard} | {unheard} |")
    return [*lines, ""]


def _acoustics_table(results: Results) -> list[str]:
    conditions = [PLAIN, *(c for c in IN.values() if any(of == c for _, of in results))]
    variants = [a for a in VARIANTS if any((a, c) in results for c in conditions[1:])]
    if not variants:
        return []
    head = [ACOUSTICS[c.acoustics].about for c in conditions]
    lines = [
        "## What is heard",
        "",
        "SPL in the same test episodes, heard in several ways; beside each agent what it was trained with:",
        "",
        "| agent | | " + " | ".join(head) + " |",
        "|---" * (len(head) + 2) + "|",
    ]
    for variant in variants:
        cells = [
            str(results[variant, c].summary()["spl"]) if (variant, c) in results else ""
            for c in conditions
        ]
        lines.append(
            f"| {variant} | {ACOUSTICS[VARIANTS[variant].acoustics].about} | " + " | ".join(cells) + " |"
        )
    return [*lines, ""]


def _claims(results: Results, walks: int) -> list[str]:
    tested = [c for c in claims(walks) if c.better in results and c.worse in results]
    if not tested:
        return []
    rows = []
    for claim in tested:
        difference = results[claim.better].compare(results[claim.worse])
        together = difference.among(len(tested))
        rows.append(
            f"| {_name(claim.better)} > {_name(claim.worse)} | {claim.about} | {claim.paper} | {difference} "
            f"| [{together.low:.3f}, {together.high:.3f}] | {_verdict(together)} |"
        )
    head = [
        "## Orderings",
        "",
        "Paired difference of SPL, episode by episode, with its 95 % interval and the one that holds for all "
        f"{len(tested)} of them together (Bonferroni), by which orderings are judged. The paper's numbers are of "
        "Replica (its tables); only their order compares.",
        "",
        "| SPL | which says | paper | difference | all together | |",
        "|---|---|---|---|---|---|",
    ]
    return [*head, *rows, ""]


def _name(key: tuple[str, Condition]) -> str:
    agent, condition = key
    return agent + (
        f", σ = {condition.sigma:g} m"
        if condition.sigma
        else ""
        if condition == PLAIN
        else f", {condition.name.replace('-', ' ', 1)}"
    )


def _verdict(difference: Interval) -> str:
    if difference.low > 0.0:
        return "holds"
    return "the reverse holds" if difference.high < 0.0 else "not decided"


def _runs(out: Path) -> list[str]:
    """What every run of training was."""
    lines = [
        f"| {variant.name}, seed {seed} | {variant.method} | {rows[-1]['steps']:,.0f} "
        f"| {rows[-1]['episodes']:,.0f} | {rows[-1]['seconds'] / 60:.1f} "
        f"| {rows[-1]['steps'] / rows[-1]['seconds']:,.0f} |"
        for variant, seed, rows in curves_of(out)
    ]
    head = [
        "## Runs",
        "",
        "| run | method | steps | episodes | minutes | steps/s |",
        "|---|---|---|---|---|---|",
    ]
    return [*head, *lines, ""] if lines else []


def _curves(out: Path) -> list[str]:
    if not draw_curves(out, out / "curves.png"):
        return []
    note = (
        "Lines: means over seeds; shaded: from the worst seed to the best. Dashed: DAgger. Episodes in which the "
        "oracle took a step do not count; it leads some of the agents in the first half of the steps, so that few "
        "of their episodes count before that."
    )
    return ["## Learning", "", note, "", "![learning curves](curves.png)", ""]


def _maps(specs: Sequence[RunSpec], out: Path) -> list[str]:
    """Ways of the first arm through four flats."""
    variant = next(
        (
            VARIANTS[a]
            for o in specs
            for a in o.variants
            if (agent_folder(out, VARIANTS[a], 0) / run_files.NAME).exists()
        ),
        None,
    )
    if variant is None:
        return []
    agent, env, episodes = open_test(
        specs[-1].plan, out, Trial(variant.name, 0, HEARD if variant.varied else PLAIN)
    )
    data: NavData = env.setting.data
    figure = Figure(figsize=(13.0, 10.0), layout="constrained")
    shown = in_turn(episodes)
    for k, axes in enumerate(figure.subplots(2, 2).ravel()):
        episode = shown[k % len(shown)]
        observation, _ = env.reset(seed=k, options={"episode": episode})
        assert env.state is not None
        agent.reset(env.state, k)
        while not env.state.over:
            observation, *_ = env.step(agent.act(observation))
        m = env.state.metrics()
        end = "reached" if m.success else "not reached"
        title = f"{episode.scene}: {end} in {m.na:.0f} actions, SPL {m.spl:.2f}"
        draw_trail(axes, data.dataset(episode.scene), episode.goal, env.trail, title)
    figure.savefig(out / "ways.png", dpi=70)
    text = (
        f"Ways of {variant.name}: circle the start, square the end, star the sound; colours its level."
    )
    return ["## Ways", "", text, "", "![ways](ways.png)", ""]


def _impact(specs: Sequence[RunSpec], out: Path) -> list[str]:
    """Which sensor decides, of agents with several."""
    found = [n for n in ("APG", "AG") if (agent_folder(out, VARIANTS[n], 0) / run_files.NAME).exists()]
    for name in found:
        write_impact(specs[-1].plan, out, name, out / f"impact_{name}.png")
    if not found:
        return []
    text = (
        "Along the ways of agents, how much each sensor decides the next action: the probability of the action "
        "taken less that with its observation replaced by its mean over training, its size normalised "
        "over sensors by softmax, after the paper's figure of modalities. Circle: the start, star: the sound."
    )
    pictures = (f"![impact of each sensor on {name}](impact_{name}.png)" for name in found)
    return ["## Which sensor decides", "", text, "", *pictures, ""]


def _replays(out: Path) -> list[str]:
    replays = sorted((out / "replays").glob("*.gif"))
    if not replays:
        return []
    links = (f"- [{p.name}](replays/{p.name}), [sound](replays/{p.stem}.wav)" for p in replays)
    return ["## Replays", "", *links, ""]
