"""What a newcomer adds takes one module and one line of a registry: each is tried here with a toy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.registry import Entry
from soundspaces_sim.dataset import exporters
from soundspaces_sim.dataset.exporters.plan import ExportPlan
from soundspaces_sim.echogram.echogram import MIRRORS
from soundspaces_sim.rendering import renderers
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.technique import Technique
from soundspaces_sim.transport.techniques import TECHNIQUES
from soundspaces_sim.transport.tile import Arrived, Tile, nothing_arrived
from tests.rooms import box, plain, table


def echo_of_a_second(tile: Tile) -> Arrived:
    """A toy technique: one path of 34.3 m and 1 µJ/m² for every pair."""
    rows, columns, bands = tile.shape
    n = rows * columns
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    none = np.full((n, 2), -1)
    paths = PathTable(
        np.arange(n),
        np.full(n, 34.3),
        up,
        up,
        np.full((n, bands), 1e-6),
        none,
        np.full(n, MIRRORS),
        none,
    )
    return nothing_arrived(tile)._replace(paths=paths)


def test_a_technique() -> None:
    toy = Technique("toy", "an echo after .1 s", connect=echo_of_a_second, requires=("arrivals",))
    a, b = np.array([[1.0, 1.0, 1.0]]), np.array([[3.0, 2.0, 1.2]])
    model = make_model(
        box((4.0, 3.0, 2.5), table(0.2, 0.3)), np.concatenate([a, b]), plain(duration=0.2, walks=16)
    )
    found = [
        simulate_tile(model, a, b, False, techniques=t)[0] for t in (TECHNIQUES, (*TECHNIQUES, toy))
    ]
    assert len(found[1].early) == len(found[0].early) + 1
    np.testing.assert_array_equal(found[0].energy, found[1].energy)
    assert np.isclose(found[1].early.delay, 0.1).sum() == 1 + np.isclose(found[0].early.delay, 0.1).sum()


def click(echogram: ss.Echogram, rate: int, seed: int) -> np.ndarray:
    """A toy renderer: a click at the direct sound's time."""
    out = np.zeros((9, rate), np.float32)
    assert echogram.direct is not None and seed >= 0
    out[0, int(echogram.direct.delay * rate)] = 1.0
    return out


def plan_names(ds: ss.RirDataset, out: Path, *, greeting: str = "") -> ExportPlan:
    """A toy exporter: it plans nothing."""
    del ds, out
    raise ss.ConfigError(f"toy exporter {greeting}")


def test_a_renderer_and_an_exporter(
    dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(renderers.RENDERERS, "click", Entry(f"{__name__}:click", "a click"))
    with ss.open_dataset(dataset_folder, renderer="click") as ds:
        sent = next(
            (s, l)
            for s in range(len(ds.points))
            for l in range(len(ds.points))
            if s != l and ds.echogram(s, l).direct
        )
        assert np.count_nonzero(ds.ambisonic(*sent)) == 1
        toys: Any = exporters.EXPORTERS
        monkeypatch.setitem(toys, "names", Entry(f"{__name__}:plan_names", "nothing"))
        with pytest.raises(ss.ConfigError, match="toy exporter hello"):
            exporters.find_exporter("names", {"greeting": "hello"})(ds, tmp_path)


def test_a_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    from soundspaces_pictures import registry

    from soundspaces_sim.core.registry import find

    pages: Any = registry.PAGES
    monkeypatch.setitem(pages, "toy", Entry(f"{__name__}:click", "a toy"))
    assert find("what", registry.PAGES, "toy") is click


def test_a_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own row is all that the task, the space and the observations need."""
    from soundspaces_sim.nav import sensor_table
    from soundspaces_sim.nav.task import TaskOptions

    def count(_scenes: Any, state: Any, _rng: np.random.Generator, into: np.ndarray) -> None:
        into[0] = state.steps

    rows: Any = sensor_table.SENSOR_TABLE
    monkeypatch.setitem(rows, "clock", sensor_table.Sensor(lambda *_: (1,), (0.0,), (500.0,), count))
    task = TaskOptions(task="PointGoal", sensors=("collision", "clock"))
    assert task.heard == frozenset()
    clock = sensor_table.SENSOR_TABLE["clock"]
    assert clock.shape(16000, 128) == (1,) and (clock.low, clock.high) == ((0.0,), (500.0,))
