"""T60 and C50 of measured rooms, by estimators that were trained on simulated ones.

Question: How well does a blind estimator of T60 and C50, trained on responses of random rooms, do in measured
rooms: on our responses, and on pyroomacoustics'?

Method: Four training sets of the same numbers of rooms, each with two talkers and a microphone: rooms of all
kinds of `RoomStream`, its shoeboxes, and the same boxes (size, materials, places) in pyroomacoustics, by image
sources (to the order that its `inverse_sabine` has for the room's reverberation time by Sabine's formula, at most
80), and to order 3 with ray tracing beyond. Ours have talkers' directivity and air absorption, theirs air
absorption. Labels are measured in the responses: T30 (T20 of simulated ones that end before it) and C50 from 775
to 3409 Hz, in measured rooms from the decay without noise (`dataset.measured.responses`). Heard are 4 s of
synthetic speech in noise 20 to 40 dB below it, the same for all sets. Estimators are those of the task
`reverberation`: a ridge regression on decay rates, and a network (if PyTorch is there), three seeds. Test: every
channel of the responses of rooms in public repositories (`benchmarks/tools/measured_responses.py`), eight times
with other speech; and rooms of the own training set that were not trained on. Every measured room weighs the
same. Those count whose T60 is 0.2 to 1.5 s, as that of rooms for speech is. Root mean square errors; intervals of
95 % by bootstrap over rooms and seeds; differences from the first set over the same rooms, drawn alone.

Amortised: Nothing is timed.

Takes: 20 minutes. Arguments: rooms for training (200). Needs the repositories, in the folder that
MEASURED_RESPONSES names; pyroomacoustics for its sets.
"""

from __future__ import annotations

import importlib.util
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student
from soundspaces_tasks.fits import ridge, torch_missing
from soundspaces_tasks.results import interval, root
from soundspaces_tasks.reverberation import (
    BAND,
    Examples,
    heard_mel,
    label_weights,
    rate_features,
)
from soundspaces_tasks.setting import RATE, Setting

import soundspaces_sim as ss
from benchmarks.tools.measured_responses import ROOMS, MeasuredResponses
from benchmarks.tools.record import Cell, Table, UnavailableError, table
from benchmarks.tools.speech_rooms import box_responses, drawn_box
from soundspaces_sim.build.random_rooms import KINDS
from soundspaces_sim.build.rooms import in_processes
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.dataset.measured.responses import response_measures
from soundspaces_sim.dataset.measured.room import MEASURED
from soundspaces_sim.echogram.measures import waveform_measures
from soundspaces_sim.nav.evaluate import Interval

MEASURES = ("core", "scene", "transport", "echogram", "rendering", "build", "nav")
OURS, BOXES = "ours, rooms of all kinds", "ours, shoeboxes"
_THEIRS: dict[str, tuple[int | None, int]] = {
    "pyroomacoustics, image sources": (None, 0),
    "pyroomacoustics, order 3 and 1000 rays": (3, 1000),
}
_BAND = DEFAULT_BANDS[BAND : BAND + 2]  # Hz
_T60 = (0.2, 1.5)  # s, of measured rooms that count
_TALKERS = (2, 2)
_SPEECHES = {"train": 2, "test": 8}
_OWN = 40  # rooms of the own set to choose a network by, and as many to test it on
_SEEDS, _UPDATES = 3, 600
_STREAM = 0x3EA5
_DRAWS = 4000


class _Heard(NamedTuple):
    """Of one piece of speech: log-mel energies, decay-rate features, and ln T60 and C50 of the response."""

    mel: np.ndarray
    rates: np.ndarray
    labels: np.ndarray


class _Task(NamedTuple):
    """A room of a training set (`room` its number), or a measured one."""

    of: str
    room: int | MeasuredResponses
    speeches: int
    stream: int


@cache
def _stream(of: str) -> ss.RoomStream:
    kinds = KINDS if of == OURS else ("shoebox",)
    return ss.RoomStream(rate=RATE, kinds=kinds, sources=_TALKERS, microphones=(1, 1))


def _responses(task: _Task) -> list[np.ndarray]:
    if isinstance(task.room, MeasuredResponses):
        return task.room.read()
    if task.of in _THEIRS:
        box = drawn_box(task.room, _TALKERS, (1, 1))
        return list(box_responses(box, RATE, *_THEIRS[task.of])[0])
    return list(_stream(task.of).item(task.room)["rir"][:, 0].astype(float))


def _labels(response: np.ndarray, noise: bool) -> np.ndarray:
    """(2,) ln T60 and C50, NaN where one is not known, as where noise hides it."""
    if noise:
        found = dict(zip(MEASURED, response_measures(response, RATE, _BAND)[:, 0], strict=True))
        t30 = float(found["t30"])
    else:
        measures = waveform_measures(response, RATE, (0.5 * _BAND[0], *_BAND))
        t30 = float(measures.t30[1] if np.isfinite(measures.t30[1]) else measures.t20[1])
    onset = int(np.argmax(np.abs(response) >= 0.1 * np.abs(response).max()))
    early, late = (
        float(np.sum(part**2)) for part in np.split(_in_band(response)[onset:], [int(0.05 * RATE)])
    )
    with np.errstate(divide="ignore"):
        return np.array([np.log(t30), 10.0 * np.log10(early / late) if late else np.nan])


def _in_band(response: np.ndarray) -> np.ndarray:
    frequency = np.fft.rfftfreq(2 * len(response), 1.0 / RATE)
    inside = (frequency >= _BAND[0]) & (frequency < _BAND[1])
    return np.fft.irfft(np.fft.rfft(response, 2 * len(response)) * inside)[: len(response)]


def _hear(task: _Task) -> list[_Heard]:
    """What is heard in a room, of responses whose labels are known."""
    rng = np.random.default_rng((_STREAM, task.stream))
    out = []
    for response in _responses(task):
        labels = _labels(response, isinstance(task.room, MeasuredResponses))
        if not np.isfinite(labels).all():
            continue
        for _ in range(task.speeches):
            mel = heard_mel(response[None], rng)
            out.append(_Heard(mel, rate_features(mel), labels))
    return out


def _columns(rooms: list[list[_Heard]]) -> Examples:
    """All that was heard, labels taken as exact, and the row of each one's room."""
    rows = [(*one, row) for row, room in enumerate(rooms) for one in room]
    mel, rates, labels, home = (np.stack(column) for column in zip(*rows, strict=True))
    return Examples(mel, rates, labels, np.zeros_like(labels), home)


def _setting(train: int, measured: int) -> Setting:
    """Rooms in this order: trained on, to choose by, of the own set, measured."""
    names = [f"room {k}" for k in range(train + 2 * _OWN + measured)]
    parts = np.split(np.array(names), [train, train + _OWN])
    splits = {s: tuple(map(str, p)) for s, p in zip(("train", "val", "test"), parts, strict=True)}
    return Setting(Path(), splits, (train,), _SEEDS, updates=_UPDATES)


def _estimates(data: Examples, setting: Setting) -> dict[str, np.ndarray]:
    """(S, n, 2) labels found for the rooms tested, by method."""
    count = setting.homes[0]
    use, test = setting.within("train", data.home), setting.within("test", data.home)
    weights = label_weights(data.labels, data.errors, data.labels[use].std(axis=0))
    fitted = ridge(data.rates[use], data.labels[use], weights[use])(data.rates[test])
    found = {"decay rates": fitted[None]}
    if torch_missing() is None:
        from soundspaces_tasks.learnt import reverberation

        runs = [reverberation(data, weights, setting, count, seed) for seed in range(_SEEDS)]
        found["network"] = np.stack(runs)
    return found


def _scores(off: np.ndarray, room: np.ndarray) -> tuple[str, float, str]:
    """Of (S, n, 2) errors in rooms (n,), all of the same weight: that of T60 and its mean, %, and that of C50."""
    row = np.unique(room, return_inverse=True)[1]
    weights = 1.0 / np.bincount(row)[row]
    t60, c50 = (interval(off[..., k] ** 2, row, weights, root) for k in range(2))
    bias = 100.0 * float((off[..., 0] * weights).sum() / weights.sum() / len(off))
    return _text(t60, 100.0, 1), bias, _text(c50, 1.0, 2)


def _difference(squares: np.ndarray, base: np.ndarray, room: np.ndarray) -> Interval:
    """Root mean squares of (S, n) `squares` less those of `base`, over the same rooms, all of the same weight; the
    bootstrap draws rooms alone, of means over seeds."""
    names, row = np.unique(room, return_inverse=True)
    count = len(names)
    own, other = (np.bincount(row, s.mean(axis=0)) / np.bincount(row) for s in (squares, base))
    drawn = np.random.default_rng(0).multinomial(count, np.full(count, 1.0 / count), _DRAWS) / count
    error = float(np.std(np.sqrt(drawn @ own) - np.sqrt(drawn @ other), ddof=1))
    error *= float(np.sqrt(count / (count - 1)))
    mean = float(np.sqrt(own.mean()) - np.sqrt(other.mean()))
    reach = float(student.ppf(0.975, count - 1)) * error
    return Interval(mean, mean - reach, mean + reach, error)


def _text(found: Interval, scale: float, digits: int, sign: str = "") -> str:
    value, low, high = (f"{scale * x:{sign}.{digits}f}" for x in (found.mean, found.low, found.high))
    return f"{value} ({low} to {high})"


class _Tested(NamedTuple):
    """Of a training set: what was heard in the rooms tested, the labels found there (by method), and what a reader
    has to know of the set."""

    data: Examples
    found: dict[str, np.ndarray]
    fact: str


def _tested(of: str, train: int, measured: list[list[_Heard]]) -> _Tested:
    rooms = train + 2 * _OWN
    tasks = [_Task(of, k, _SPEECHES["train" if k < rooms - _OWN else "test"], k) for k in range(rooms)]
    own = list(in_processes(_hear, tasks))
    data = _columns(own + measured)
    setting = _setting(train, len(measured))
    found = _estimates(data, setting)
    use = setting.within("train", data.home)
    low, high = np.exp(np.quantile(data.labels[use, 0], (0.01, 0.99)))
    without = 1.0 - int(use.sum()) / (train * _TALKERS[0] * _SPEECHES["train"])
    fact = (
        f"{of}: T60 {low:.2f} to {high:.2f} s (98 %), {100.0 * without:.0f} % of the responses have none"
    )
    print(fact, flush=True)
    test = setting.within("test", data.home)
    kept = Examples(*(column[test] for column in data))
    kept = kept._replace(home=kept.home - rooms)  # own ones below 0
    return _Tested(kept, found, fact)


def _sets() -> list[str]:
    installed = importlib.util.find_spec("pyroomacoustics") is not None
    return [OURS, BOXES, *(_THEIRS if installed else ())]


def run(rooms: str = "200") -> list[Table]:
    """Errors by training set and method, and the measured rooms."""
    there = [room for room in ROOMS if room.there]
    if len(there) < 10:
        raise UnavailableError(
            "measured responses: expected checkouts of the repositories of "
            "benchmarks/tools/measured_responses.py in the folder that MEASURED_RESPONSES names"
        )
    speeches = _SPEECHES["test"]
    tasks = [_Task("measured", room, speeches, 10**6 + k) for k, room in enumerate(there)]
    measured = list(in_processes(_hear, tasks))
    kept = [k for k, of_room in enumerate(measured) if of_room]
    names, measured = [there[k].name for k in kept], [measured[k] for k in kept]
    tested = {of: _tested(of, int(rooms), measured) for of in _sets()}
    t60 = np.exp([np.median([one.labels[0] for one in room]) for room in measured])
    inside = (t60 >= _T60[0]) & (t60 <= _T60[1])
    note = f"{inside.sum()} measured rooms count. {'; '.join(t.fact for t in tested.values())}."
    return [_errors(tested, inside, note, int(rooms)), _rooms(tested, names, measured, inside)]


def _errors(tested: dict[str, _Tested], inside: np.ndarray, note: str, rooms: int) -> Table:
    rows: list[tuple[Cell, ...]] = []
    base: dict[str, np.ndarray] = {}  # squares of the first set by method
    for of, (data, found, _) in tested.items():
        measured = (data.home >= 0) & inside[np.maximum(data.home, 0)]
        for method, labels in found.items():
            off = (labels - data.labels)[:, measured]
            squares, room = off[..., 0] ** 2, data.home[measured]
            against = ""
            if method in base:
                against = _text(_difference(squares, base[method], room), 100.0, 1, "+")
            base.setdefault(method, squares)
            t60, bias, c50 = _scores(off, room)
            rows.append((of, method, "measured", t60, bias, against, c50))
            own = data.home < 0
            t60, bias, c50 = _scores((labels - data.labels)[:, own], data.home[own])
            rows.append((of, method, "own", t60, bias, "", c50))
    columns = (
        "trained on", "method", "tested on rooms", "T60, % (95 %)", "T60: mean, %", "against the first set, %",
        "C50, dB (95 %)",
    )  # fmt: skip
    return table(f"T60 and C50 from reverberant speech, {rooms} rooms for training", columns, rows, note)


def _rooms(
    tested: dict[str, _Tested], names: list[str], measured: list[list[_Heard]], inside: np.ndarray
) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for k, (name, of_room) in enumerate(zip(names, measured, strict=True)):
        labels = np.median([one.labels for one in of_room], axis=0)
        row: list[Cell] = [
            name,
            len(of_room) // _SPEECHES["test"],
            float(np.exp(labels[0])),
            float(labels[1]),
        ]
        for data, found, _ in tested.values():
            last = list(found.values())[-1]
            row.append(float(np.exp(np.median(last[:, data.home == k, 0]))))
        rows.append((*row, "yes" if inside[k] else "no"))
    method = list(next(iter(tested.values())).found)[-1]
    columns = ("room", "responses", "T60, s", "C50, dB", *(f"{of}, s" for of in tested), "counts")
    return table(f"The measured rooms, and their T60 as found by {method}", columns, rows)
