"""Reading for training: WebDataset tar files beside the dataset they were exported from, in one run.

Question: How much faster is streaming exported responses than rendering them on reading?

Method: Binaural responses at 16 kHz of the demo apartment, one core, per second of the processor: rendered from
echograms at random, rendered from stored ambisonic waveforms at random, the tar files by the library
`webdataset`, and by Python's tarfile alone. Where torch is there, also by the clock through its DataLoader with
two workers.

Amortised: The first response of each kind; files are in the page cache (just written, as what a loader has
fetched is). The export is timed by itself.

Takes: 4 minutes. Needs webdataset (benchmarks/requirements.txt).
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
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import soundspaces_sim as ss
from benchmarks.speed.dataset import build
from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.dataset.exporters.plan import carry_out
from soundspaces_sim.dataset.exporters.webdataset import plan_webdataset

MEASURES = ("core", "echogram", "rendering", "dataset")
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


def _rate(name: str, make: Callable[[], Iterator[np.ndarray]]) -> tuple[str, float, float]:
    """Responses and MB of samples per second of the processor; the first is not counted."""
    responses = make()
    next(responses)
    start, count, size = time.process_time(), 0, 0
    for rir in responses:
        count, size = count + 1, size + rir.nbytes
        if count == MOST:
            break
    seconds = time.process_time() - start
    return name, count / seconds, size / seconds / 1e6


def _loaders(paths: list[Path], folder: Path) -> Table:
    import torch
    import webdataset

    from soundspaces_sim.dataset.torch_dataset import TorchRirDataset

    streamed = (
        webdataset.WebDataset([str(p) for p in paths], shardshuffle=False).decode().to_tuple("npy")
    )
    rows = []
    with ss.open_dataset(folder, RATE) as ds:
        samples = max(len(np.asarray(ds.binaural(*pair, 0.0))[0]) for pair in ds.sample(8, 0))
        data = TorchRirDataset(ds, np.array(ds.sample(MOST, 0)), samples, headings_deg=(0.0,))
        for name, source, batch in (
            ("tar files, webdataset", streamed, None), ("echograms, TorchRirDataset", data, 32),
        ):  # fmt: skip
            loader = iter(torch.utils.data.DataLoader(source, batch_size=batch, num_workers=2))
            next(loader)
            start, count = time.perf_counter(), 0
            for found in loader:
                count += len(found["rir"]) if batch else 1
            rows.append((name, count / (time.perf_counter() - start)))
    return table(
        "Through torch's DataLoader, two workers, by the clock", ["", ("responses", "1/s")], rows
    )


def run() -> list[Table]:
    """Export, rates, loaders."""
    if not find_spec("webdataset"):
        raise UnavailableError("the package webdataset is not installed")
    scene = ss.load_scene("demo")
    with tempfile.TemporaryDirectory() as temporary:
        base = Path(temporary)
        echograms, _ = build(scene, base / "e", SPACING)
        waveforms, _ = build(scene, base / "w", SPACING, store="waveform", rate=RATE)
        with ss.open_dataset(echograms, RATE) as ds:
            plan = plan_webdataset(ds, base / "tars", (0.0,))
            start = time.process_time()
            carry_out(plan)
            paths = sorted((base / "tars").glob("*.tar"))
            size = sum(p.stat().st_size for p in paths)
            export = (len(ds), len(paths), size / 1e6, len(ds) / (time.process_time() - start))
        rows = [
            _rate("echograms, rendered on reading", lambda: by_reader(echograms)),
            _rate("ambisonic waveforms, turned into binaural on reading", lambda: by_reader(waveforms)),
            _rate("tar files by the library webdataset", lambda: by_library(paths)),
            _rate("tar files by Python's tarfile", lambda: by_tarfile(paths)),
        ]
        tables = [
            table(
                "`export webdataset`, binaural at 16 kHz",
                ["responses", "files", ("size", "MB"), ("rate", "responses per second of the processor")], [export],
            ),
            table("Binaural at 16 kHz, one core", ["", ("responses", "1/s"), ("samples", "MB/s")], rows),
        ]  # fmt: skip
        return [*tables, *([_loaders(paths, echograms)] if find_spec("torch") else [])]
