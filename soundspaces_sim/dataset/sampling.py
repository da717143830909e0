"""Arguments of the reader, checked: pairs drawn within limits, nearest points, ways by points, padded batches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError, PairIndexError


def draw_pairs(
    table: np.ndarray, count: int, seed: int, limits: Mapping[str, tuple[float, float]], where: str
) -> np.ndarray:
    """(count, 2) of the table's pairs whose columns lie in `limits` (low, high), the same for the same seed.

    Raises `ConfigError` if there is no such column, or no pair within the limits.
    """
    keep = np.ones(len(table), bool)
    for name, (low, high) in limits.items():
        if name not in (table.dtype.names or ()):
            raise ConfigError(
                f"sample: no column '{name}'; there are {', '.join(table.dtype.names or ())}"
            )
        keep &= (table[name] >= low) & (table[name] <= high)
    if not keep.any():
        raise ConfigError(f"sample: none of {len(table)} pairs of {where} is within {dict(limits)}")
    rng = np.random.default_rng(seed)
    chosen = table[keep][rng.integers(0, int(keep.sum()), count)]
    return np.stack([chosen["source"], chosen["listener"]], axis=1).astype(np.int64)


def nearest(points: np.ndarray, position: ArrayLike) -> int:
    """Row of the point (N, 3) nearest to a position (3,), m. Raises `ConfigError`."""
    place = np.asarray(position, float)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ConfigError(f"position: expected three finite coordinates in m, got {position!r}")
    return int(np.linalg.norm(points - place, axis=1).argmin())


def as_pairs(pairs: ArrayLike) -> np.ndarray:
    """(k, 2) int64 pairs; one pair may be given as (2,). Raises `PairIndexError`."""
    rows = np.atleast_2d(np.asarray(pairs))
    if rows.ndim != 2 or rows.shape[1] != 2 or rows.dtype.kind not in "iu":
        raise PairIndexError(f"pairs: expected integers of shape (k, 2), got {rows.dtype} {rows.shape}")
    return rows.astype(np.int64)


def pairs_of_two(count: int) -> np.ndarray:
    """(count² - count, 2) all pairs of two of `count` points, by source and listener."""
    every = np.indices((count, count)).reshape(2, -1).T
    return np.ascontiguousarray(every[every[:, 0] != every[:, 1]])


def check_pairs(rows: np.ndarray, count: int, where: str) -> None:
    """Raise `PairIndexError` unless all of (k, 2) pairs are of the points 0 to `count` - 1 of `where`."""
    bad = ((rows < 0) | (rows >= count)).any(axis=1)
    if bad.any():
        raise PairIndexError(
            f"pair {rows[bad][0].tolist()} is out of range: {where} has points 0 to {count - 1}"
        )


def as_points(points: ArrayLike, what: str) -> np.ndarray:
    """(k,) int64 numbers of points; one may be given alone. Raises `PairIndexError`."""
    rows = np.atleast_1d(np.asarray(points))
    if rows.ndim != 1 or len(rows) == 0 or rows.dtype.kind not in "iu":
        raise PairIndexError(
            f"{what}: expected one or more numbers of points, got {rows.dtype} {rows.shape}"
        )
    return rows.astype(np.int64)


def for_each(given: Any, count: int) -> list[Any]:
    """One thing, or None, for all of `count`, or one each. Raises `ConfigError`."""
    if not isinstance(given, list | tuple):
        return [given] * count
    if len(given) != count:
        raise ConfigError(f"source: expected one or {count}, got {len(given)}")
    return list(given)


class Step(NamedTuple):
    """One of the places that a moving end passes."""

    source: int
    listener: int
    orientation_deg: np.ndarray  # (3,) heading, pitch, roll
    directivity: Any  # of the source; None: omnidirectional


def path_steps(
    sources: ArrayLike, listeners: ArrayLike, orientations_deg: ArrayLike, directivity: Any
) -> tuple[list[Step], Literal["source", "listener"]]:
    """The steps of an end that moves or turns by points at even times, and which end it is.

    Raises `PairIndexError`, `ConfigError`.
    """
    a, b = as_points(sources, "sources"), as_points(listeners, "listeners")
    turns = np.atleast_2d(np.asarray(orientations_deg, float))
    ways = len(directivity) if isinstance(directivity, list | tuple) else 1
    moves = len(a) > 1 or ways > 1
    if moves and (len(b) > 1 or len(turns) > 1):
        raise ConfigError("render_path: a source that moves needs a listener at rest, and the reverse")
    k = max(len(a), len(b), len(turns), ways)
    if any(n not in (1, k) for n in (len(a), len(b), len(turns), ways)):
        raise ConfigError(
            f"render_path: {len(a)} sources, {ways} directivities, {len(b)} listeners and {len(turns)} "
            "orientations do not match"
        )
    if isinstance(directivity, list | tuple) and ways == 1:
        directivity = directivity[0]
    emits = for_each(directivity, k)
    rows = zip(*(np.broadcast_to(x, (k, *x.shape[1:])) for x in (a, b, turns)), emits, strict=True)
    return [Step(int(s), int(l), turn, d) for s, l, turn, d in rows], "source" if moves else "listener"


def in_metres(ends: ArrayLike) -> bool:
    """Whether these are rows (t, x, y, z), not numbers of points."""
    return np.ndim(ends) == 2


def as_way_rows(ends: ArrayLike, what: str, points: np.ndarray, end: float) -> np.ndarray:
    """Rows (t, x, y, z) as they are given, or of points (N, 3) m by number, at even times from 0 to `end` s.

    Raises `PairIndexError`.
    """
    if in_metres(ends):
        return np.asarray(ends)
    rows = as_points(ends, what)
    if rows.min() < 0 or rows.max() >= len(points):
        raise PairIndexError(f"{what}: expected points 0 to {len(points) - 1}, got {rows.tolist()}")
    return np.column_stack([np.linspace(0.0, end, len(rows)), points[rows]])


def pad(responses: Sequence[np.ndarray], channels: int) -> tuple[np.ndarray, np.ndarray]:
    """((k, channels, n) float32 responses, padded with zeros, and their lengths (k,))."""
    lengths = np.array([r.shape[1] for r in responses])
    out = np.zeros((len(responses), channels, lengths.max(initial=0)), np.float32)
    for response, into in zip(responses, out, strict=True):
        into[:, : response.shape[1]] = response
    return out, lengths
