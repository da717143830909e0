"""Choosing pairs and points: at random within limits, nearest to a place; batches of unequal lengths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

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


def for_each(given: Any, count: int, what: str) -> list[Any]:
    """One thing, or None, for all of `count`, or one each. Raises `ConfigError`."""
    if not isinstance(given, list | tuple):
        return [given] * count
    if len(given) != count:
        raise ConfigError(f"{what}: expected one or {count}, got {len(given)}")
    return list(given)


def pad(responses: Sequence[np.ndarray], channels: int) -> tuple[np.ndarray, np.ndarray]:
    """((k, channels, n) float32 responses, padded with zeros, and their lengths (k,))."""
    lengths = np.array([r.shape[1] for r in responses])
    out = np.zeros((len(responses), channels, lengths.max(initial=0)), np.float32)
    for response, into in zip(responses, out, strict=True):
        into[:, : response.shape[1]] = response
    return out, lengths
