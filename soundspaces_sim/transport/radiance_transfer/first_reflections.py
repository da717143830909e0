"""First events of a point's walks: all of them, and those that go on along shared walks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import compensate
from soundspaces_sim.transport.state import Firsts
from soundspaces_sim.transport.tables import BATCHES
from soundspaces_sim.transport.tile import Side

_STREAM = 0x51D1  # keeps these numbers apart from those of the walks
_AT_A_TIME = 4096  # events


@dataclass
class FirstReflections:
    """First diffuse reflections of a side's points: `side.once(FirstReflections.of)`.

    `blocks`: of consecutive points, packed; `room`: for those of points that are traced together.
    """

    blocks: list[Firsts] = field(default_factory=list)
    room: Firsts | None = None

    @staticmethod
    def of(side: Side) -> FirstReflections:  # noqa: ARG004 - none yet
        return FirstReflections()


class Events(NamedTuple):
    """`Firsts` of N points in one piece, flattened: batch k of point i is `start[i, k]` to `start[i, k + 1]`."""

    start: np.ndarray  # (N, BATCHES + 1)
    patch: np.ndarray
    length: np.ndarray
    walk: np.ndarray
    energy: np.ndarray
    direction: np.ndarray  # (N, BATCHES, walks, 3)


class Draws(NamedTuple):
    """First events that go on: of point i, batch k has `index[i, k]`."""

    index: np.ndarray  # (N, BATCHES, n), -1 for none
    scale: np.ndarray  # (N, BATCHES, n) weight of each
    walk: np.ndarray  # (N, BATCHES, n) which of a patch's shared walks


def packed(firsts: Firsts) -> Firsts:
    """The same of all points in one row, copied, without the room that was left."""
    *columns, direction, upto = firsts
    used = upto[:, -1]
    rows = [np.concatenate([of_point[:n] for of_point, n in zip(c, used, strict=True)]) for c in columns]
    return Firsts(*(row[None] for row in rows), direction.copy(), upto.copy())


def gather_events(parts: list[Firsts], decay: np.ndarray, reach: np.ndarray) -> Events:
    """First events of consecutive points in one piece, without the `decay` (b,) and up to the `reach` (b,) of
    `SharedWalks`. Uses up the `parts`, packed."""
    upto = np.concatenate([part.upto for part in parts])
    before = np.concatenate([[0], np.cumsum(upto[:, -1])])
    start = before[:-1, None] + np.concatenate([np.zeros((len(upto), 1), np.int64), upto], axis=1)
    direction = np.concatenate([part.direction for part in parts])
    columns = [list(column) for column in zip(*(part[:-2] for part in parts), strict=True)]
    parts.clear()
    whole = []
    for column in columns:
        whole.append(np.concatenate(column, axis=1)[0])
        column.clear()
    events = Events(start, *whole, direction)
    over_rows(
        compensate, len(events.length), events.length, decay, reach, events.energy, chunk=_AT_A_TIME
    )
    return events


def draw_events(events: Events, keys: np.ndarray, wanted: int, rows: int) -> Draws:
    """Draw `wanted` first events of every batch, and which of the `rows` shared walks of its patch each follows.

    Batch k follows walks k (mod BATCHES). `keys` (N,) of the points.
    """
    shape = len(events.start), BATCHES, wanted
    draws = Draws(np.empty(shape, np.int64), np.empty(shape, np.float32), np.empty(shape, np.int64))
    most = int(np.diff(events.start, axis=1).max(initial=0))
    over_rows(_draw, shape[0], events, keys, rows, draws, chunk=1, scratch=lambda: np.empty(most))
    return draws


@kernel
def _draw(first, last, events, keys, rows, draws, share):
    """Draw first events of the points `first` to `last`, systematically by their part of a batch's energy."""
    bands = events.energy.shape[1]
    wanted = draws.index.shape[2]
    for i in range(first, last):
        for k in range(BATCHES):
            start, end = events.start[i, k], events.start[i, k + 1]
            share[: end - start] = 0.0
            lit = 0
            for b in range(bands):
                total = 0.0
                for r in range(start, end):
                    total += events.energy[r, b]
                if total > 0.0:
                    lit += 1
                    for r in range(start, end):
                        share[r - start] += events.energy[r, b] / total
            draws.index[i, k, :] = -1
            if lit == 0:
                continue
            key = combine(keys[i], _STREAM + k)
            u, cumulative, taken = hashed_uniform(key, 0), 0.0, 0
            for r in range(start, end):
                part = share[r - start] / lit
                cumulative += part
                upto = min(int(cumulative * wanted + u), wanted)
                for slot in range(taken, upto):
                    draws.index[i, k, slot] = r
                    draws.scale[i, k, slot] = 1.0 / (wanted * part)
                    step = int(hashed_uniform(key, 1 + slot) * (rows // BATCHES))
                    draws.walk[i, k, slot] = k + BATCHES * step
                taken = max(taken, upto)
