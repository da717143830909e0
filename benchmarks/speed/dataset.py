"""The dataset: bytes per response, reads per second, and what the paper's scenes would need.

Question: How large is a dataset, and how many responses per second does a core read?

Method: The demo apartment at .75 m as echograms, and at 2 m as waveforms; random pairs, per second of one
core's processor time. Through torch's DataLoader by the clock, where torch is there.

Amortised: Opening the dataset and the first read are not counted; shards are in the page cache.

Takes: 3 minutes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.clocks import per_second
from benchmarks.tools.record import Table, table
from soundspaces_sim.core.config import DatasetConfig

# Name, scenes, and mean number of points per scene in the paper's Table 1.
_SCENES = (("Replica", 18, 97), ("Matterport3D", 85, 243))
_PAIRS = 20_000
_LONG = 100_000  # reads, over which memory must not grow


def build(scene: ss.Scene, out: Path, spacing: float, **dataset: Any) -> tuple[Path, tuple[object, ...]]:
    """A dataset's folder, and the row that tells of it: store, m, pairs, s, processor's s, kB per pair."""
    job = ss.JobConfig(
        grid=ss.GridConfig(spacing=spacing), simulation=ss.SimulationConfig(walks=250),
        dataset=DatasetConfig(**dataset),
    )  # fmt: skip
    start, used = time.perf_counter(), time.process_time()
    result = ss.build_dataset(scene, out, job)
    size = sum(e.bytes for e in result.manifest.shards)
    pairs = len(result.manifest.points) ** 2
    rate = f", {job.dataset.rate} Hz" if job.dataset.store == "waveform" else ""
    row = (
        job.dataset.store + rate, spacing, pairs, result.manifest.duration, time.perf_counter() - start,
        time.process_time() - used, size / pairs / 1e3,
    )  # fmt: skip
    return result.folder, row


def _totals(folder: Path) -> Table:
    with ss.open_dataset(folder) as ds:
        size = sum(e.bytes for e in ds.manifest.shards) / len(ds)
    rows = [
        (name, scenes, scenes * points**2, scenes * points**2 * size / 1e9)
        for name, scenes, points in _SCENES
    ]
    return table(
        "With these bytes per pair, the scenes of the paper's Table 1",
        ["", "scenes", "pairs", ("size", "GB")], rows,
        "The mean number of points per scene is the table's: 97 and 243. Published are 81 GB and 3.6 TB.",
    )  # fmt: skip


def _reading(folder: Path) -> list[Table]:
    square = ss.MicrophoneArray([[0.1, 0.1, 0], [0.1, -0.1, 0], [-0.1, 0.1, 0], [-0.1, -0.1, 0]])
    with (
        ss.open_dataset(folder) as ds,
        ss.open_dataset(folder, 16000, renderer="smooth") as smooth,
        ss.open_dataset(folder, 16000, hrtf=ss.Ears(offset=(0.1, 0.0, 0.0))) as moved,
    ):
        pairs = ds.sample(_PAIRS, 0)
        reads: dict[str, Callable[[tuple[int, int], float], object]] = {
            "echogram": lambda p, _: ds.echogram(*p),
            "ambisonic, 16 kHz": lambda p, _: ds.ambisonic(*p, rate=16000),
            "binaural, 16 kHz": lambda p, h: ds.binaural(*p, h, rate=16000),
            "ambisonic, 44.1 kHz": lambda p, _: ds.ambisonic(*p, rate=44100),
            "binaural, 44.1 kHz": lambda p, h: ds.binaural(*p, h, rate=44100),
            'echogram, `source="talker"` (reads the way back too)': lambda p, _: ds.echogram(
                *p, "talker"
            ),
            'binaural, 16 kHz, `source="talker"`': lambda p, h: ds.binaural(
                *p, h, 16000, source="talker"
            ),
            'ambisonic, 16 kHz, `renderer="smooth"`': lambda p, _: smooth.ambisonic(*p),
            'binaural, 16 kHz, `renderer="smooth"`': lambda p, h: smooth.binaural(*p, h),
            "binaural, 16 kHz, a head off its point": lambda p, h: moved.binaural(*p, h),
            "four microphones, 16 kHz": lambda p, _: ds.microphones(*p, square, 16000),
        }
        rows = [
            (name, per_second(lambda k, read=read: read(pairs[k % _PAIRS], 30.0 * k)))
            for name, read in reads.items()
        ]
        before = _resident_mb()
        for s, l in ds.sample(_LONG, 1):
            ds.echogram(s, l)
        after = _resident_mb()
    return [
        table("Random reads per second of one core", ["", ("reads", "1/s")], rows),
        table(
            f"Resident memory around {_LONG:,} reads",
            [("before", "MB"), ("after", "MB")],
            [(before, after)],
        ),
    ]


def _resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6


def _loaders(folder: Path) -> Table:
    import torch
    from soundspaces_torch.dataset import TorchRirDataset

    rows = []
    with ss.open_dataset(folder, rate=16000) as ds:
        data = TorchRirDataset(ds, np.array(ds.sample(3000, 2)))
        for workers in (1, 2, 4):
            loader = torch.utils.data.DataLoader(data, batch_size=32, num_workers=workers)
            iterator = iter(loader)
            next(iterator)  # workers are up
            start = time.perf_counter()
            count = sum(len(batch["rir"]) for batch in iterator)
            rows.append((workers, count / (time.perf_counter() - start)))
    return table(
        "Binaural responses, 16 kHz, through torch's DataLoader by the clock",
        ["workers", ("responses", "1/s")], rows,
    )  # fmt: skip


def run() -> list[Table]:
    """Sizes, totals, reads, loaders."""
    scene = ss.load_scene("demo")
    heads = [
        "store", ("spacing", "m"), "pairs", ("length", "s"), ("clock", "s"), ("processor", "s"), ("per pair", "kB"),
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as temporary:
        build(scene, Path(temporary) / "warm", 4.0)
        folder, row = build(scene, Path(temporary) / "e", 0.75)
        rows = [row, build(scene, Path(temporary) / "w", 2.0, store="waveform")[1]]
        rows.append(build(scene, Path(temporary) / "w16", 2.0, store="waveform", rate=16000)[1])
        note = "250 subpaths; times include writing."
        tables = [table("The demo apartment", heads, rows, note), _totals(folder), *_reading(folder)]
        return [*tables, *([_loaders(folder)] if find_spec("torch") else [])]
