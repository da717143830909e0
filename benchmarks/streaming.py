"""Reading for training: WebDataset tar files beside the dataset they were exported from, in one run.

    .venv/bin/python -m pip install webdataset
    .venv/bin/python -m benchmarks.streaming

Binaural responses at 16 kHz of the demo apartment, one core, files in the page cache (just written, as what a
loader has fetched is): rendered from echograms at random, rendered from stored ambisonic waveforms at random, the
tar files by the library `webdataset`, and by Python's tarfile alone. Processor's seconds; where torch is there,
also by the clock through its DataLoader.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import io
import json
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import soundspaces_sim as ss
from benchmarks.dataset import build
from soundspaces_sim.dataset.exporters.plan import carry_out
from soundspaces_sim.dataset.exporters.webdataset import plan_webdataset

RATE, SPACING = 16000, 1.4
MOST = 3000  # responses read, of each kind


def by_tarfile(paths: list[Path]) -> Iterator[np.ndarray]:
    """Responses of tar files, their labels parsed too."""
    for path in paths:
        with tarfile.open(path) as tar:
            for member in tar:
                data = tar.extractfile(member)
                assert data is not None
                content = data.read()
                if member.name.endswith(".npy"):
                    yield np.load(io.BytesIO(content))
                else:
                    json.loads(content)


def by_library(paths: list[Path]) -> Iterator[np.ndarray]:
    """The same by `webdataset`, whose samples are dicts."""
    import webdataset

    for sample in webdataset.WebDataset([str(p) for p in paths], shardshuffle=False).decode():
        yield sample["npy"]


def by_reader(folder: Path) -> Iterator[np.ndarray]:
    """Pairs of a dataset at random."""
    with ss.open_dataset(folder, RATE) as ds:
        for s, l in ds.sample(MOST, 0):
            yield ds.binaural(s, l, 0.0)


def report(name: str, make: Callable[[], Iterator[np.ndarray]]) -> None:
    """Print responses and MB of samples per processor's second; the first is not counted."""
    responses = make()
    next(responses)
    start, count, size = time.process_time(), 0, 0
    for rir in responses:
        count, size = count + 1, size + rir.nbytes
        if count == MOST:
            break
    seconds = time.process_time() - start
    print(f"{name:<44s}{count / seconds:9.0f}{size / seconds / 1e6:9.0f}", flush=True)


def loaders(paths: list[Path], folder: Path) -> None:
    """Print responses per second by the clock, through torch's DataLoader with two workers."""
    try:
        import torch
        import webdataset
    except ImportError:
        print("torch or webdataset is not installed: no DataLoader")
        return
    from soundspaces_sim.dataset.torch_dataset import TorchRirDataset

    streamed = (
        webdataset.WebDataset([str(p) for p in paths], shardshuffle=False).decode().to_tuple("npy")
    )
    with ss.open_dataset(folder, RATE) as ds:
        samples = max(len(np.asarray(ds.binaural(*pair, 0.0))[0]) for pair in ds.sample(8, 0))
        data = TorchRirDataset(ds, np.array(ds.sample(MOST, 0)), samples, headings_deg=(0.0,))
        print("\ntorch's DataLoader, two workers, responses per second by the clock")
        for name, source, batch in (
            ("tar files, webdataset", streamed, None), ("echograms, TorchRirDataset", data, 32),
        ):  # fmt: skip
            loader = iter(torch.utils.data.DataLoader(source, batch_size=batch, num_workers=2))
            next(loader)
            start, count = time.perf_counter(), 0
            for found in loader:
                count += len(found["rir"]) if batch else 1
            print(f"{name:<44s}{count / (time.perf_counter() - start):9.0f}", flush=True)


def main() -> None:
    scene = ss.load_scene("demo")
    with tempfile.TemporaryDirectory() as temporary:
        base = Path(temporary)
        echograms = build(scene, base / "e", SPACING)
        waveforms = build(scene, base / "w", SPACING, store="waveform", rate=RATE)
        with ss.open_dataset(echograms, RATE) as ds:
            plan = plan_webdataset(ds, base / "tars", (0.0,))
            start = time.process_time()
            carry_out(plan)
            paths = sorted((base / "tars").glob("*.tar"))
            size = sum(p.stat().st_size for p in paths)
            print(
                f"export webdataset: {len(ds)} responses, {len(paths)} files, {size / 1e6:.0f} MB, "
                f"{len(ds) / (time.process_time() - start):.0f} responses per processor's second"
            )
        print(f"\n{'binaural at 16 kHz, one core':<44s}{'/s':>9s}{'MB/s':>9s}")
        report("echograms, rendered on reading", lambda: by_reader(echograms))
        report("ambisonic waveforms, rendered on reading", lambda: by_reader(waveforms))
        try:
            report("tar files, webdataset", lambda: by_library(paths))
        except ImportError:
            print("webdataset is not installed")
        report("tar files, tarfile", lambda: by_tarfile(paths))
        loaders(paths, echograms)


if __name__ == "__main__":
    main()
