"""Directive endpoints: echograms between omnidirectional ones, weighted by the patterns of both.

By reciprocity what arrives at p of q -> p is what left p for q, so the arrival moments of the reverse
echogram are the departure moments of this one. With a band's pattern D = sum d_nm Y_nm (SN3D), a bin of
energy E and departure moments S_nm carries sum d_nm S_nm instead of E: exact for patterns of energy up to
order 2 (all of pressure order 1), and their smooth part above. Discrete arrivals know their directions at
both endpoints and take the whole pattern. Which departure belongs to which arrival within a bin is not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.errors import ConfigError, PairIndexError
from soundspaces_sim.core.numerics.axes import DEGREE, rotation_matrix, spherical_harmonics
from soundspaces_sim.core.numerics.bands import band_means
from soundspaces_sim.echogram.displaced import displaced
from soundspaces_sim.echogram.echogram import (
    REVERSE_KIND,
    Arrival,
    Arrivals,
    Echogram,
    Echograms,
    reverse_order,
    reverse_planes,
)
from soundspaces_sim.echogram.endpoints import CENTRED, Directivity, Level, Listener, Source, centred
from soundspaces_sim.echogram.low_response import LowResponse, emitted, heard, sphere

_SAME_S = 1e-9  # two delays of one path, seen from either end
_WHICH = 5  # columns of `_met` that say what a path met, in whatever order
_NODES = 32  # of `sphere`: the means over patterns are exact to harmonics of degree 63


class Pattern(NamedTuple):
    """A directivity's band energies in its own axes."""

    moments: np.ndarray  # (9, b), of its expansion, SN3D; row 0 is the mean over all directions
    least: np.ndarray  # (b,) over all directions
    most: np.ndarray  # (b,)
    scale: np.ndarray  # (b,) that its level asks for


class Aim(NamedTuple):
    """A directivity as it is turned in the world."""

    directivity: Directivity
    pattern: Pattern
    turn: np.ndarray  # (3, 3), own axes to world axes
    bands: tuple[float, ...]
    offset: np.ndarray  # (3,) m from its end's point, world axes


def band_energy(
    directivity: Directivity, directions: np.ndarray, bands: tuple[float, ...]
) -> np.ndarray:
    """(n, b) means over bands of a pattern's energy in directions (n, 3) of its own axes, as it is given."""
    frequency, energy = directivity.energy(directions)
    return np.asarray(band_means(np.asarray(frequency, float), np.asarray(energy, float), bands))


@lru_cache(maxsize=64)
def _pattern(directivity: Directivity, bands: tuple[float, ...], level: Level) -> Pattern:
    directions, share = sphere(_NODES)
    energy = band_energy(directivity, directions, bands)
    if not (np.isfinite(energy).all() and (energy >= 0.0).all() and (energy.max(axis=0) > 0.0).all()):
        raise ConfigError(
            f"{directivity!r}: expected energies that are finite, not negative and not all zero"
        )
    # the mean of Y_nm^2 over the sphere is 1 / (2 n + 1)
    moments = (2.0 * DEGREE + 1.0)[:, None] * (
        (spherical_harmonics(directions) * share[:, None]).T @ energy
    )
    ends = np.concatenate(
        [energy, band_energy(directivity, np.concatenate([np.eye(3), -np.eye(3)]), bands)]
    )
    gain = 10.0 ** (directivity.gain_db / 10.0)
    scale = gain / moments[0] if level == "power" else np.full(len(moments[0]), gain)
    return Pattern(moments, ends.min(axis=0), ends.max(axis=0), scale)


def aim(
    end: Source | Listener | Directivity | None, bands: tuple[float, ...], level: Level
) -> Aim | None:
    """An endpoint's directivity as it is turned in the world, None if it has none; `level` unless it has its
    own."""
    directivity = end.directivity if isinstance(end, Source | Listener) else end
    if directivity is None:
        return None
    if not isinstance(directivity, Directivity):
        raise ConfigError(f"expected a Directivity, a Source, a Listener or None, got {directivity!r}")
    turn = directivity.turn if end is directivity else end.turn @ directivity.turn  # type: ignore[union-attr]
    upright = replace(directivity, heading_deg=0.0, pitch_deg=0.0, roll_deg=0.0, offset=CENTRED)
    pattern = _pattern(upright, bands, directivity.level or level)
    return Aim(directivity, pattern, turn, bands, turn @ np.asarray(directivity.offset, float))


def gains(to: Aim, directions: np.ndarray) -> np.ndarray:
    """(n, b) energy gains in directions (n, 3) of world axes; the mean over all where one is zero."""
    d = np.asarray(directions, float)
    length = np.linalg.norm(d, axis=1, keepdims=True)
    known = length[:, 0] > 0.0
    own = np.where(known[:, None], d / np.where(length > 0.0, length, 1.0), [1.0, 0.0, 0.0]) @ to.turn
    energy = band_energy(to.directivity, own, to.bands)
    return to.pattern.scale * np.where(known[:, None], energy, to.pattern.moments[0])


def bin_gains(to: Aim, energy: np.ndarray) -> np.ndarray:
    """(bins, b) energy gains of bins with moments `energy` (bins, 9, b) at the directive end.

    A bin's gain is a mean of the pattern's values; where the truncation to order 2 leaves their range, it
    is put back. A bin without energy has the mean over all directions.
    """
    total = energy[:, :1]
    ratio = np.divide(energy, total, out=np.zeros_like(energy), where=total > 0.0)
    ratio[:, 0] = 1.0
    # M Y(d) = Y(R^T d), so D(R^T d) has M^T d_nm.
    moments = rotation_matrix(to.turn).T @ to.pattern.moments
    mean = np.einsum("tcb,cb->tb", ratio, moments.astype(energy.dtype))
    return np.asarray(to.pattern.scale * np.clip(mean, to.pattern.least, to.pattern.most))


def _met(kind: np.ndarray, planes: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(n, 9) what paths met: kinds, planes and edges sorted (`_WHICH` columns), then both in their order.

    From a place to itself by a right-angled corner there is one path, which meets the edge: which of its planes is
    the first does not tell it from its reverse.
    """
    return np.column_stack([kind, np.sort(planes, axis=1), np.sort(edges, axis=1), planes, edges])


def departures(early: Arrivals, reverse: Arrivals) -> np.ndarray:
    """(n, 3) directions from the source in which early arrivals left it, from those of the reverse echogram:
    the same paths, their planes and edges reversed. Raises `PairIndexError` if it is not the reverse."""
    own = _met(early.kind, early.planes, early.edges)
    back = _met(
        REVERSE_KIND[reverse.kind],
        reverse_planes(reverse.planes, reverse.kind),
        reverse_order(reverse.edges),
    )
    order, other = np.lexsort(own.T[::-1]), np.lexsort(back.T[::-1])
    if (
        len(order) != len(other)
        or not np.array_equal(own[order, :_WHICH], back[other, :_WHICH])
        or not np.all(np.abs(early.delay[order] - reverse.delay[other]) <= _SAME_S)
    ):
        raise PairIndexError(
            f"reverse: expected the echogram from the listener to the source, with the same {len(early)} early "
            f"reflections; got one with {len(reverse)} that do not match"
        )
    out = np.empty((len(early), 3))
    out[order] = reverse.direction[other]
    return out


def directed(
    echogram: Echogram,
    reverse: Echogram | None = None,
    source: Source | Directivity | None = None,
    listener: Listener | Directivity | None = None,
    speed_of_sound: float = 343.0,
) -> Echogram:
    """The echogram of a directive `source`, `listener` or both, from one between omnidirectional ends.

    `reverse`: the echogram from the listener to the source, of the same simulation; needed for a source.
    `speed_of_sound`, m/s, turns delays into distances where a directivity has an offset.
    Positions of records are not looked at. Of a directive listener channel 0 counts, what a microphone
    picks up; the moments keep their ratios to it. `relative_error` stays that of the plain echogram.
    Raises `ConfigError`, `PairIndexError`.
    """
    from_source = aim(source, echogram.bands, "power")
    at_listener = aim(listener, echogram.bands, "pattern")
    if from_source is None and at_listener is None:
        return echogram
    if from_source is not None and (reverse is None or reverse.energy.shape != echogram.energy.shape):
        raise PairIndexError(
            "reverse: a directive source needs the echogram from the listener to the source"
        )
    leaves = -echogram.early.direction if reverse is None else departures(echogram.early, reverse.early)
    plain, leaves_direct, leaves = _in_place(echogram, from_source, at_listener, leaves, speed_of_sound)
    bins = np.ones((len(echogram.energy), len(echogram.bands) - 1))
    first, early = plain.direct, plain.early
    towards = np.zeros(3) if first is None else np.asarray(first.direction)
    direct, level = np.ones(bins.shape[1]), np.ones((len(early), bins.shape[1]))
    if from_source is not None and reverse is not None:
        bins *= bin_gains(from_source, reverse.energy)
        direct *= gains(from_source, leaves_direct[None])[0]
        level *= gains(from_source, leaves)
    if at_listener is not None:
        bins *= bin_gains(at_listener, echogram.energy)
        direct *= gains(at_listener, towards[None])[0]
        level *= gains(at_listener, early.direction)
    if first is not None:
        first = Arrival(first.delay, first.energy * direct, first.direction, first.planes)
        first = first if first.energy.max() > 0.0 else None
    return replace(
        echogram,
        energy=(echogram.energy * bins[:, None]).astype(echogram.energy.dtype),
        direct=first,
        early=replace(early, energy=early.energy * level),
        low=_low(echogram, reverse, from_source, at_listener, speed_of_sound),
    )


def _low(
    echogram: Echogram,
    reverse: Echogram | None,
    source: Aim | None,
    listener: Aim | None,
    speed_of_sound: float,
) -> LowResponse | None:
    """The waves of directive ends, whose patterns are those of the lowest band."""
    low = echogram.low
    if low is None:
        return None
    if source is not None:
        if reverse is None or reverse.low is None:
            raise PairIndexError(
                "reverse: expected waves in the echogram of the way back, too; it has none"
            )
        low = emitted(low, reverse.low, source.offset, _amplitudes(source), speed_of_sound)
    if listener is not None:
        low = heard(low, listener.offset, _amplitudes(listener), speed_of_sound)
    return low


def _amplitudes(to: Aim) -> np.ndarray:
    return np.asarray(np.sqrt(gains(to, sphere()[0])[:, 0]))


def _in_place(
    echogram: Echogram,
    source: Aim | None,
    listener: Aim | None,
    leaves: np.ndarray,
    speed_of_sound: float,
) -> tuple[Echogram, np.ndarray, np.ndarray]:
    """The echogram between directivities that sit off their points, and where its arrivals leave: (3,), (n, 3)."""
    a, b = (np.zeros(3) if to is None else to.offset for to in (source, listener))
    if not (a.any() or b.any()):
        direct = np.zeros(3) if echogram.direct is None else -np.asarray(echogram.direct.direction)
        return echogram, direct, leaves
    return displaced(echogram, a, b, leaves, speed_of_sound)


def directed_table(
    forward: Echograms,
    backward: Echograms | None,
    rows: np.ndarray,
    columns: np.ndarray,
    sources: Sequence[Source] | None,
    listeners: Sequence[Listener] | None,
) -> Echograms:
    """`directed` for S sources × L listeners (None: omnidirectional): `sources[s]` stands at row `rows[s]`
    of `forward`, `listeners[l]` at column `columns[l]`. `backward`: the same points, the other way. Points are
    where directivities sit (`ends.as_ends`), so that offsets move nothing here.
    """
    pairs = [(s, l) for s in range(len(rows)) for l in range(len(columns))]
    shape = len(rows), len(columns)
    energy = np.empty((*shape, *forward.energy.shape[2:]), forward.energy.dtype)
    direct = np.zeros((*shape, energy.shape[-1]))
    early: list[Arrivals] = []
    low: list[LowResponse | None] = []
    for s, l in pairs:
        i, j = int(rows[s]), int(columns[l])
        echogram = directed(
            forward[i, j],
            None if backward is None else backward[j, i],
            None if sources is None else centred(sources[s]),
            None if listeners is None else centred(listeners[l]),
        )
        energy[s, l] = echogram.energy
        if echogram.direct is not None:
            direct[s, l] = echogram.direct.energy
        early.append(echogram.early)
        low.append(echogram.low)
    grid = np.ix_(rows, columns)
    return replace(
        forward,
        sources=forward.sources[rows],
        listeners=forward.listeners[columns],
        energy=energy,
        direct_energy=direct,
        direct_length=forward.direct_length[grid],
        walls=forward.walls[grid],
        early_start=np.cumsum([0, *(len(e) for e in early)]),
        early=Arrivals(*(np.concatenate([getattr(e, f.name) for e in early]) for f in fields(Arrivals))),
        relative_error=forward.relative_error[grid],
        measure_error=None,  # those of omnidirectional ends
        counts=None if forward.counts is None else forward.counts.pairs(*grid),
        low=_stacked(low, shape),
        source_ends=None if sources is None else tuple(sources),
        listener_ends=None if listeners is None else tuple(listeners),
    )


def _stacked(low: Sequence[LowResponse | None], shape: tuple[int, int]) -> np.ndarray | None:
    """(S, L, 4, n) of all pairs, None if they have none."""
    signals = [each.signal for each in low if each is not None]
    return np.stack(signals).reshape(*shape, *signals[0].shape) if signals else None
