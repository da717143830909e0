"""Responses as tensors: per second, on a processor or on a GPU.

Question: How many responses per second does a device make, beside the reader and beside others' programs?

Method: Random pairs of the demo apartment (100 subpaths, echograms kept on the device), in batches of 256, 1 s at
16 kHz. Ways of rendering take turns, and each has the best of its rounds by the clock, after one that is not
counted, for other work on the machine only ever takes time; every answer is on the device when the clock stops. The
reader in as many threads as the process has cores. Shoeboxes of pyroomacoustics (image sources to order 10) and of
torchrir (the same), where they are installed, with one microphone. With `cpu` (the default) the processor is timed;
`python -m benchmarks run speed.torch_rendering -- cuda` takes a GPU.

Amortised: Opening the dataset, copying it to the device, designing filters.

Takes: 3 minutes. Arguments: the device, rounds (5), pairs of a round (256; of a GPU 2,048).
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
from soundspaces_sim.core.numerics.threads import core_count

_BATCH = 256
_SIZE, _SOURCE, _MICROPHONE = [6.0, 5.0, 2.7], [1.5, 1.2, 1.4], [4.1, 3.3, 1.6]
_ORDER, _RATE, _SHOEBOXES = 10, 16000, 20


def build(out: Path) -> Path:
    """The demo apartment, responses of 1 s."""
    job = ss.JobConfig(
        grid=ss.GridConfig(spacing=1.0), simulation=ss.SimulationConfig(walks=100, duration=1.0)
    )
    return ss.build_dataset(ss.load_scene("demo"), out, job).folder


def _seconds(make: Callable[[np.ndarray], Any], pairs: np.ndarray, wait: Callable[[], None]) -> float:
    """By the clock, for all pairs."""
    start = time.perf_counter()
    for first in range(0, len(pairs), _BATCH):
        make(pairs[first : first + _BATCH])
    wait()
    return time.perf_counter() - start


def _of_dataset(folder: Path, device: str, rounds: int, count: int) -> list[tuple[object, ...]]:
    import torch

    import soundspaces_sim.torch as for_torch

    def wait() -> None:
        if device != "cpu":
            torch.cuda.synchronize()

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
        best = dict.fromkeys(makers, np.inf)
        for turn in range(rounds + 1):
            for name, make in makers.items():
                some = pairs[:_BATCH] if name.startswith("reader") else pairs
                taken = _seconds(make, some, wait) / len(some)
                best[name] = min(best[name], taken if turn > 0 else np.inf)
    rates = [1.0 / seconds for seconds in best.values()]
    of_reader = [rates[0], rates[1], *rates[:2], rates[1]]
    return [
        (name, rate, rate / beside) for name, rate, beside in zip(makers, rates, of_reader, strict=True)
    ]


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

        rows.append(("pyroomacoustics, shoebox, order 10, one microphone", _repeated(one), None))
    if find_spec("torchrir"):
        import torchrir
        from torchrir.config import SimulationConfig
        from torchrir.sim import simulate

        room = torchrir.Room.shoebox(size=_SIZE, fs=_RATE, beta=[0.8**0.5] * 6)
        scene = torchrir.StaticScene(
            room=room,
            sources=torchrir.Source.from_positions([_SOURCE]),
            mics=torchrir.MicrophoneArray.from_positions([_MICROPHONE]),
        )
        config = SimulationConfig(max_order=_ORDER, nsample=_RATE, device=device)
        made = _repeated(lambda: simulate(scene, config))
        rows.append((f"torchrir on {device}, shoebox, order 10, one microphone", made, None))
    return rows


def _repeated(make: Callable[[], Any]) -> float:
    """Per second."""
    make()
    start = time.perf_counter()
    for _ in range(_SHOEBOXES):
        make()
    return _SHOEBOXES / (time.perf_counter() - start)


def run(device: str = "cpu", rounds: str = "5", pairs: str = "") -> list[Table]:
    """Rates on a device."""
    if not find_spec("torch"):
        raise UnavailableError("PyTorch is not installed (extra torch)")
    import torch

    if device.startswith("cuda") and not torch.cuda.is_available():
        raise UnavailableError("no GPU that PyTorch can use")
    name = "the processor" if device == "cpu" else torch.cuda.get_device_name(device)
    count = int(pairs) if pairs else (_BATCH if device == "cpu" else 8 * _BATCH)
    with tempfile.TemporaryDirectory() as temporary:
        rows = _of_dataset(build(Path(temporary)), device, int(rounds), count)
    rows += _shoeboxes(device)
    return [
        table(
            f"Responses of 1 s at 16 kHz per second, {name}",
            ["", ("responses", "1/s"), "over the reader's"],
            rows,
            "The last of our rows is beside the reader's binaural one, which convolves nothing. Of other programs "
            "the time of one room after the other: image sources alone, one channel. gpuRIR needs CUDA to be "
            "compiled; its authors state some 100 times the speed of libraries on a processor "
            "(doi:10.1007/s11042-020-09905-3). FRA-RIR is no package, and its code is not for commercial use.",
        )
    ]
