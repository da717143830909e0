"""How many responses of random rooms for speech a core makes: ours, and pyroomacoustics' for the same rooms.

Question: How many responses of small random rooms, with an array of microphones each, does a core make per second?

Method: Rooms as `RoomStream` draws them: shoeboxes of 2.5 to 10 m, surfaces of database materials in octaves, one
to four talkers, two to eight microphones within 0.2 m, 16 kHz. Processor seconds of one thread from the drawn room
to its responses (talkers × microphones), all programs in turn for every room. Ours is `RoomStream.item`, which also
draws the room, gives talkers their directivity, cuts targets and has labels with standard errors; furnished rooms
are ours alone. pyroomacoustics gets size, materials and places, by its fastest way (all talkers and microphones in
one call): image sources to an order, and to order 3 with ray tracing beyond. Errors of rates are standard errors
over rooms (of a ratio of sums); of measures, medians of what the labels state; none is known of the other program.
`speed.alternatives` compares at equal error.

Amortised: Nothing: every room is new. Kernels are compiled, and a first room is not counted.

Takes: Five minutes. Arguments: rooms (12), subpaths with commas (100,1000,3000). pyroomacoustics if it is there.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.speech_rooms import box_responses, drawn_box
from soundspaces_sim.build.random_rooms import RoomKind
from soundspaces_sim.build.rooms import ROOM_CONFIG
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count

MEASURES = ("core", "scene", "transport", "echogram", "rendering", "build")
RATE = 16000
_BOX: tuple[RoomKind, ...] = ("shoebox",)
_ORDERS = (10, 17)
_RAYS = 1000
_NOTE = (
    "Published of GPUs: gpuRIR (image sources), about 100 times as fast as libraries for CPUs (abstract, "
    "Diaz-Guerra et al., 2020); FAST-RIR, a network, 12 times as fast as gpuRIR (abstract, Ratnarajah et al., "
    "2021). FRA-RIR (random approximation of image sources) says significantly faster than others, on a CPU "
    "(its README); no time of a response was at hand."
)
Run = tuple[float, int, dict[str, Any] | None]  # seconds, responses, and our item


def _ours(walks: int, kinds: Sequence[RoomKind]) -> Callable[[int], Run]:
    config = msgspec.structs.replace(ROOM_CONFIG, walks=walks)
    stream = ss.RoomStream(rate=RATE, config=config, kinds=kinds)

    def run(number: int) -> Run:
        start = time.process_time()
        item = stream.item(number)
        return time.process_time() - start, item["rir"].shape[0] * item["rir"].shape[1], item

    return run


def _theirs(order: int, rays: int) -> Callable[[int], Run]:
    def run(number: int) -> Run:
        room = drawn_box(number)
        start = time.process_time()
        found = box_responses(room, RATE, order, rays)
        return time.process_time() - start, sum(len(of_one) for of_one in found), None

    return run


def _row(name: str, setting: str, runs: Sequence[Run]) -> tuple[object, ...]:
    """Rate and its standard error, seconds of a room, errors of labels at 775 to 3409 Hz."""
    seconds, made = np.array([r[0] for r in runs]), np.array([r[1] for r in runs], float)
    rate = made.sum() / seconds.sum()
    error = np.std(made - rate * seconds, ddof=1) / np.sqrt(len(runs)) / seconds.mean()
    items = [item for *_, item in runs if item is not None]
    stated: list[float | None] = [None, None]
    if items:
        t30 = np.concatenate([item["t30_error"][:, 2] / item["t30"][:, 2] for item in items])
        c50 = np.concatenate([item["c50_error"][:, 2] for item in items])
        stated = [100.0 * float(np.nanmedian(t30)), float(np.nanmedian(c50))]
    return name, setting, int(made.sum()), float(rate), float(error), float(np.median(seconds)), *stated


def run(rooms: str = "12", subpaths: str = "100,1000,3000") -> list[Table]:
    """The table."""
    cases: dict[tuple[str, str], Callable[[int], Run]] = {}
    for walks in subpaths.split(","):
        cases["ours, shoeboxes", f"{walks} subpaths"] = _ours(int(walks), _BOX)
    cases["ours, furnished rooms", f"{subpaths.split(',')[0]} subpaths"] = _ours(
        int(subpaths.split(",")[0]), ("furnished",)
    )
    note = _NOTE
    if importlib.util.find_spec("pyroomacoustics") is None:
        note = f"pyroomacoustics is not installed. {note}"
    else:
        for order in _ORDERS:
            cases["pyroomacoustics, shoeboxes", f"image sources to order {order}"] = _theirs(order, 0)
        hybrid = f"order 3 and {_RAYS} rays"
        cases["pyroomacoustics, shoeboxes", hybrid] = _theirs(3, _RAYS)
    before = thread_count()
    set_thread_count(1)
    runs: dict[tuple[str, str], list[Run]] = {case: [] for case in cases}
    try:
        for number in range(int(rooms) + 1):
            for case, make in cases.items():
                made = make(number)
                if number:  # the first one loads kernels
                    runs[case].append(made)
    finally:
        set_thread_count(before)
    heads = [
        "program",
        "setting",
        "responses",
        ("rate", "1/s"),
        ("its standard error", "1/s"),
        ("median of a room", "s"),
        ("T30 error", "%"),
        ("C50 error", "dB"),
    ]
    rows = [_row(*case, of_case) for case, of_case in runs.items()]
    return [table(f"Responses per core-second, {rooms} rooms", heads, rows, note)]
