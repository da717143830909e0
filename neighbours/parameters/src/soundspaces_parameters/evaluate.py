"""Room parameters of one pair, with two errors each.

``error``: the standard error of the simulation. Of T20, T30, EDT, C50, C80, D50, Ts and DRR it is what the
dataset stores of the bands that were simulated, averaged over those that a band has parts of (bands share their
subpaths); of others it comes from half-samples (`echogram.parameters.response`). NaN: not known. A
reverberation time whose error is above a fifth of it is NaN, as in the table of pairs.

``interpolation``: what a value may be off since the course of a coefficient within a stored band is not known. If
that is a straight line from neighbour to neighbour with a step of d, the mean over a part that fills a share f
of the band and lies anywhere in it has the standard deviation (1 - f) d / sqrt(12); d is the larger difference
to a neighbour. Zero where the band is one that was simulated, or several. Of interaural correlations and of
speech it is the difference to a staircase, without slopes within bands.

Of pairs with `waves`, T20, T30, EDT, C50, C80, D50 and Ts of bands that lie whole below their edge are those of
waves (`echogram.low_measures`), whose errors are not known of a single simulation: `soundspaces_sim.low_measures`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from soundspaces_parameters.band_pieces import Pieces, in_bands, pieces_of, without_air
from soundspaces_parameters.of_waves import LOW_MEASURES, bands_below, low_measures
from soundspaces_parameters.registry import PARAMETERS, Parameter, find_parameter
from soundspaces_parameters.response import Response, response_of
from soundspaces_parameters.speech import OCTAVES, Speech
from soundspaces_sim import ConfigError, Echogram
from soundspaces_sim.parts import (
    BANDS_PER_OCTAVE as PER_OCTAVE,
    BIN_S,
    HIGHEST_OCTAVE,
    LARGEST_TIME_ERROR as LARGEST_ERROR,
    LOWEST_BAND as LOWEST,
    MEASURES,
    RoomMeasures,
    check_edges,
    fractional_octaves,
    nominal,
)

_TIMES = ("t20", "t30", "edt")
_WIDEST_CENTRE = 1.1  # ratio by which a midband frequency may lie outside the range that is averaged


class Values(NamedTuple):
    """A parameter of a pair: values, standard errors and errors of interpolation, each (K,), or of one number
    (1,)."""

    value: np.ndarray
    error: np.ndarray
    interpolation: np.ndarray


class Bands(NamedTuple):
    """Bands asked for: `edges` (K + 1,) Hz, and `centre` (K,), nominal midband frequencies."""

    edges: tuple[float, ...]
    centre: tuple[float, ...]


@dataclass(frozen=True)
class Conditions:
    """What parameters hold for: `speech` and noise, and the `hrtf` whose ears they are (None: KEMAR)."""

    speech: Speech = field(default_factory=Speech)
    hrtf: str | Path | None = None


def bands_of(asked: str | Sequence[float], stored: Sequence[float]) -> Bands:
    """``octaves`` or ``thirds`` (all that lie within what was simulated), ``stored``, or edges in Hz. Raises
    `ConfigError`."""
    if asked == "stored" or (not isinstance(asked, str) and tuple(asked) == tuple(stored)):
        edges = np.asarray(stored, float)
    elif isinstance(asked, str):
        if asked not in PER_OCTAVE:
            raise ConfigError(f"bands: expected octaves, thirds, stored or edges in Hz, got {asked!r}")
        edges, centre = fractional_octaves(PER_OCTAVE[asked], LOWEST, HIGHEST_OCTAVE)
        low, high = float(stored[0]) / 1.02, 1.02 * float(stored[-1])
        inside = (edges[:-1] >= low) & (edges[1:] <= high)
        if not inside.any():
            raise ConfigError(f"bands: no {asked} lie within {stored[0]:g} to {stored[-1]:g} Hz")
        first, last = np.flatnonzero(inside)[[0, -1]]
        edges, centre = edges[first : last + 2], centre[first : last + 1]
        return Bands(tuple(edges.tolist()), tuple(nominal(float(f)) for f in centre))
    else:
        edges = np.asarray(check_edges(asked))
    middle = np.sqrt(np.maximum(edges[:-1], edges[1:] / 8.0) * edges[1:])
    return Bands(tuple(edges.tolist()), tuple(np.round(middle, 1).tolist()))


@dataclass(frozen=True)
class Pair:
    """One echogram and what its parameters hold for. `towards`: from the listener to the source, m;
    `measure_error` (M, B): standard errors of `MEASURES`, if they are known; `waves`: measures below their edge are
    those of the echogram's waves."""

    stored: Echogram
    bands: Bands
    conditions: Conditions
    towards: np.ndarray | None = None
    measure_error: np.ndarray | None = None
    waves: bool = False
    _known: dict[str, Values] = field(default_factory=dict, init=False, repr=False)

    def response(
        self, edges: tuple[float, ...], staircase: bool = False, half_samples: bool = True
    ) -> Response:
        """In bands between edges (K + 1,), Hz."""
        found = in_bands(self.stored, edges, staircase=staircase, plain=self._plain)
        towards = self.towards if self.towards is not None and np.any(self.towards) else None
        if towards is not None:
            towards = np.asarray(towards, float) / np.linalg.norm(towards)
        return response_of(found, self.stored, towards, half_samples)

    @cached_property
    def _plain(self) -> Echogram:
        return without_air(self.stored)

    @cached_property
    def _asked(self) -> Response:
        return self.response(self.bands.edges)

    @cached_property
    def _simulated(self) -> Response:
        """In the bands that were simulated, as if without air, whose course within bands is known."""
        return response_of(self._plain, self.stored, self._asked.towards, False)

    @cached_property
    def _stairs(self) -> Response:
        return self.response(self.bands.edges, staircase=True, half_samples=False)

    @cached_property
    def _speech(self) -> tuple[Response, Response] | None:
        """In the octaves of speech, with and without slopes; None if they were not all simulated."""
        edges, _ = fractional_octaves(1, OCTAVES[0], OCTAVES[-1])
        if not (self.stored.bands[0] <= 1.02 * edges[0] and 1.02 * self.stored.bands[-1] >= edges[-1]):
            return None
        asked = tuple(edges.tolist())
        own = self.bands.edges
        if asked[0] in own and own[own.index(asked[0]) :][: len(asked)] == asked:
            first = own.index(asked[0])
            rows = slice(first, first + len(OCTAVES))
            return self._asked.of_bands(rows), self._stairs.of_bands(rows)
        return self.response(asked), self.response(asked, staircase=True, half_samples=False)

    def values(self, name: str) -> Values:
        """A parameter by its name in `PARAMETERS`."""
        if name not in self._known:
            self._known[name] = self._values(name)
        return self._known[name]

    def _values(self, name: str) -> Values:
        parameter = PARAMETERS[name]
        function = find_parameter(name)
        if parameter.takes in ("speech", "index"):
            return self._of_speech(parameter, function)
        further = (self.conditions.hrtf,) if parameter.takes == "hrtf" else ()
        found = function(self._asked, *further)
        if name in MEASURES:
            error = self._stored_error(name, found[0])
        elif name in ("curvature", "nonlinearity"):
            error = self._curvature_error(name, found[0])
        else:
            error = spread(found)
        if parameter.takes == "hrtf":  # differs over bands since ears do
            step = np.abs(function(self._stairs, *further)[0] - found[0])
        else:
            step = self._interpolation(np.asarray(function(self._simulated)[0]))
        value = np.asarray(found[0])
        if name in _TIMES:
            value = np.where(error > LARGEST_ERROR * value, np.nan, value)
        known = np.isfinite(value)
        values = Values(value, np.where(known, error, np.nan), np.where(known, step, np.nan))
        return self._with_waves(values, name) if self.waves and name in LOW_MEASURES else values

    @cached_property
    def _low(self) -> RoomMeasures | None:
        """Of the bands that lie below the edge of waves; None if none does."""
        low = self.stored.low
        if low is None:
            raise ConfigError('waves: there are none; simulate with `[simulation.low] method = "waves"`')
        count = bands_below(self.bands.edges, low.edge)
        onset = self._asked.onset * BIN_S if self.stored.direct is None else self.stored.direct.delay
        return low_measures(low, self.bands.edges[: count + 1], onset) if count else None

    def _with_waves(self, values: Values, name: str) -> Values:
        if self._low is None:
            return values
        own = getattr(self._low, name)
        return Values(
            np.append(own, values.value[len(own) :]),
            *(np.append(np.full(len(own), np.nan), x[len(own) :]) for x in values[1:]),
        )

    def _of_speech(self, parameter: Parameter, function: Callable[..., Any]) -> Values:
        count = len(self.bands.centre) if parameter.takes == "speech" else 1
        missing = np.full(count, np.nan)
        if self._speech is None:
            return Values(missing, missing, missing)
        found, stairs = (np.asarray(function(r, self.conditions.speech)) for r in self._speech)
        value, error = found[0], spread(found)
        step = np.abs(stairs[0] - found[0])
        if parameter.takes == "index":
            return Values(value[None], error[None], step[None])
        rows = [OCTAVES.index(f) if f in OCTAVES else -1 for f in self.bands.centre]
        octaves = len(self.bands.edges) > 2 and self.bands.edges[1] > 1.9 * self.bands.edges[0]
        picked = [
            np.where((np.array(rows) >= 0) & octaves, v[rows], np.nan) for v in (value, error, step)
        ]
        return Values(*picked)

    @cached_property
    def _pieces(self) -> Pieces:
        return pieces_of(self.stored.bands, self.bands.edges)

    @cached_property
    def _weights(self) -> np.ndarray:
        """(K, B) share of each stored band in the bands asked for."""
        out = np.zeros((len(self.bands.centre), len(self.stored.bands) - 1))
        p = self._pieces
        np.add.at(out, (p.target, p.stored), p.weight)
        return out

    def _stored_error(self, name: str, value: np.ndarray) -> np.ndarray:
        """Relative for times and D50's odds, absolute for levels, as errors are alike over bands."""
        if self.measure_error is None:
            return np.full(len(value), np.nan)
        known = self.measure_error[MEASURES.index(name)].astype(float)
        if tuple(self.bands.edges) == tuple(self.stored.bands):
            return np.where(np.isfinite(value), known, np.nan)
        own = find_parameter(name)(self._simulated)[0]

        def scale(x: np.ndarray) -> np.ndarray:
            if name == "d50":
                return np.asarray(x * (1.0 - x))
            return np.ones_like(x) if name in ("c50", "c80", "drr") else x

        with np.errstate(divide="ignore", invalid="ignore"):
            relative = known / scale(own)
        return self._mean_of(relative) * scale(value)

    def _mean_of(self, values: np.ndarray) -> np.ndarray:
        """(K,) means of (B,) over the bands asked for; NaN where one that takes part is."""
        weights = self._weights
        mean = weights @ np.where(np.isfinite(values), values, 0.0)
        return np.where((weights[:, ~np.isfinite(values)] > 0.0).any(axis=1), np.nan, mean)

    def _curvature_error(self, name: str, value: np.ndarray) -> np.ndarray:
        """Of T30 / T20 - 1, the larger of both relative errors' sums of squares; of the nonlinearity, not
        known."""
        if name == "nonlinearity":
            return np.full(len(value), np.nan)
        times = [self.values(n) for n in ("t20", "t30")]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray((100.0 + value) * np.hypot(*(v.error / v.value for v in times)))

    def _interpolation(self, own: np.ndarray) -> np.ndarray:
        """(K,) of a parameter with values (B,) in the bands that were simulated."""
        if tuple(self.bands.edges) == tuple(self.stored.bands):
            return np.zeros(len(own))
        p = self._pieces
        step = np.full(len(own) + 1, np.nan)
        step[1:-1] = np.abs(own[1:] - own[:-1])
        step[np.isinf(step)] = np.nan
        largest = np.fmax(step[1:], step[:-1])
        loose = 1.0 - np.minimum(p.filled, 1.0)
        return p.means(np.where(loose > 1e-9, loose * largest[p.stored] / np.sqrt(12.0), 0.0))

    def single_number(self, name: str, found: Values) -> Values:
        """The value over the octaves that ISO 3382-1, table A.1 names; NaN if the bands have no such range.
        Errors are averaged: bands share their subpaths."""
        parameter = PARAMETERS[name]
        missing = np.full(1, np.nan)
        if parameter.takes == "index":
            return found
        if parameter.averaged is None:
            return Values(missing, missing, missing)
        use = _averaged(self.bands.edges, parameter.averaged)
        if use is None:
            return Values(missing, missing, missing)
        mean = found.value[use].mean(keepdims=True)
        if parameter.energetic:
            mean = 10.0 * np.log10((10.0 ** (found.value[use] / 10.0)).mean(keepdims=True))
        return Values(
            mean, found.error[use].mean(keepdims=True), found.interpolation[use].mean(keepdims=True)
        )


@lru_cache(maxsize=64)
def _averaged(edges: tuple[float, ...], octaves: tuple[float, float]) -> np.ndarray | None:
    """(K,) which bands between edges lie within the range of octaves; None if they do not fill it."""
    low, high = octaves[0] * 2.0**-0.5, octaves[1] * 2.0**0.5
    below, above = np.asarray(edges[:-1]), np.asarray(edges[1:])
    use = (below * _WIDEST_CENTRE >= low) & (above <= high * _WIDEST_CENTRE)
    whole = use.any() and below[use][0] <= low * _WIDEST_CENTRE
    return use if whole and above[use][-1] * _WIDEST_CENTRE >= high else None


def spread(found: np.ndarray) -> np.ndarray:
    """(…) root mean square by which half-samples (rows from 1 on of (R, …)) differ from the estimate (row 0)."""
    if len(found) < 2:
        return np.full(found.shape[1:], np.nan)
    return np.asarray(np.sqrt(((found[1:] - found[0]) ** 2).mean(axis=0)))
