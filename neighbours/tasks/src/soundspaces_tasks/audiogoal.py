"""Task: AudioGoal on the episodes of a collection's test homes, by the agents that learn nothing."""

from __future__ import annotations

import numpy as np

from soundspaces_sim import ConfigError
from soundspaces_sim.nav import (
    AudioNavEnv,
    EarFollower,
    Episode,
    GoalFollower,
    NavData,
    Oracle,
    Random,
    evaluate,
    make_episodes,
    read_episodes,
)
from soundspaces_sim.parts import EPISODES_FOLDER as FOLDER
from soundspaces_tasks.results import Row, Score, TaskResult, interval
from soundspaces_tasks.setting import Setting

_STEPS = 500
_AGENTS = (Oracle, EarFollower, GoalFollower, Random)
_DRAWN = 20  # episodes of a home, where the collection has no files of them
_MEASURES = ("success", "spl", "softspl", "na")
_SCORES = (
    Score("Success", higher=True),
    Score("SPL", higher=True),
    Score("SoftSPL", higher=True),
    Score("Actions", digits=0),
)
_ABOUT = f"""An agent hears a telephone and walks to it ([Navigation](../../docs/navigation.md)). An
episode ends at STOP or after {_STEPS} actions. Scores are those of the literature
([measures](../../docs/navigation.md#frames-and-numbers)).
All agents here know when they have arrived.

- *Oracle* walks a shortest way. *EarFollower* turns to the louder ear, *GoalFollower* to the goal whatever is
  in the way; *Random* moves at random.

Trained agents are those of `make nav`; none is trained here, so training homes play no part."""


def run(setting: Setting) -> TaskResult:
    """Scores of the agents; `setting.seeds` of those that draw."""
    data = NavData(setting.root)
    try:
        episodes, drawn = _episodes(setting, data)
        env = AudioNavEnv(
            data,
            split="test",
            episodes=episodes,
            sensors=["intensity", "collision"],
            max_steps=_STEPS,
        )
        home = np.array([episode.scene for episode in episodes])
        rows = []
        for agent in _AGENTS:
            runs = [evaluate(agent(), env, episodes, seed).rows for seed in range(setting.seeds)]
            scores = [interval(np.stack([r[name] for r in runs]), home) for name in _MEASURES]
            rows.append(Row(agent.name, 0, tuple(scores)))
            setting.say(f"audiogoal, {agent.name}: SPL {scores[1]}")
    finally:
        data.close()
    where = "drawn here" if drawn else f"from `{FOLDER}/test`"
    without = sorted(set(setting.splits["test"]) - set(home))
    facts = f"{len(episodes)} episodes of {len(set(home))} test homes, {where}."
    if without:
        facts += f" No episode in {', '.join(without)}: no way there is long enough on their grids."
    return TaskResult("AudioGoal", _ABOUT, _SCORES, tuple(rows), (facts,))


def _episodes(setting: Setting, data: NavData) -> tuple[list[Episode], bool]:
    """Those of the collection's files, or drawn ones where it has no files."""
    folder = setting.root / FOLDER / "test"
    if folder.is_dir():
        found = list(read_episodes(folder, data))
        if not found:
            raise ConfigError(
                f"{folder}: expected at least one episode; a collection on a finer grid has more"
            )
        return found, False
    count = _DRAWN * len(setting.splits["test"])
    return list(make_episodes(data, "test", count, 0)), True
