"""The dataset: bytes per response, reads per second, and what the paper's scenes would need.

    .venv/bin/python -m benchmarks.dataset

Builds the demo apartment (echograms, and waveforms of part of it), reads at random with one core, and
with DataLoader workers if torch is there.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import time
from pathlib import Path

import numpy as np

import soundspaces_sim as ss
from benchmarks.rendering import per_second
from soundspaces_sim.core.config import DatasetConfig

# Name, scenes, and mean number of points per scene in the paper's Table 1.
_SCENES = (("Replica", 18, 97), ("Matterport3D", 85, 243))


def build(scene: ss.Scene, out: Path, spacing: float, **dataset: object) -> Path:
    job = ss.JobConfig(
        grid=ss.GridConfig(spacing=spacing), simulation=ss.SimulationConfig(walks=250),
        dataset=DatasetConfig(**dataset),  # type: ignore[arg-type]
    )  # fmt: skip
    start = time.perf_counter()
    result = ss.build_dataset(scene, out, job)
    seconds = time.perf_counter() - start
    size = sum(e.bytes for e in result.manifest.shards)
    pairs = len(result.manifest.points) ** 2
    print(
        f"{job.dataset.store:<10s}{spacing:4g} m{pairs:9,d} pairs of {result.manifest.duration:.1f} s in "
        f"{seconds:7.1f} s, {pairs / seconds:7.0f} /s, {size / pairs / 1e3:8.2f} kB per pair"
    )
    return result.folder


def totals(folder: Path) -> None:
    """What the paper's scenes would need."""
    with ss.open_dataset(folder) as ds:
        size = sum(e.bytes for e in ds.manifest.shards) / len(ds)
    print("\nfrom these bytes per pair, with the mean number of points per scene of the paper's Table 1")
    for name, scenes, points in _SCENES:
        pairs = scenes * points**2
        print(f"{scenes} scenes of {name:<14s}{pairs / 1e6:8.2f} M pairs {pairs * size / 1e9:8.2f} GB")


def reading(folder: Path) -> None:
    with ss.open_dataset(folder) as ds:
        pairs = ds.sample(20000, 0)
        print("\nrandom reads per second and core")
        for name, read in (
            ("echogram", lambda k: ds.echogram(*pairs[k % 20000])),
            ("ambisonic, 16 kHz", lambda k: ds.ambisonic(*pairs[k % 20000], rate=16000)),
            ("binaural, 16 kHz", lambda k: ds.binaural(*pairs[k % 20000], 30.0 * k, rate=16000)),
            ("ambisonic, 44.1 kHz", lambda k: ds.ambisonic(*pairs[k % 20000], rate=44100)),
            ("binaural, 44.1 kHz", lambda k: ds.binaural(*pairs[k % 20000], 30.0 * k, rate=44100)),
        ):
            print(f"  {name:<22s}{per_second(read):8.0f}")
        square = ss.MicrophoneArray([[0.1, 0.1, 0], [0.1, -0.1, 0], [-0.1, 0.1, 0], [-0.1, -0.1, 0]])
        with (
            ss.open_dataset(folder, 16000, renderer="smooth") as smooth,
            ss.open_dataset(folder, 16000, hrtf=ss.Ears(offset=(0.1, 0.0, 0.0))) as moved,
        ):
            for name, read in (
                ("echogram, talker", lambda k: ds.echogram(*pairs[k % 20000], "talker")),
                (
                    "binaural, talker",
                    lambda k: ds.binaural(*pairs[k % 20000], 30.0 * k, 16000, source="talker"),
                ),
                ("ambisonic, smooth", lambda k: smooth.ambisonic(*pairs[k % 20000])),
                ("binaural, smooth", lambda k: smooth.binaural(*pairs[k % 20000], 30.0 * k)),
                ("binaural, moved head", lambda k: moved.binaural(*pairs[k % 20000], 30.0 * k)),
                ("four microphones", lambda k: ds.microphones(*pairs[k % 20000], square, 16000)),
            ):
                print(f"  {name + ', 16 kHz':<30s}{per_second(read):8.0f}")
        before = _resident_mb()
        for s, l in ds.sample(100_000, 1):
            ds.echogram(s, l)
        print(
            f"  resident memory before and after 100,000 reads: {before:.0f} and {_resident_mb():.0f} MB"
        )


def _resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def loaders(folder: Path) -> None:
    try:
        import torch
    except ImportError:
        print("\nDataLoader workers: torch is not installed, skipped")
        return
    from soundspaces_sim.dataset.torch_dataset import TorchRirDataset

    with ss.open_dataset(folder, rate=16000) as ds:
        data = TorchRirDataset(ds, np.array(ds.sample(3000, 2)))
        print("\nbinaural responses per second (16 kHz) through torch's DataLoader")
        for workers in (1, 2, 4):
            loader = torch.utils.data.DataLoader(data, batch_size=32, num_workers=workers)
            iterator = iter(loader)
            next(iterator)  # workers are up
            start = time.perf_counter()
            count = sum(len(batch["rir"]) for batch in iterator)
            print(f"  {workers} workers {count / (time.perf_counter() - start):8.0f}")


def main() -> None:
    scene = ss.load_scene("demo")
    with tempfile.TemporaryDirectory() as temporary:
        build(scene, Path(temporary) / "warm", 4.0)
        folder = build(scene, Path(temporary) / "e", 0.75)
        build(scene, Path(temporary) / "w", 2.0, store="waveform")
        build(scene, Path(temporary) / "w16", 2.0, store="waveform", rate=16000)
        totals(folder)
        reading(folder)
        loaders(folder)


if __name__ == "__main__":
    main()
