"""The page of a study, made of its record: what was run, tables with intervals, the paper's orderings, curves;
and the pictures of ways and of senses, and replays, for which its datasets are needed."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure
from soundspaces_pictures.episode_map import draw_trail

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
from soundspaces_agents.pictures.curves import draw_curves
from soundspaces_agents.pictures.impact import write_impact
from soundspaces_agents.pictures.order import in_turn
from soundspaces_agents.pictures.replay import write_replay
from soundspaces_agents.presets import preset
from soundspaces_agents.record import NAME, Record, gather, read_record, write_record
from soundspaces_agents.study import (
    Log,
    RunSpec,
    Study,
    agent_folder,
    open_test,
)
from soundspaces_sim.nav import NavData, Result
from soundspaces_sim.parts import Interval, merge_results as merge, publish_file as publish

matplotlib.use("Agg")
Results = dict[tuple[str, Condition], Result]
_DECIDING = ("APG", "AG")  # agents of whom it is shown which sense decides
_WAYS, _REPLAY = "ways.png", "replay.gif"


def write_replays(plan: Study, out: Path, variants: Sequence[Variant], log: Log) -> None:
    """GIF and WAV of the first arm's first seed on some test episodes of different homes."""
    folder = out / "replays"
    if not variants or len(list(folder.glob("*.gif"))) >= plan.replays:
        return
    condition = HEARD if variants[0].varied else PLAIN
    agent, env, episodes = open_test(plan, out, Trial(variants[0].name, 0, condition))
    for k, episode in enumerate(in_turn(episodes)[: plan.replays]):
        replay = write_replay(agent, env, episode, folder, f"{variants[0].name}-{k}")
        m = replay.metrics
        log(f"replay {replay.gif.name}: {'' if m.success else 'not '}reached, SPL {m.spl:.2f}")


def write_report(out: Path, log: Log, about: str = "") -> Path:
    """The record of what results there are in a study's folder, pictures and `report.md` of it. `about`: how it was
    made, in words."""
    record = gather(out, about)
    write_record(record, out / NAME)
    _draw_ways(record.specs, out)
    for name in _DECIDING:
        if _trained(out, VARIANTS[name]):
            write_impact(record.specs[-1].plan, out, name, out / f"impact_{name}.png")
    return write_page(out / NAME, log)


def copy_report(out: Path, to: Path, log: Log, about: str = "") -> Path:
    """What there is to keep of a study: its record, pictures, one replay and page, in a folder."""
    write_report(out, log, about)
    to.mkdir(parents=True, exist_ok=True)
    replays = sorted((out / "replays").glob("*.gif"))[:1]
    pictures = [out / NAME, *out.glob("ways.png"), *out.glob("impact_*.png")]
    for path, name in [(p, p.name) for p in pictures] + [(p, _REPLAY) for p in replays]:
        shutil.copyfile(path, to / name)
    return write_page(to / NAME, log)


def write_page(path: Path, log: Log) -> Path:
    """`report.md` and the learning curves of a record, beside it; pictures that are there are shown."""
    record, folder = read_record(path), path.parent
    plan = record.specs[-1].plan
    results = {key: merge(rs) for key, rs in record.results.items()}
    lines = [
        *_head(record, plan),
        *_agents(results),
        *_missing(record),
        *_noise_table(results),
        *_sounds_table(results),
        *_acoustics_table(results),
        *_claims(results, plan.walks),
        *_runs(record),
        *record.data,
        *_curves(record, folder),
        *_ways(folder),
        *_impact(folder),
        *_replays(folder),
    ]
    page = folder / "report.md"
    publish(page, ("\n".join(lines).rstrip() + "\n").encode())
    log(f"Wrote {page}")
    return page


def _head(record: Record, plan: Study) -> list[str]:
    homes = []
    if record.homes is not None:
        taken, seen = len(record.homes.taken), len(record.homes.seen)
        homes = [
            "Homes are `home-<n>` of neighbours/buildings by growing number, those whose largest piece of floor to "
            f"walk about in, on the grid, is at least {record.homes.least_floor:g} m²: {taken} of the first "
            f"{seen}. A dataset has the points of that piece.",
            "",
        ]
    return [
        f"# Agents that hear: preset `{plan.preset}`",
        "",
        *([record.about, ""] if record.about else []),
        f"{plan.homes[0]} + {plan.homes[1]} + {plan.homes[2]} generated homes (train, val, test), {plan.walks} "
        f"subpaths a point, {plan.rate} Hz, {plan.spacing:g} m grid; {plan.train_episodes:,} episodes to train "
        f"with, {plan.test_episodes} to test with in homes never seen, at most {preset(plan.preset).max_steps} "
        "actions. Brackets are 95 % intervals over scenes and seeds, by Student's quantile. Actions are sampled.",
        "",
        *homes,
        "```sh",
        *(spec.command for spec in record.specs),
        f"soundspaces-agents page {NAME}  # this page, from the record of single episodes",
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


def _missing(record: Record) -> list[str]:
    """Runs that were asked for, and are not tested."""
    tested = {(test.agent, test.seed) for test in record.tests}
    asked = dict.fromkeys((v.name, seed) for spec in record.specs for v, seed in spec.runs)
    left = [f"{name}, seed {seed}" for name, seed in asked if (name, seed) not in tested]
    return [f"**Asked for and not there yet:** {'; '.join(left)}.", ""] if left else []


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
    rows: dict[str, list[str]] = {verdict: [] for verdict in _VERDICTS}
    for claim in tested:
        difference = results[claim.better].compare(results[claim.worse])
        together = difference.among(len(tested))
        verdict = _verdict(together)
        rows[verdict].append(
            f"| {_name(claim.better)} > {_name(claim.worse)} | {claim.about} | {claim.paper} | {difference} "
            f"| [{together.low:.3f}, {together.high:.3f}] | {verdict} |"
        )
    counts = ", ".join(f"{verdict}: {len(of)}" for verdict, of in rows.items())
    head = [
        "## Orderings",
        "",
        "Paired difference of SPL, episode by episode, with its 95 % interval and the one that holds for all "
        f"{len(tested)} of them together (Bonferroni), by which orderings are judged. The paper's numbers are of "
        f"Replica (its tables); only their order compares. {counts}.",
        "",
        "| SPL | which says | paper | difference | all together | |",
        "|---|---|---|---|---|---|",
    ]
    return [*head, *(row for of in rows.values() for row in of), ""]


def _name(key: tuple[str, Condition]) -> str:
    agent, condition = key
    return agent + (
        f", σ = {condition.sigma:g} m"
        if condition.sigma
        else ""
        if condition == PLAIN
        else f", {condition.name.replace('-', ' ', 1)}"
    )


_VERDICTS = _HOLDS, _REVERSED, _OPEN = "holds", "the reverse holds", "not decided"


def _verdict(difference: Interval) -> str:
    if difference.low > 0.0:
        return _HOLDS
    return _REVERSED if difference.high < 0.0 else _OPEN


def _runs(record: Record) -> list[str]:
    """What every run of training was."""
    lines = [
        f"| {variant.name}, seed {seed} | {variant.method} | {rows[-1]['steps']:,.0f} "
        f"| {rows[-1]['episodes']:,.0f} | {rows[-1]['seconds'] / 60:.1f} "
        f"| {rows[-1]['steps'] / rows[-1]['seconds']:,.0f} |"
        for variant, seed, rows in record.curves_of()
    ]
    head = [
        "## Runs",
        "",
        "| run | method | steps | episodes | minutes | steps/s |",
        "|---|---|---|---|---|---|",
    ]
    return [*head, *lines, ""] if lines else []


def _curves(record: Record, folder: Path) -> list[str]:
    if not draw_curves(record.curves_of(), folder / "curves.png"):
        return []
    note = (
        "Lines: means over seeds; shaded: from the worst seed to the best. Dashed: DAgger. Encoders are taught by "
        "supervision on the training homes before, so that no curve starts from nothing. Episodes in which the "
        "oracle took a step do not count; it leads some of the agents in the first half of the steps, so that few "
        "of their episodes count before that."
    )
    return ["## Learning", "", note, "", "![learning curves](curves.png)", ""]


def _trained(out: Path, variant: Variant) -> bool:
    return (agent_folder(out, variant, 0) / run_files.NAME).exists()


def _draw_ways(specs: Sequence[RunSpec], out: Path) -> None:
    """Ways of the first arm through four homes."""
    arms = (VARIANTS[name] for spec in specs for name in spec.variants)
    variant = next((v for v in arms if _trained(out, v)), None)
    if variant is None:
        return
    agent, env, episodes = open_test(
        specs[-1].plan, out, Trial(variant.name, 0, HEARD if variant.varied else PLAIN)
    )
    data: NavData = env.setting.data
    figure = Figure(figsize=(13.0, 10.0), layout="constrained")
    figure.suptitle(variant.name)
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
    figure.savefig(out / _WAYS, dpi=70)


def _ways(folder: Path) -> list[str]:
    if not (folder / _WAYS).exists():
        return []
    text = "Ways of one agent: circle the start, square the end, star the sound; colours its level."
    return ["## Ways", "", text, "", f"![ways]({_WAYS})", ""]


def _impact(folder: Path) -> list[str]:
    """Which sensor decides, of agents with several."""
    found = [name for name in _DECIDING if (folder / f"impact_{name}.png").exists()]
    if not found:
        return []
    text = (
        "Along the ways of agents, how much each sensor decides the next action: the probability of the action "
        "taken less that with its observation replaced by its mean over training, its size normalised "
        "over sensors by softmax, after the paper's figure of modalities. Circle: the start, star: the sound."
    )
    pictures = (f"![impact of each sensor on {name}](impact_{name}.png)" for name in found)
    return ["## Which sensor decides", "", text, "", *pictures, ""]


def _replays(folder: Path) -> list[str]:
    if (folder / _REPLAY).exists():
        text = "One test episode (`soundspaces-agents replay` writes them, with sound):"
        return ["## Replays", "", text, "", f"![an agent walks to the sound]({_REPLAY})", ""]
    replays = sorted((folder / "replays").glob("*.gif"))
    if not replays:
        return []
    links = (f"- [{p.name}](replays/{p.name}), [sound](replays/{p.stem}.wav)" for p in replays)
    return ["## Replays", "", *links, ""]
