"""What room parameters are computed from: a pair's energies in bands from the onset on, with half-samples.

Conventions: bins of `BIN_S` from that of the onset on, as of `measures`; axes (half-samples, bands, bins). Row
0 is the estimate; the others are perturbed, and the mean square by which a parameter differs over them is its
variance.

Known of a pair are the standard errors of its energy before and after 80 ms. Within either window energy is
taken as a sum of many independent deposits, whose variance is in proportion to their energy: each of `_GROUPS`
parts of a window, of equal energy, is multiplied by 1 ± its relative error, with the signs of a Hadamard
matrix, so that all parts are independent. Directions of deposits vary about their mean as those of a diffuse
field do. Discrete arrivals have no error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import hadamard

from soundspaces_sim import Echogram
from soundspaces_sim.parts import (
    BIN_S,
    HARMONIC_DEGREE as DEGREE,
    energy_ratios,
    first_loud,
    spherical_harmonics,
)

EARLY_S = 0.08  # where the window of early energy ends
_GROUPS = 8  # parts of a window
_ORDER = 32  # of the Hadamard matrix; columns: the parts of both windows, then the directions of each
_LATERAL_SPREAD = 4.0 / 45.0  # variance of the squared cosine of an angle, over a diffuse field
_COSINE_SPREAD = 1.0 / 12.0  # of its magnitude
Made = TypeVar("Made")


@dataclass(frozen=True)
class Response:
    """A pair in K bands. `echogram`: in these bands; `onset`: the bin in which sound begins; `towards`: unit
    vector from the listener to the source, None if that is not known."""

    echogram: Echogram
    onset: int
    towards: np.ndarray | None
    half_samples: bool = True  # or the estimate alone
    _made: dict[Callable[..., Any], Any] = field(default_factory=dict, init=False, repr=False)

    def once(self, make: Callable[[Response], Made]) -> Made:
        """`make(self)`, made when it is first asked for."""
        if make not in self._made:
            self._made[make] = make(self)
        found: Made = self._made[make]
        return found

    def of_bands(self, rows: slice) -> Response:
        """The response in some of its bands."""
        e = self.echogram
        direct = e.direct
        if direct is not None:
            direct = replace(direct, energy=direct.energy[rows])
        part = replace(
            e,
            bands=e.bands[rows.start : rows.stop + 1],
            energy=e.energy[..., rows],
            direct=direct,
            early=replace(e.early, energy=e.early.energy[:, rows]),
            relative_error=e.relative_error[:, rows],
        )
        out = replace(self, echogram=part)
        out.__dict__["energy"] = self.energy[:, rows]  # made already
        return out

    @cached_property
    def moments(self) -> np.ndarray:
        """(K, n, 9) moments of all but discrete arrivals."""
        e = self.echogram
        bins = _bin_count(e)
        edges = np.minimum(np.arange(bins + 1) * BIN_S, e.time_edges[-1])
        k = np.clip(np.searchsorted(e.time_edges, edges, "right") - 1, 0, len(e.time_edges) - 2)
        share = (edges - e.time_edges[k]) / np.diff(e.time_edges)[k]
        stored = e.energy.astype(float)
        sums = np.concatenate([np.zeros_like(stored[:1]), np.cumsum(stored, axis=0)])
        at_edges = sums[k] + share[:, None, None] * stored[k]
        return np.diff(at_edges, axis=0)[self.onset :].transpose(2, 0, 1)

    @cached_property
    def arrivals(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """((A,), (A, 3), (A, K)): bins after the onset, directions and energies of discrete arrivals."""
        first, early = self.echogram.direct, self.echogram.early
        delay, direction, energy = early.delay, early.direction, early.energy
        if first is not None:
            delay = np.append(first.delay, delay)
            direction = np.concatenate([np.asarray(first.direction, float)[None], direction])
            energy = np.concatenate([np.asarray(first.energy, float)[None], energy])
        at = (np.asarray(delay, float) / BIN_S + 1e-9).astype(np.int64) - self.onset
        inside = at >= 0
        return at[inside], direction[inside].astype(float), energy[inside].astype(float)

    def with_arrivals(self, bins: np.ndarray, weight: np.ndarray | float = 1.0) -> np.ndarray:
        """(R, K, n) energies `bins`, to which those of discrete arrivals times their `weight` (A,) are added."""
        at, _, energy = self.arrivals
        fixed = np.zeros(bins.shape[1:])
        np.add.at(fixed.T, np.minimum(at, bins.shape[2] - 1), energy * np.reshape(weight, (-1, 1)))
        bins += fixed
        return bins

    @cached_property
    def estimate(self) -> np.ndarray:
        """(1, K, n) energy, without half-samples."""
        return self.with_arrivals(np.maximum(self.moments[None, :, :, 0], 0.0))

    @cached_property
    def ratios(self) -> dict[str, np.ndarray]:
        """Each (1, K): measures that are ratios of energies, whose errors are stored with the pair."""
        return energy_ratios(self.estimate, BIN_S)

    @cached_property
    def energy(self) -> np.ndarray:
        """(R, K, n) energy."""
        return self.with_arrivals(self._scale * self.moments[None, :, :, 0])

    def along(self, axis: np.ndarray, power: int, bins: int | None = None) -> np.ndarray:
        """(R, K, n) energy, each deposit times |cos|^power of its angle to a unit vector `axis`; `power` 1 or 2; of
        the first `bins` alone, if they are said, with what arrives later in the last of them.

        The square is of order 2 and known exactly. The magnitude's series ends at order 2, 1/2 + 5/8 P_2, which is
        exact for a diffuse field, and is kept between the bounds mean(cos²) and sqrt(mean(cos²)).
        """
        moments, scale = self.moments[:, :bins], self._scale[:, :, :bins]
        total = moments[..., 0]
        second = moments[..., 4:] @ spherical_harmonics(axis)[4:]  # sum of P_2
        square = np.clip(total / 3.0 + 2.0 / 3.0 * second, 0.0, total)
        weighted, spread = square, _LATERAL_SPREAD
        if power == 1:
            weighted = np.clip(0.5 * total + 0.625 * second, square, np.sqrt(square * total))
            spread = _COSINE_SPREAD
        scaled = self._turned(0, bins)
        scaled *= np.sqrt(spread) * total
        scaled += scale * weighted
        np.clip(scaled, 0.0, scale * total, out=scaled)
        return self.with_arrivals(scaled, np.abs(self.arrivals[1] @ axis) ** power)

    def window_moments(self, start_s: float, end_s: float) -> np.ndarray:
        """(R, K, 9) moments of all but discrete arrivals in a window of time."""
        first, last = (round(min(t, 1e6) / BIN_S) for t in (start_s, end_s))
        part = slice(first, last)
        scale = self._scale[:, :, part].transpose(1, 0, 2)
        sums = np.matmul(scale, self.moments[:, part]).transpose(1, 0, 2)
        share, relative = self._windows[0][:, part], self._turn
        total = share @ self.moments[:, part, 0].T  # (2, K)
        for m, degree in enumerate(DEGREE[1:]):
            deviation = self._signs[:, 2 * _GROUPS + m :: 8] @ (relative * total)
            sums[1:, :, 1 + m] += deviation / np.sqrt(2.0 * degree + 1.0)
        return np.asarray(sums)

    @property
    def _signs(self) -> np.ndarray:
        """(R - 1, 32)."""
        return _SIGNS if self.half_samples else _SIGNS[:0]

    @cached_property
    def _windows(self) -> tuple[np.ndarray, np.ndarray]:
        """((2, n) shares of bins in both windows, (2, K) standard errors of their energies)."""
        n = self.moments.shape[1]
        late = np.clip((np.arange(1, n + 1) * BIN_S - EARLY_S) / BIN_S, 0.0, 1.0)
        share = np.stack([1.0 - late, late])
        known = np.nan_to_num(self.echogram.relative_error.astype(float), posinf=1.0)
        return share, known * (share @ self.estimate[0].T)

    @cached_property
    def _scale(self) -> np.ndarray:
        """(R, K, n) factors of half-samples."""
        if not self.half_samples:
            return np.ones((1, *self.moments.shape[:2]))
        share, error = self._windows
        energy = np.maximum(self.moments[..., 0], 0.0)
        bands, n = energy.shape
        relative = np.zeros((bands, 2 * _GROUPS, n))  # of each bin, in the part that it is of
        row, column = np.arange(bands)[:, None], np.arange(n)
        for w in range(2):
            inside = share[w] * energy
            total = inside.sum(axis=1, keepdims=True)  # (K, 1)
            placed = np.cumsum(inside, axis=1) - 0.5 * inside
            part = np.floor(_GROUPS * placed / np.maximum(total, 1e-300)).astype(int)
            part = np.clip(part, 0, _GROUPS - 1)
            sums = np.bincount((row * _GROUPS + part).ravel(), inside.ravel(), bands * _GROUPS)
            sums = sums.reshape(bands, _GROUPS)
            own = error[w][:, None] / np.sqrt(np.maximum(sums, 1e-150) * np.maximum(total, 1e-150))
            own = np.where((sums > 0.0) & (total > 0.0), np.minimum(own, 1.0), 0.0)
            relative[row, w * _GROUPS + part, column] = own[row, part] * share[w]
        out = np.ones((1 + len(self._signs), bands, n))
        out[1:] += np.matmul(self._signs[:, : 2 * _GROUPS], relative).transpose(1, 0, 2)
        return np.maximum(out, 0.0)

    @cached_property
    def _turn(self) -> np.ndarray:
        """(2, K) relative deviations of directions in both windows."""
        share, error = self._windows
        total = share @ np.maximum(self.moments[..., 0], 0.0).T
        return np.divide(error, total, out=np.zeros_like(error), where=total > 0.0)

    def _turned(self, mode: int, bins: int | None = None) -> np.ndarray:
        """(R, K, n) relative deviations of directions, in one of eight independent ways."""
        signs, share = (
            self._signs[:, 2 * _GROUPS + mode :: 8],
            self._windows[0][:, :bins],
        )  # of both windows
        by_window = np.zeros((1 + len(signs), len(self.moments), 2))
        by_window[1:] = signs[:, None] * self._turn.T
        return by_window @ share


def _make_signs() -> np.ndarray:
    """(32, 32) orthogonal columns of ±1. Shuffled, as sums of neighbouring columns of Sylvester's matrix are
    zero in most rows and large in a few, which is no fair sample of what is not linear."""
    rng = np.random.default_rng(0)
    return np.asarray(hadamard(_ORDER)[:, rng.permutation(_ORDER)] * rng.choice([-1.0, 1.0], _ORDER))


_SIGNS = _make_signs()


def _bin_count(echogram: Echogram) -> int:
    first = 0.0 if echogram.direct is None else echogram.direct.delay
    end = max(float(echogram.time_edges[-1]), first, float(echogram.early.delay.max(initial=0.0)))
    return max(int(np.ceil(end / BIN_S - 1e-9)), 1)


def response_of(
    echogram: Echogram,
    stored: Echogram,
    towards: np.ndarray | None = None,
    half_samples: bool = True,
) -> Response:
    """A pair's echogram in some bands; `stored` is that in the bands that were simulated, which tells the onset:
    that of the direct sound, or without one when the energy first comes within 20 dB of its peak."""
    if stored.direct is not None:
        onset = int(stored.direct.delay / BIN_S + 1e-9)
        if towards is None and np.any(stored.direct.direction):
            towards = np.asarray(stored.direct.direction, float)
    else:
        onset = int(first_loud(stored.histogram(BIN_S)))
    return Response(echogram, onset, towards, half_samples)
