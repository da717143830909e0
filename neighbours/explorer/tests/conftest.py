"""The explorer's server for tests of its pages."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from soundspaces_explorer import live
from soundspaces_explorer.job import JobMaker
from soundspaces_explorer.live import LiveScene, Step
from soundspaces_explorer.live_api import LiveSession
from soundspaces_explorer.server import ExplorerServer

import soundspaces_sim as ss

RATE = 16000
STEPS = (Step(64, False), Step(64, True), Step(256, True))


@pytest.fixture(scope="module")
def url(dataset_folder: Path) -> Iterator[str]:
    with ss.open_dataset(dataset_folder, 16000) as ds, ExplorerServer({ds.scene: ds}) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.url
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def few_steps() -> Iterator[tuple[Step, ...]]:
    """A live scene makes three small estimates."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(live, "STEPS", STEPS)
        patch.setattr(live, "_QUICK", 2)
        yield STEPS


@pytest.fixture(scope="module")
def live_scene(few_steps: tuple[Step, ...]) -> Iterator[LiveScene]:
    assert few_steps == live.STEPS
    sides = dict.fromkeys(("west", "east", "south", "north"), "gypsum-board")
    scene = ss.shoebox((6.0, 5.0, 3.0), {**sides, "floor": "carpet", "ceiling": "acoustic-tile"})
    opened = LiveScene(scene, ss.SimulationConfig(duration=0.3))
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def live_server(
    live_scene: LiveScene, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ExplorerServer]:
    jobs = JobMaker(
        live_scene.scene, "shoebox.obj", {}, tmp_path_factory.mktemp("jobs"), live_scene.bands
    )
    with ExplorerServer({}, live=LiveSession(live_scene, jobs, RATE)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()
