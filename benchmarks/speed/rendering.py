"""From energy to sound: responses per second.

Question: How many responses per second does a core render?

Method: Responses of 1 s of an echogram of the demo apartment, early reflections included, per second of one
core's processor time, at 16 and 44.1 kHz. Batches of 64 by the clock, in threads, beside a loop over the same
64.

Amortised: The first call of each kind, which designs filters and loads the HRTF set.

Takes: A minute.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable

import soundspaces_sim as ss
from benchmarks.tools.clocks import per_second
from benchmarks.tools.record import Table, table

_BATCH, _ROUNDS = 64, 5


def one_second(scene: ss.Scene) -> ss.Echogram:
    """A second of an echogram of the demo apartment, early reflections included."""
    config = ss.SimulationConfig(duration=1.0)
    return ss.simulate(scene, [[2.4, 2.7, 1.5]], [[5.0, 6.5, 1.5]], config)[0, 0]


def _by_the_clock(run: Callable[[], object]) -> float:
    """Responses per second of a call that makes `_BATCH`, best of some."""
    run()
    seconds = []
    for _ in range(_ROUNDS):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return _BATCH / min(seconds)


def run() -> list[Table]:
    """Rates."""
    echogram = one_second(ss.load_scene("demo"))
    turns = [(h, 0.0, 0.0) for h in (0.0, 90.0, 180.0, 270.0)]
    rows = []
    for rate in (16000, 44100):

        def ambisonic(k: int, rate: int = rate) -> object:
            return ss.ambisonic_rir(echogram, rate, k)

        def binaural(k: int, rate: int = rate) -> object:
            return ss.binaural_rir(ss.ambisonic_rir(echogram, rate, k), rate, 10.0 * k)

        def four(k: int, rate: int = rate) -> object:
            return ss.binaural_rirs(ss.ambisonic_rir(echogram, rate, k), rate, turns)

        def batch(rate: int = rate) -> object:
            return ss.ambisonic_rirs([echogram] * _BATCH, rate)

        def loop(rate: int = rate) -> object:
            return [ss.ambisonic_rir(echogram, rate, s) for s in range(_BATCH)]

        rates = [per_second(ambisonic), per_second(binaural), 4.0 * per_second(four)]
        rows.append((rate, *rates, _by_the_clock(batch), _by_the_clock(loop)))
    heads = [
        ("rate", "Hz"), ("ambisonic", "1/s"), ("binaural", "1/s"), ("at four headings", "1/s"),
        (f"batch of {_BATCH}, by the clock", "1/s"), (f"loop of {_BATCH}, by the clock", "1/s"),
    ]  # fmt: skip
    title = f"Responses of 1 s, {len(echogram.early)} early reflections, per second of one core"
    return [table(title, heads, rows)]
