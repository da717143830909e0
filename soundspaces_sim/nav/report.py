"""The report of a study: tables with intervals, the paper's orderings one by one, curves, maps, replays."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from soundspaces_sim.base.files import publish
from soundspaces_sim.nav.agents import BASELINES
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.evaluate import Interval, Result, merge
from soundspaces_sim.nav.replay import draw_trail, write_replay
from soundspaces_sim.nav.study import (
    ARMS,
    SIGMAS,
    Arm,
    Say,
    Study,
    agent_folder,
    load_results,
    open_test,
)

matplotlib.use("Agg")
_COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"]

#: (better, worse, what it says): an ordering holds if the interval of the paired difference of SPL is above 0.
CLAIMS: tuple[tuple[tuple[str, float], tuple[str, float], str], ...] = (
    (("AG", 0.0), ("EarFollower", 0.0), "a learnt agent does better than following the louder ear"),
    (("EarFollower", 0.0), ("Random", 0.0), "ears alone beat chance"),
    (("AG", 0.0), ("AG-intensity", 0.0), "the spectrogram says more than loudness"),
    (("APG", 0.0), ("PG", 0.0), "sound helps an agent that has GPS"),
    (("AG", 0.0), ("PG", 0.5), "sound replaces a GPS that errs by 0.5 m"),
    (("PG", 0.0), ("PG", 0.5), "PointGoal falls with noise of 0.5 m"),
    (("PG", 0.5), ("PG", 1.0), "and further with 1 m"),
    (("PG", 1.0), ("PG", 1.5), "and with 1.5 m"),
    (("APG", 0.0), ("AG", 0.0), "GPS helps an agent that hears (either way)"),
    (("AG", 0.0), ("AG-blind", 0.0), "depth helps an agent that hears (either way)"),
)


def write_replays(plan: Study, out: Path, arms: Sequence[Arm], say: Say) -> None:
    """GIF and WAV of the first arm's first seed on some test episodes of different flats."""
    folder = out / "replays"
    if not arms or len(list(folder.glob("*.gif"))) >= plan.replays:
        return
    agent, env, episodes = open_test(plan, out, arms[0].name, 0, 0.0)
    for k in range(plan.replays):
        replay = write_replay(agent, env, episodes[k], folder, f"{arms[0].name}-{k}")
        m = replay.metrics
        say(f"replay {replay.gif.name}: {'' if m.success else 'not '}reached, SPL {m.spl:.2f}")


def write_report(plan: Study, out: Path, say: Say) -> Path:
    """`report.md` of what results there are."""
    results = {key: merge(rs) for key, rs in load_results(out).items()}
    lines = [
        f"# Agents that hear: preset `{plan.preset}`", "",
        f"{plan.flats[0]} + {plan.flats[1]} + {plan.flats[2]} generated flats (train, val, test), {plan.walks} "
        f"walks a point, {plan.rate} Hz, {plan.spacing:g} m grid; {plan.test_episodes} test episodes in flats "
        "never seen. Brackets are 95 % intervals of a bootstrap over scenes, episodes and seeds. Actions are "
        "sampled.", "",
        "| agent | seeds | SPL | success | SNA | actions | bumps |", "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for (agent, sigma), result in sorted(results.items(), key=lambda item: -item[1].rows["spl"].mean()):
        if sigma:
            continue
        s = result.summary()
        seeds = len(np.unique(result.rows["seed"]))
        lines.append(
            f"| {agent} | {seeds if agent not in BASELINES else ''} | {s['spl']} | {s['success']} | {s['sna']} "
            f"| {s['na'].mean:.0f} | {s['collisions'].mean:.1f} |"
        )
    lines += ["", *_noise_table(results), *_claims(results), *_curves(plan, out), *_maps(plan, out)]
    replays = sorted((out / "replays").glob("*.gif"))
    if replays:
        lines += [
            "## Replays",
            "",
            *(f"- [{p.name}](replays/{p.name}), [sound](replays/{p.stem}.wav)" for p in replays),
        ]
    path = out / "report.md"
    publish(path, ("\n".join(lines) + "\n").encode())
    say(f"Wrote {path}")
    return path


def _noise_table(results: dict[tuple[str, float], Result]) -> list[str]:
    arms = [a for a in ARMS if any((a, s) in results for s in SIGMAS[1:])]
    if not arms:
        return []
    lines = [
        "## Noise in the GPS",
        "",
        "SPL with normal noise in both components of the displacement, m:",
        "",
    ]
    lines += [
        "| agent | " + " | ".join(f"{s:g}" for s in SIGMAS) + " |",
        "|---" * (len(SIGMAS) + 1) + "|",
    ]
    for arm in arms:
        cells = [str(results[arm, s].summary()["spl"]) if (arm, s) in results else "" for s in SIGMAS]
        lines.append(f"| {arm} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _claims(results: dict[tuple[str, float], Result]) -> list[str]:
    rows = []
    for better, worse, words in CLAIMS:
        if better in results and worse in results:
            difference = results[better].compare(results[worse])
            rows.append(
                f"| {_name(better)} > {_name(worse)} | {words} | {difference} | {_verdict(difference)} |"
            )
    if not rows:
        return []
    head = ["## Orderings", "", "| SPL | which says | paired difference | |", "|---|---|---|---|"]
    return [*head, *rows, ""]


def _name(key: tuple[str, float]) -> str:
    return key[0] + (f", σ = {key[1]:g} m" if key[1] else "")


def _verdict(difference: Interval) -> str:
    return (
        "holds"
        if difference.low > 0.0
        else "the reverse holds"
        if difference.high < 0.0
        else "not decided"
    )


def _curves(plan: Study, out: Path) -> list[str]:
    from soundspaces_sim.nav.learn.train import read_curve

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    for colour, name in zip(_COLOURS, plan.arms, strict=False):
        for folder in sorted((out / "agents").glob(f"{name}-[0-9]*")):
            rows = read_curve(folder)
            axes.plot(
                [r["steps"] / 1e6 for r in rows],
                [r["spl"] for r in rows],
                color=colour,
                lw=1.0,
                label=name,
            )
    handles, labels = axes.get_legend_handles_labels()
    if not handles:
        return []
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), frameon=False, fontsize=8)
    axes.set_xlabel("steps (millions)")
    axes.set_ylabel("SPL while training, last 400 episodes")
    axes.set_ylim(0.0, 1.0)
    figure.savefig(out / "curves.png", dpi=90)
    return ["## Learning", "", "![learning curves](curves.png)", ""]


def _maps(plan: Study, out: Path) -> list[str]:
    """Ways of the first arm through four flats."""
    from soundspaces_sim.nav.learn.train import NAME

    arm = next((ARMS[a] for a in plan.arms if (agent_folder(out, ARMS[a], 0) / NAME).exists()), None)
    if arm is None:
        return []
    agent, env, episodes = open_test(plan, out, arm.name, 0, 0.0)
    data: NavData = env.setting.data
    figure = Figure(figsize=(13.0, 10.0), layout="constrained")
    for k, axes in enumerate(figure.subplots(2, 2).ravel()):
        episode = episodes[k % len(episodes)]
        observation, _ = env.reset(seed=k, options={"episode": episode})
        assert env.walk is not None
        agent.reset(env.walk, k)
        while not env.walk.over:
            observation, *_ = env.step(agent.act(observation))
        m = env.walk.metrics()
        end = "reached" if m.success else "not reached"
        title = f"{episode.scene}: {end} in {m.na:.0f} actions, SPL {m.spl:.2f}"
        draw_trail(axes, data.dataset(episode.scene), episode.goal, env.trail, title)
    figure.savefig(out / "ways.png", dpi=70)
    text = f"Ways of {arm.name}: circle the start, square the end, star the sound; colours its level."
    return ["## Ways", "", text, "", "![ways](ways.png)", ""]
