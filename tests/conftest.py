"""Shared fixtures."""

from __future__ import annotations

import gc
import os
import sys
import tomllib
from collections.abc import Generator, Iterator
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.kernel import set_thread_count
from soundspaces_sim.core.numerics.threads import core_count
from soundspaces_sim.scene import formats
from tests import WORKERS
from tests.rooms import table, two_rooms

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What tests import stays: it is not looked through for what nobody refers to, then or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What is kept between processes is kept among those of a test run alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOUNDSPACES_SIM_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def own_cores() -> None:
    """As many threads as there are cores for this worker: with more, a small tile takes half as long again."""
    if WORKERS > 1:
        set_thread_count(max(core_count() // WORKERS, 1))


@pytest.fixture
def no_t30(monkeypatch: pytest.MonkeyPatch) -> None:
    """`inspect` without its simulation, and with few rays to measure by, for tests of what else it says."""
    none = np.full(4, np.nan)
    monkeypatch.setattr(
        "soundspaces_sim.build.inspect.simulated_t30", lambda _scene, _grid: (none, none, 0, ())
    )
    monkeypatch.setattr("soundspaces_sim.build.inspect._RAYS", 50)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of data that is never committed; tests that need it skip where it is absent."""
    if not SHARED.is_dir():
        pytest.skip(f"{SHARED} is absent (scenes and measurements that are not part of the project)")
    return SHARED


@pytest.fixture(scope="session")
def neighbours_installed(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Tests, and programs that they start, find the neighbours and their entry points, installed or not."""
    installed = tmp_path_factory.mktemp("installed")
    for file in sorted(ROOT.glob("neighbours/*/pyproject.toml")):
        project = tomllib.loads(file.read_text("utf-8"))["project"]
        name = project["name"].replace("-", "_")  # a hyphen ends a name
        info = installed / f"{name}-{project['version']}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
        lines = [
            f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in entries.items())
            for group, entries in project.get("entry-points", {}).items()
        ]
        (info / "entry_points.txt").write_text("".join(lines))
    sys.path.insert(0, str(installed))
    formats.neighbours.cache_clear()
    found = [ROOT, installed, *sorted(ROOT.glob("neighbours/*/src"))]
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([*map(str, found), *([before] if before else [])])


def small_job(**dataset: object) -> ss.JobConfig:
    """A job of a second. Patches cost more than all else here, however few the subpaths: tests of transport
    have them."""
    return ss.JobConfig(
        grid=ss.GridConfig(spacing=1.5, rays=200),
        simulation=ss.SimulationConfig(
            walks=64,
            connections=ss.ConnectionsConfig(subpaths=8),
            duration=0.2,
            reflection="random",  # so few subpaths know reverberation times better
            radiance_transfer=ss.RadianceTransferConfig(enabled=False),
        ),
        dataset=type(ss.JobConfig().dataset)(**{"tile": 4, "rate": 16000, **dataset}),  # type: ignore[arg-type]
    )


@pytest.fixture(scope="session")
def small_scene() -> ss.Scene:
    return two_rooms(table(0.3, 0.4, 0.01), 0)


@pytest.fixture(scope="session")
def dataset_folder(tmp_path_factory: pytest.TempPathFactory, small_scene: ss.Scene) -> Path:
    """A finished small dataset."""
    return ss.build_dataset(small_scene, tmp_path_factory.mktemp("out"), small_job()).folder


@pytest.fixture
def echogram(dataset_folder: Path) -> ss.Echogram:
    return ss.open_dataset(dataset_folder).echogram(0, 3)


def energy(x: np.ndarray) -> np.ndarray:
    """Sum of squares over time."""
    return np.asarray((np.asarray(x, float) ** 2).sum(axis=-1))
