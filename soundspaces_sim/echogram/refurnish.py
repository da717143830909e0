"""An echogram with other absorption, from its counts of reflections (docs/theory.md, section 11)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol, TypeAlias

import numpy as np

from soundspaces_sim import echogram as with_numba  # loads what needs Numba when it is asked for it
from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.core.numerics.bands import band_means
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.reflection_counts import MaterialGroups, ReflectionCounts
from soundspaces_sim.echogram.time_windows import time_windows

EARLY_S = 0.08  # as of `Echogram.relative_error`
MOST_DB = 0.5  # of the closure's error (`closure_error_db`)
_RANGE_DB = 30.0
_STEPS = 7  # bisections of a limit
_PER_NEPER = 10.0 / np.log(10.0)


class Table(Protocol):
    """What is asked of a `MaterialTable`."""

    @property
    def names(self) -> tuple[str, ...]: ...

    def in_bands(self, edges: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...


#: Absorption by material: in all bands, in every band, or {frequency in Hz: value}; or a table of materials.
Materials: TypeAlias = Mapping[str, float | Sequence[float] | Mapping[float, float]] | Table


def absorption_of(groups: MaterialGroups, bands: Sequence[float], materials: Materials) -> np.ndarray:
    """(M, b) absorption of all groups, with that of some materials changed. Raises `MaterialError`."""
    out = np.array(groups.absorption, float)
    if not isinstance(materials, Mapping):
        if not hasattr(materials, "in_bands"):
            raise MaterialError(
                f"materials: expected {{name: absorption}} or a MaterialTable, got {materials!r:.80}"
            )
        absorption, _, _ = materials.in_bands(bands)
        rows = {name: row for row, name in enumerate(materials.names)}
        for m, name in enumerate(groups.names):
            if name in rows:
                out[m] = absorption[rows[name]]
        materials = {}
    for name, value in materials.items():
        if name not in groups.names:
            raise MaterialError(
                f"materials: reflections by '{name}' were not counted, only those by {', '.join(groups.names)}; "
                "simulate anew with another table of materials to change others"
            )
        out[groups.names.index(name)] = _in_bands(name, value, bands)
    most = 1.0 - groups.transmission
    for m, b in np.argwhere(~((out >= 0.0) & (out < most)))[:1]:
        raise MaterialError(
            f"materials: absorption of '{groups.names[m]}' must lie from 0 to below {most[m, b]:.3g} (what it "
            f"does not transmit) between {bands[b]:g} and {bands[b + 1]:g} Hz, got {out[m, b]:.4g}"
        )
    return out


def _in_bands(name: str, value: Any, bands: Sequence[float]) -> np.ndarray:
    """(b,) from a number, one per band, or values at frequencies."""
    try:
        if isinstance(value, Mapping):
            at = sorted((float(f), float(a)) for f, a in value.items())
            frequency, given = np.array(at, float).reshape(-1, 2).T
            if not len(at) or not (np.isfinite(frequency) & (frequency > 0.0)).all():
                raise ValueError("frequencies above 0 Hz")
            return np.asarray(band_means(frequency, given[None], bands))[0]
        given = np.asarray(value, float)
        return np.broadcast_to(given, len(bands) - 1) if given.ndim <= 1 else np.empty(0)[1]
    except (TypeError, ValueError, IndexError):
        raise MaterialError(
            f"materials: absorption of '{name}' must be a number, {len(bands) - 1} of them (one per band), or "
            f"{{frequency in Hz: value}}, got {value!r:.80}"
        ) from None


def log_ratios(groups: MaterialGroups, absorption: np.ndarray) -> np.ndarray:
    """(M, b) ln ρ'/ρ, ρ = 1 - α - τ, for other `absorption` (M, b)."""
    before = 1.0 - groups.absorption - groups.transmission
    return np.asarray(np.log((1.0 - absorption - groups.transmission) / before))


def refurnished(
    echogram: Echogram,
    materials: Materials | np.ndarray,
    force: bool = False,
    what: str = "echogram",
    off: float = 0.0,
) -> Echogram:
    """The echogram with other absorption of some materials, or (M, b) that of all its groups.

    Paths, delays and directions stay; energies change, and `relative_error` holds what the closure may be off by,
    and that walks are fewer for what differs between paths (theory, T66). Waves below an edge, of which nothing is
    counted, are left out: energies are all there is of the low band. Raises `MaterialError` if it has no counts,
    for materials that were not counted, and where `closure_error_db` exceeds `MOST_DB`; `force` does it all the
    same. `off`: so many times the closure's error is added.
    """
    counts = echogram.counts
    if counts is None:
        raise MaterialError(
            f"{what}: has no counts of reflections; simulate it with `[simulation.materials] enabled = true` to "
            "change materials afterwards"
        )
    given = isinstance(materials, np.ndarray)
    absorption = materials if given else absorption_of(counts.groups, echogram.bands, materials)  # type: ignore[arg-type]
    x = log_ratios(counts.groups, absorption)  # type: ignore[arg-type]
    nepers, error, variance = _change(echogram, counts, x)
    energy = echogram.energy * np.exp(nepers + off * error)[:, None].astype(echogram.energy.dtype)
    met = echogram.early.groups
    steps = np.where((met >= 0)[:, :, None], x[np.maximum(met, 0)], 0.0).sum(axis=1)
    out = replace(
        echogram,
        energy=energy,
        early=replace(echogram.early, energy=echogram.early.energy * np.exp(steps)),
        counts=None,
        low=None,
    )
    if not force and not _stated_db(error, out) <= MOST_DB:
        raise _refusal(echogram, x, out, what)
    return replace(out, relative_error=_widened(echogram, out, error, variance))


def closure_error_db(echogram: Echogram, absorption: np.ndarray) -> float:
    """What bins may be off by for other `absorption` (M, b) of the groups, dB.

    The root mean square of the closure's error over the bins up to a level of -30 dB, by their duration or by
    their energy, whichever is larger, in the worst band.
    """
    assert echogram.counts is not None
    out = refurnished(echogram, absorption, force=True)
    return _stated_of(echogram, log_ratios(echogram.counts.groups, absorption), out)


def _change(
    echogram: Echogram, counts: ReflectionCounts, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(bins, b) nepers, their errors and the variances of x (M, b), ln ρ'/ρ of every group."""
    edges = echogram.time_edges
    strength = window_strength(echogram, counts)
    return with_numba.change(counts, x).at(0.5 * (edges[1:] + edges[:-1]), strength)


def window_strength(echogram: Echogram, counts: ReflectionCounts) -> np.ndarray:
    """(W, b) power of windows over that of the strongest from each on. Raises `MaterialError`."""
    edges = echogram.time_edges
    starts = np.unique(time_windows(edges, counts.groups.windows), return_index=True)[1]
    if len(starts) != len(counts.time):
        raise MaterialError(
            f"materials: expected counts of reflections in {len(starts)} windows of time, as the echogram's bins "
            f"make, got {len(counts.time)}; simulate it anew"
        )
    energy = np.add.reduceat(echogram.energy[:, 0], starts, axis=0, dtype=float)
    power = energy / np.diff(np.append(edges[starts], edges[-1]))[:, None]
    later = np.maximum.accumulate(power[::-1], axis=0)[::-1]
    return np.divide(power, later, out=np.ones_like(power), where=later > 0.0)


def _stated_of(echogram: Echogram, x: np.ndarray, out: Echogram) -> float:
    assert echogram.counts is not None
    return _stated_db(_change(echogram, echogram.counts, x)[1], out)


def _stated_db(error: np.ndarray, out: Echogram) -> float:
    """Of errors (bins, b), nepers, of the echogram `out`; NaN if one of them is."""
    audible = _audible(out)
    duration = np.where(audible, np.diff(out.time_edges)[:, None], 0.0)
    energy = np.where(audible, out.energy[:, 0].astype(float), 0.0)
    every = np.ones(len(error), bool)
    squares = np.where(audible, error, 0.0) ** 2
    means = [_mean(squares, weight, every) for weight in (duration, energy)]
    return float(_PER_NEPER * np.sqrt(np.max(means, initial=0.0)))


def _refusal(echogram: Echogram, x: np.ndarray, out: Echogram, what: str) -> MaterialError:
    """Why the closure's error is too large: the material that makes most of it, and how far it may go."""
    assert echogram.counts is not None
    groups, rows = echogram.counts.groups, np.arange(len(x))[:, None]
    alone = [_stated_of(echogram, np.where(rows == m, x, 0.0), out) for m in rows[:, 0]]
    m = int(np.argmax(alone))
    now, rest = groups.absorption[m], 1.0 - groups.transmission[m]
    wanted = rest - np.exp(x[m]) * (rest - now)
    stated = _stated_of(echogram, x, out)

    def within(share: float, others: np.ndarray) -> bool:
        part = np.log((rest - now - share * (wanted - now)) / (rest - now))
        return _stated_of(echogram, np.where(rows == m, part, others), out) <= MOST_DB

    fits = within(0.0, x)
    others, beside = (x, "the others as asked") if fits else (0.0 * x, "the others as simulated")
    low, high = 0.0, 1.0
    for _ in range(_STEPS):
        half = 0.5 * (low + high)
        low, high = (half, high) if within(half, others) else (low, half)
    limit = now + low * (wanted - now)
    return MaterialError(
        f"{what}: absorption of '{groups.names[m]}' changes too much, from {_list(now)} to {_list(wanted)}: bins "
        f"may be off by {stated:.1f} dB (root mean square), allowed are {MOST_DB:g}. It may go to {_list(limit)}, "
        f"{beside}; beyond that simulate anew with a table that has it, or say force=True"
    )


def _list(values: np.ndarray) -> str:
    return "/".join(f"{v:.2g}" for v in values)


def _audible(echogram: Echogram) -> np.ndarray:
    """(bins, b) whether less than 30 dB of the decay lie before a bin."""
    left = echogram.energy[::-1, 0].cumsum(axis=0, dtype=float)[::-1]
    whole = left[:1] + echogram.early.energy.sum(axis=0)
    if echogram.direct is not None:
        whole = whole + echogram.direct.energy
    return np.asarray(left > 10.0 ** (-_RANGE_DB / 10.0) * whole)


def walk_factors(echogram: Echogram, materials: Materials) -> np.ndarray:
    """(2, b) by which the walks' relative errors of early and late energy grow with other absorption."""
    assert echogram.counts is not None
    groups = echogram.counts.groups
    x = log_ratios(groups, absorption_of(groups, echogram.bands, materials))
    return _factors(echogram, _late(echogram), _change(echogram, echogram.counts, x)[2])


def _factors(echogram: Echogram, late: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(2, b): a sum of w f over a Poisson number of paths has the relative variance r² (1 + v), if that of w has
    r², and f varies by v (bins, b) beside it."""
    energy = echogram.energy[:, 0].astype(float)
    return np.sqrt(1.0 + np.array([_mean(variance, energy, part) for part in (~late, late)]))


def _mean(values: np.ndarray, energy: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(b,) means of (bins, b) by energy over some bins."""
    total = energy[part].sum(axis=0)
    off = (energy * values)[part].sum(axis=0)
    return np.divide(off, total, out=np.zeros_like(off), where=total > 0.0)


def _late(out: Echogram) -> np.ndarray:
    """(bins,) which lie more than 80 ms after the first sound."""
    delays = [out.early.delay.min(initial=np.inf), np.inf if out.direct is None else out.direct.delay]
    onset = min(delays) if min(delays) < np.inf else float(out.time_edges[0])
    return np.asarray(0.5 * (out.time_edges[1:] + out.time_edges[:-1]) > onset + EARLY_S)


def _widened(before: Echogram, after: Echogram, error: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(2, b) relative errors of early and late energy with those of the closure (bins, b)."""
    late = _late(after)
    energy = after.energy[:, 0].astype(float)
    of_closure = np.array([_mean(error, energy, part) for part in (~late, late)])
    of_walks = before.relative_error * _factors(before, late, variance)
    return np.hypot(of_walks, of_closure).astype(np.float32)
