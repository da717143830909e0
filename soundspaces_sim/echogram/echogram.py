"""Echograms: how much energy arrives when, from where, per band.

Conventions: delays in s since emission; energy is fluence at the listener, J/m², for a source that
emits 1 J in each band (direct sound at distance r: 1/(4 pi r^2)). Directions are unit vectors from the
listener to where sound comes from, world axes. Spherical-harmonic moments: ACN order, SN3D; moment 0 is
the energy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from operator import index

import numpy as np

from soundspaces_sim.core.errors import PairIndexError
from soundspaces_sim.core.numerics.air import Air
from soundspaces_sim.core.svg import CYCLE, Curve, html, svg
from soundspaces_sim.echogram.endpoints import Listener, Source
from soundspaces_sim.echogram.low_response import LowResponse
from soundspaces_sim.echogram.reflection_counts import ReflectionCounts

# Of the plot that a notebook shows.
_RANGE_DB = 60.0
_PLOT_BIN_S = 0.01

#: What a discrete arrival met on its way, in order from the source.
KINDS = (
    "mirrors",
    "edge",
    "mirror, edge",
    "edge, mirror",
    "two edges",
    "mirror, two edges",
    "two edges, mirror",
    "mirror, edge, mirror",
    "mirror, two edges, mirror",
    "mirrors there and back",
    "edges",
)
MIRRORS, EDGE, MIRROR_EDGE, EDGE_MIRROR, TWO_EDGES = range(5)
MIRRORS_AND_BACK = 9  # by the first of two planes, the second, and the first again
EDGES = 10  # by three edges or more: the first and the last one
#: Kinds of paths by one edge and by two: [edges - 1][a reflection before them][one after them].
EDGE_KINDS = (((EDGE, EDGE_MIRROR), (MIRROR_EDGE, 7)), ((TWO_EDGES, 6), (5, 8)))
REVERSE_KIND = np.array(
    [MIRRORS, EDGE, EDGE_MIRROR, MIRROR_EDGE, TWO_EDGES, 6, 5, 7, 8, MIRRORS_AND_BACK, EDGES]
)


def reverse_order(met: np.ndarray) -> np.ndarray:
    """(n, 2) planes or edges of the same paths from the other end, -1 where there is none."""
    return np.where(met[:, 1:] >= 0, met[:, ::-1], met)


def reverse_planes(planes: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """(n, 2) `reverse_order` of the planes of paths of these kinds (n,)."""
    return np.where((kind == MIRRORS_AND_BACK)[:, None], planes, reverse_order(planes))


@dataclass(frozen=True)
class Arrival:
    """One discrete arrival. `kind`: one of `KINDS`, what it met on its way; `planes`, `edges`: the grouped planes
    that mirrored it and the edges that it went round, each in order from the source."""

    delay: float
    energy: np.ndarray  # (bands,)
    direction: np.ndarray  # (3,), zero where source and listener coincide
    planes: tuple[int, ...] = ()
    kind: str = KINDS[MIRRORS]
    edges: tuple[int, ...] = ()

    def __repr__(self) -> str:
        met = f", planes {self.planes}" if self.planes else ""
        met += f", edges {self.edges}" if self.edges else ""
        axes = ", ".join(f"{x:.2f}" for x in self.direction)
        values = ", ".join(f"{e:.2e}" for e in np.atleast_1d(self.energy))
        return f"Arrival({1e3 * self.delay:.1f} ms from ({axes}), energy [{values}] J/m²{met})"


def direct_arrival(
    offset: np.ndarray, distance: float, energy: np.ndarray, speed_of_sound: float
) -> Arrival | None:
    """The direct sound of a source at `offset` (3,) from the listener, or None if it has no energy."""
    if not energy.max() > 0.0:
        return None
    direction = offset / distance if distance > 0.0 else np.zeros(3)
    return Arrival(distance / speed_of_sound, energy, direction)


@dataclass(frozen=True)
class Arrivals:
    """n discrete arrivals as columns; indexing and iteration give `Arrival` records. Without `kind` and `edges`,
    mirrors only. `groups`: rows of `MaterialGroups` that reflected each, -1 for none."""

    delay: np.ndarray  # (n,)
    energy: np.ndarray  # (n, bands)
    direction: np.ndarray  # (n, 3)
    planes: np.ndarray  # (n, 2), -1 where there is none
    kind: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))  # (n,) rows of `KINDS`
    edges: np.ndarray = field(default_factory=lambda: np.empty((0, 2), np.int64))  # (n, 2), -1: none
    groups: np.ndarray = field(default_factory=lambda: np.empty((0, 3), np.int64))  # (n, 3), see below

    def __post_init__(self) -> None:
        if len(self.kind) != len(self.delay):
            object.__setattr__(self, "kind", np.full(len(self.delay), MIRRORS))
        if len(self.edges) != len(self.delay):
            object.__setattr__(self, "edges", np.full((len(self.delay), 2), -1))
        if len(self.groups) != len(self.delay):
            object.__setattr__(self, "groups", np.full((len(self.delay), 3), -1))

    def __repr__(self) -> str:
        span = (
            f" from {1e3 * self.delay.min():.1f} to {1e3 * self.delay.max():.1f} ms" if len(self) else ""
        )
        return f"Arrivals: {len(self)}{span}"

    def __len__(self) -> int:
        return len(self.delay)

    def __getitem__(self, i: int) -> Arrival:
        if not -len(self) <= i < len(self):
            raise PairIndexError(f"arrival {i} of {len(self)}")
        planes, edges = (tuple(int(x) for x in met[i] if x >= 0) for met in (self.planes, self.edges))
        kind = KINDS[int(self.kind[i])]
        if self.kind[i] == MIRRORS_AND_BACK:
            planes = (*planes, planes[0])
        return Arrival(float(self.delay[i]), self.energy[i], self.direction[i], planes, kind, edges)

    def __iter__(self) -> Iterator[Arrival]:
        return (self[i] for i in range(len(self)))


@dataclass(frozen=True)
class Echogram:
    """Energy against delay, per band, from one source to one listener.

    `energy` (bins, 9, bands) holds everything but the discrete arrivals, in bins between `time_edges`
    (bins + 1, s). `direct` is None if walls block it wholly. `relative_error` (2, bands): estimated
    relative standard error of the energy up to 80 ms after the direct sound's time, and later, infinite where
    it is not known. `source`,
    `listener`: the ends as they were given, if as records; their directivities have been applied. `air`: what the
    energies include, of which renderers know the course within bands; None if none, or if that is not known.
    `counts`: how often groups of materials have reflected what is in the bins, if it was counted. `low`: the
    sound below an edge as waves, which renderers take there instead of energies.
    """

    bands: tuple[float, ...]
    time_edges: np.ndarray
    energy: np.ndarray
    direct: Arrival | None
    early: Arrivals
    relative_error: np.ndarray
    visible: bool
    source: Source | None = None
    listener: Listener | None = None
    air: Air | None = None
    counts: ReflectionCounts | None = None
    low: LowResponse | None = None

    def __repr__(self) -> str:
        direct = (
            "no direct sound"
            if self.direct is None
            else f"direct sound at {1e3 * self.direct.delay:.1f} ms"
        )
        edges = ", ".join(f"{b:g}" for b in self.bands)
        of_early, of_late = (100.0 * float(np.max(x)) for x in self.relative_error)
        return (
            f"Echogram: {self.time_edges[-1]:g} s in {len(self.time_edges) - 1} bins, bands at {edges} Hz\n"
            f"  {direct}, {len(self.early)} early reflections, in sight: {'yes' if self.visible else 'no'}; "
            f"standard error up to {of_early:.1f} % early, {of_late:.1f} % late"
        )

    def _repr_html_(self) -> str:
        energy = self.histogram(_PLOT_BIN_S)
        with np.errstate(divide="ignore"):
            level = 10.0 * np.log10(energy / max(float(energy.max()), 1e-300))
        level[level < -_RANGE_DB] = np.nan
        time = (np.arange(energy.shape[1]) + 0.5) * _PLOT_BIN_S
        curves = [
            Curve(np.stack([time, row], axis=1), CYCLE[b % len(CYCLE)]) for b, row in enumerate(level)
        ]
        return html(repr(self), svg(curves, 360, 160, same_scale=False))

    @property
    def arrivals(self) -> list[Arrival]:
        """The direct sound, if any, and early reflected and diffracted paths."""
        return ([self.direct] if self.direct is not None else []) + list(self.early)

    def histogram(self, bin_s: float = 0.01) -> np.ndarray:
        """(bands, bins) float64, J/m² for 1 J emitted: all energy, direct and early included.

        Bin i covers [i, i + 1) * `bin_s`, to rounding. Energy of a stored bin that is cut is shared by duration.
        """
        if not bin_s > 0.0:
            raise ValueError(f"bin_s must be positive, got {bin_s}")
        end = max([float(self.time_edges[-1])] + [a.delay for a in self.arrivals])
        bins = max(int(np.ceil(end / bin_s - 1e-9)), 1)
        edges = np.arange(bins + 1) * bin_s
        cumulative = np.concatenate(
            [np.zeros((1, self.energy.shape[2])), np.cumsum(self.energy[:, 0], 0, np.float64)]
        )
        out = np.stack([np.diff(np.interp(edges, self.time_edges, column)) for column in cumulative.T])
        for arrival in self.arrivals:
            out[:, min(int(arrival.delay / bin_s + 1e-9), bins - 1)] += arrival.energy
        return np.maximum(out, 0.0)


def without_arrivals(echogram: Echogram) -> Echogram:
    """The reverberation alone."""
    none = Arrivals(*(getattr(echogram.early, f.name)[:0] for f in fields(Arrivals)))
    return replace(echogram, direct=None, early=none)


@dataclass(frozen=True)
class Echograms:
    """Echograms of S sources × L listeners; `echoes[s, l]` is one `Echogram`.

    `energy` (S, L, bins, 9, bands) float32; `direct_energy` (S, L, bands), `direct_length` (S, L) m,
    `walls` (S, L) crossed by the direct path; early arrivals of pair k = s * L + l are rows
    `early_start[k]:early_start[k + 1]`; `relative_error` (S, L, 2, bands); `measure_error` (S, L, M, bands),
    standard errors of `echogram.measure_errors.MEASURES`, if they are known. `source_ends`, `listener_ends`:
    the records of the ends, if they were given; their directivities have been applied. `air`, `counts`: as in
    `Echogram`. `low` (S, L, 4, n): signals of `LowResponse` below `low_edge` Hz, if there are any. `notes`: of a
    simulation, how late sound was estimated, and whether the error that was asked for was met.
    """

    bands: tuple[float, ...]
    speed_of_sound: float
    sources: np.ndarray
    listeners: np.ndarray
    time_edges: np.ndarray
    energy: np.ndarray
    direct_energy: np.ndarray
    direct_length: np.ndarray
    walls: np.ndarray
    early_start: np.ndarray
    early: Arrivals
    relative_error: np.ndarray
    measure_error: np.ndarray | None = None
    source_ends: tuple[Source, ...] | None = None
    listener_ends: tuple[Listener, ...] | None = None
    air: Air | None = None
    counts: ReflectionCounts | None = None
    low: np.ndarray | None = None
    low_edge: float | None = None
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        sources, listeners = self.shape
        return (
            f"Echograms: {sources} sources × {listeners} listeners, {self.time_edges[-1]:g} s in "
            f"{len(self.time_edges) - 1} bins, {len(self.bands) - 1} bands, {self.energy.nbytes / 1e6:.1f} MB"
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(sources, listeners)."""
        return len(self.sources), len(self.listeners)

    def __len__(self) -> int:
        return len(self.sources) * len(self.listeners)

    def __getitem__(self, pair: tuple[int, int]) -> Echogram:
        try:
            s, l = (index(i) for i in pair)
        except (TypeError, ValueError):
            raise PairIndexError(f"expected [source, listener], got {pair!r}") from None
        n_s, n_l = self.shape
        if not (-n_s <= s < n_s and -n_l <= l < n_l):
            raise PairIndexError(f"pair ({s}, {l}) is not among {n_s} sources × {n_l} listeners")
        s, l = s % n_s, l % n_l
        offset, distance = self.sources[s] - self.listeners[l], float(self.direct_length[s, l])
        direct = direct_arrival(offset, distance, self.direct_energy[s, l], self.speed_of_sound)
        rows = slice(*self.early_start[s * n_l + l : s * n_l + l + 2])
        early = Arrivals(*(getattr(self.early, f.name)[rows] for f in fields(Arrivals)))
        return Echogram(
            self.bands,
            self.time_edges,
            self.energy[s, l],
            direct,
            early,
            self.relative_error[s, l],
            bool(self.walls[s, l] == 0),
            None if self.source_ends is None else self.source_ends[s],
            None if self.listener_ends is None else self.listener_ends[l],
            self.air,
            None if self.counts is None else self.counts.pairs(s, l),
            None
            if self.low is None or self.low_edge is None
            else LowResponse(self.low_edge, self.low[s, l]),
        )
