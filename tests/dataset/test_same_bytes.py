"""The bytes of a shard depend on its content alone."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.simulation_config import ConnectionsConfig
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.writing import encode_echograms, encode_waveforms
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.rendering.ambisonics import ambisonic_rir
from soundspaces_sim.transport.simulate import simulate
from tests.marks import ci_slow
from tests.rooms import box, table


@pytest.fixture
def profiler() -> Iterator[None]:
    """A thread that looks at our frames, as Dask's workers have one: it keeps alive what they refer to."""
    stop = threading.Event()

    def look() -> None:
        held: list[object] = []
        while not stop.is_set():
            held.append(sys._current_frames())
            if len(held) > 3:
                held.pop(0)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread = threading.Thread(target=look)
    thread.start()
    yield
    stop.set()
    thread.join()
    sys.setswitchinterval(interval)


def _shards(echoes: Echograms, attributes: dict[str, object]) -> tuple[bytes, bytes]:
    echograms = encode_echograms(echoes, np.arange(2), np.arange(2), attributes)
    shard = EchogramShard(echograms)

    def render(s: int) -> list[tuple[np.ndarray, np.ndarray]]:
        return [
            (ambisonic_rir(shard.echogram(s, l), 8000, 0), np.ones((1, 2, 50), np.float32))
            for l in range(2)
        ]

    of_waveforms = {**attributes, "rate": 8000, "renderer": "default"}
    waveforms = encode_waveforms(shard, slice(0, 2), of_waveforms, (0.0,), "int16", render)
    shard.close()
    return echograms, waveforms


@pytest.fixture
def echoes() -> Echograms:
    points = [[1.0, 1.0, 1.2], [2.0, 2.5, 1.2]]
    room = box((4.0, 3.0, 2.5), table(0.5, 0.5))
    return simulate(
        room,
        points,
        points,
        SimulationConfig(walks=16, connections=ConnectionsConfig(subpaths=0), duration=0.05),
    )


@pytest.mark.usefixtures("profiler")
@ci_slow
def test_a_profiler_changes_no_byte(dataset_folder: Path, echoes: Echograms) -> None:
    with h5py.File(next(dataset_folder.glob("s*.h5")), locking=False) as file:
        attributes = {k: v for k, v in file.attrs.items() if k not in ("format", "schema_version")}
    first = _shards(echoes, attributes)
    assert all(_shards(echoes, attributes) == first for _ in range(15))
