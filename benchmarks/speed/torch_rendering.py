"""Responses as tensors: per second, on a processor or on a GPU.

Question: How many responses per second does a device make, beside the reader and beside others' programs?

Method: 2,048 random pairs of the demo apartment (100 subpaths, echograms kept on the device), in batches, 1 s at 16
kHz, by the clock after a batch that is not counted; every answer is on the device when the clock stops. The reader
in as many threads as the process has cores. Shoeboxes of pyroomacoustics (image sources to order 10) and torchrir
(the same), where they are installed, with one microphone. `python -m benchmarks run speed.torch_rendering -- cuda`
takes a GPU; with `cpu` (the default) it is what the processor does.

Amortised: Opening the dataset, copying it to the device, designing filters.

Takes: 3 minutes.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.core.numerics.kernel import core_count

_BATCH = 256
_SIZE, _SOURCE, _MICROPHONE = [6.0, 5.0, 2.7], [1.5, 1.2, 1.4], [4.1, 3.3, 1.6]
_ORDER, _RATE, _SHOEBOXES = 10, 16000, 20


def build(out: Path) -> Path:
    """The demo apartment, responses of 1 s."""
    job = ss.JobConfig(
        grid=ss.GridConfig(spacing=1.0), simulation=ss.SimulationConfig(walks=100, duration=1.0)
    )
    return ss.build_dataset(ss.load_scene("demo"), out, job).folder


def _rate(make: Callable[[np.ndarray], Any], pairs: np.ndarray, wait: Callable[[], None]) -> float:
    """Responses per second."""
    make(pairs[:_BATCH])
    wait()
    start = time.perf_counter()
    for first in range(0, len(pairs), _BATCH):
        make(pairs[first : first + _BATCH])
    wait()
    return len(pairs) / (time.perf_counter() - start)


def _of_dataset(folder: Path, device: str, count: int) -> list[tuple[object, ...]]:
    import torch

    import soundspaces_sim.torch as for_torch

    def wait() -> None:
        if device != "cpu":
            torch.cuda.synchronize()

    rows: list[tuple[object, ...]] = []
    with ss.open_dataset(folder, rate=_RATE) as ds:
        pairs = ds.sample(count, 0)
        renderer = for_torch.Renderer(ds, device)
        speech = torch.randn(_BATCH, 4 * _RATE, device=device)
        threads = core_count()
        makers: dict[str, Callable[[np.ndarray], Any]] = {
            f"reader, {threads} threads, ambisonic": lambda p: ds.get_batch(
                p, "ambisonic", workers=threads
            ),
            f"reader, {threads} threads, binaural": lambda p: ds.get_batch(
                p, "binaural", workers=threads
            ),
            f"renderer on {device}, ambisonic": renderer.ambisonic,
            f"renderer on {device}, binaural": lambda p: renderer.binaural(
                p, np.linspace(0.0, 350.0, len(p))
            ),
            f"renderer on {device}, binaural, and 4 s of speech through each": lambda p: renderer.render(
                speech[: len(p)], p
            ),
        }
        for name, make in makers.items():
            some = pairs[:_BATCH] if name.startswith("reader") else pairs
            rows.append((name, _rate(make, some, wait)))
    return rows


def _shoeboxes(device: str) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    if find_spec("pyroomacoustics"):
        import pyroomacoustics

        def one() -> None:
            material = pyroomacoustics.Material(0.2)
            room = pyroomacoustics.ShoeBox(_SIZE, _RATE, materials=material, max_order=_ORDER)
            room.add_source(_SOURCE)
            room.add_microphone(_MICROPHONE)
            room.compute_rir()

        rows.append(("pyroomacoustics, shoebox, order 10, one microphone", _repeated(one)))
    if find_spec("torchrir"):
        import torch
        import torchrir

        def two() -> None:
            room = torchrir.Room.shoebox(_SIZE, fs=_RATE, beta=[0.8**0.5] * 6, device=device)
            torchrir.simulate_rir(
                room=room,
                sources=torch.tensor([_SOURCE], device=device),
                mics=torch.tensor([_MICROPHONE], device=device),
                max_order=_ORDER,
                nsample=_RATE,
            )

        rows.append((f"torchrir on {device}, shoebox, order 10, one microphone", _repeated(two)))
    return rows


def _repeated(make: Callable[[], None]) -> float:
    make()
    start = time.perf_counter()
    for _ in range(_SHOEBOXES):
        make()
    return _SHOEBOXES / (time.perf_counter() - start)


def run(device: str = "cpu", pairs: str = "2048") -> list[Table]:
    """Rates on a device."""
    if not find_spec("torch"):
        raise UnavailableError("PyTorch is not installed (extra torch)")
    import torch

    if device.startswith("cuda") and not torch.cuda.is_available():
        raise UnavailableError("no GPU that PyTorch can use")
    name = "the processor" if device == "cpu" else torch.cuda.get_device_name(device)
    with tempfile.TemporaryDirectory() as temporary:
        rows = _of_dataset(build(Path(temporary)), device, int(pairs))
    rows += _shoeboxes(device)
    return [
        table(
            f"Responses of 1 s at 16 kHz per second, {name}",
            ["", ("responses", "1/s")],
            rows,
            "Of other programs the time of one room after the other, image sources alone.",
        )
    ]
