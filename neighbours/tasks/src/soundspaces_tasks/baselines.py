"""What tasks share: examples of all homes in one piece, and rows of methods that are trained on some of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import find_entry as find
from soundspaces_tasks.fits import torch_missing
from soundspaces_tasks.registry import NETWORKS
from soundspaces_tasks.results import Row
from soundspaces_tasks.setting import HomeJob, Setting, examples

Example = tuple[Any, ...]


def gathered(setting: Setting, make: Callable[[HomeJob], list[Example]]) -> list[np.ndarray]:
    """Columns of the examples that `make` gives of every home, some of none, and the row of each one's home.

    Raises `ConfigError` if there is no example at all.
    """
    made = examples(setting, make)
    rows = [(*example, home) for home, of_home in enumerate(made) for example in of_home]
    if not rows:
        raise ConfigError(f"{setting.root}: no home has a pair that this task can use; make finer grids")
    return [np.stack(column) for column in zip(*rows, strict=True)]


def trained_rows(
    setting: Setting,
    task: str,
    methods: Mapping[str, Callable[..., Any]],
    data: Sequence[Any],
    row: Callable[[str, int, list[Any]], Row],
    unit: str,
) -> tuple[list[Row], tuple[str, ...]]:
    """Rows of `methods` and of the task's network, for every number of training homes, and what a page says of
    networks that were not trained.

    A method is called with `data`, the setting, the number of homes and the seed; `row` makes a row of its name,
    the number, and what it finds with each seed. `unit`: of the first score, to tell how far it is.
    """
    missing = torch_missing()
    network = {} if missing else {"network": find("network", NETWORKS, task)}
    rows = []
    for name, method in {**methods, **network}.items():
        for count in setting.homes:
            found = [method(*data, setting, count, seed) for seed in range(setting.seeds)]
            rows.append(row(name, count, found))
            setting.say(f"{task}, {name}, {count} homes: {rows[-1].scores[0]} {unit}")
    return rows, (missing,) if missing else ()
