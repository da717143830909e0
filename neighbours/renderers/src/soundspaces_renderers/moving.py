"""Sources and listeners that move without jumps: Doppler shifts for what arrives alone, cross-fades for the rest.

Echograms are known between points. Along a way, points take turns to stand for it (`Turns`), cross-faded
linearly from one's middle instant to the next one's. The direct sound and the early mirror reflections travel a
path whose length changes all the time: what is heard at t left at t_e, where c (t - t_e) = D(t_e, t). For the
direct sound D is the distance from the source at t_e to the listener at t. For a reflection it is the length
between the points, plus by how much each end's displacement changes its distance to the other's mirror image:
exact while one end rests, off in the second order of the displacements else. So points in turn agree on a
path's length, and cross-fading their amplitudes leaves one sound. Reverberation is cross-faded in power, since
responses of two points are independent: by what is emitted along the source's way, by what is heard along the
listener's. Waves below an edge are cross-faded in pressure: a linear interpolation between points.

Amplitudes go as 1 / D; the convective amplification of a source that moves (less than (1 - v/c)^-2) is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from soundspaces_sim import ConfigError, Directivity, Echogram, PointError, binaural_moving, directed
from soundspaces_sim.parts import (
    LEAST_DISTANCE,
    SECOND_ORDER_CHANNELS as CHANNELS,
    Rendering,
    above_edge as above,
    aim_directivity as aim,
    arrival_filters,
    as_directivity,
    as_ears,
    as_mono,
    convolve_sound as convolve,
    departure_directions as departures,
    directivity_gains as gains,
    kernel,
    sinc_table,
    spherical_harmonics,
    waves_below as below,
    without_arrivals,
)

_CONTROL_S = 1e-3  # between instants at which a path is computed
_LOOK_S = 0.01  # between instants at which the nearest point is looked up
_COLOUR_S = 0.05  # in which the direct sound of a directive source keeps its colour
_MOST_MACH = 0.3  # of an end
_MOST_STEPS, _SAME_S = 30, 1e-9  # of the search for the instant of emission
_FILTER_S = 0.1  # in which the colour of an arrival rings out


class Way(NamedTuple):
    """Where an end is: straight and even between positions (k, 3) m at times (k,) s, at rest before and after."""

    time: np.ndarray
    position: np.ndarray

    def at(self, time: np.ndarray) -> np.ndarray:
        """(n, 3) at times (n,)."""
        return np.stack([np.interp(time, self.time, x) for x in self.position.T], axis=1)


class Known(NamedTuple):
    """What is known between points."""

    points: np.ndarray  # (N, 3) m
    echogram: Callable[[int, int], Echogram]  # from one point to another
    respond: Callable[
        [Echogram, int, int], np.ndarray
    ]  # (9, n) of an echogram, with the noise of a pair
    duration: float  # s, of the echograms
    rate: int  # Hz
    speed_of_sound: float  # m/s
    reach: float  # m, how far from its nearest point a way may be


class Turns(NamedTuple):
    """The points that stand for a way in turn: `point` (k,) most at time `middle` (k,), rising."""

    point: np.ndarray
    middle: np.ndarray

    def weight(self, k: int, time: np.ndarray) -> np.ndarray:
        """(n,) share of the k-th at times (n,); over all k they sum to one."""
        return np.interp(time, self.middle, np.arange(len(self.middle)) == k)

    def begin(self, k: int) -> float:
        """Time before which the k-th has no share, s."""
        return float(self.middle[k - 1]) if k > 0 else -math.inf

    def end(self, k: int) -> float:
        """Time after which it has none, s."""
        return float(self.middle[k + 1]) if k + 1 < len(self.middle) else math.inf


# Length (n,) m and direction at the listener (n, 3) of a path, for the ends at (n, 3) each.
Path = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def as_way(rows: ArrayLike, what: str, speed_of_sound: float) -> Way:
    """Rows (t s, x, y, z m) with rising times. Raises `PointError`, also beyond 0.3 of the speed of sound."""
    table = np.asarray(rows, float)
    if table.ndim != 2 or table.shape[1] != 4 or len(table) < 1 or not np.isfinite(table).all():
        raise PointError(f"{what}: expected finite rows (t, x, y, z), shape (k, 4), got {table.shape}")
    step = np.diff(table[:, 0])
    if (step <= 0.0).any():
        k = int(np.argmax(step <= 0.0))
        raise PointError(
            f"{what}: expected rising times, got {table[k, 0]:g} s, then {table[k + 1, 0]:g} s"
        )
    speed = np.linalg.norm(np.diff(table[:, 1:], axis=0), axis=1) / step
    if speed.max(initial=0.0) > _MOST_MACH * speed_of_sound:
        raise PointError(
            f"{what}: expected at most {_MOST_MACH * speed_of_sound:.0f} m/s, got {speed.max():.0f} m/s"
        )
    return Way(table[:, 0], table[:, 1:])


def _turns(way: Way, known: Known, until: float, what: str) -> Turns:
    """The nearest points along a way from 0 to `until` s. Raises `PointError` where none is near."""
    time = np.concatenate([np.arange(0.0, until, _LOOK_S), [until], way.time])
    time = np.unique(np.clip(time, 0.0, until))
    place = way.at(time)
    away = np.stack([np.linalg.norm(place - p, axis=1) for p in known.points], axis=1)
    nearest, far = away.argmin(axis=1), away.min(axis=1)
    if far.max() > known.reach:
        k = int(far.argmax())
        raise PointError(
            f"{what}: at {time[k]:.2f} s it is at {np.round(place[k], 2).tolist()} m, {far[k]:.2f} m from the "
            f"nearest point; expected at most {known.reach:g} m, the spacing of the points"
        )
    first = np.flatnonzero(np.diff(nearest, prepend=-1))
    edges = np.array([*time[first], until])
    middle = 0.5 * (edges[:-1] + edges[1:])
    if len(middle) > 1:
        middle[0], middle[-1] = edges[0], edges[-1]
    return Turns(nearest[first], middle)


def _refined(rough: Turns, most: float) -> Turns:
    """The same points in more and shorter turns, at most `most` s from one to the next."""
    parts = [rough.middle[:1]]
    for low, high in pairwise(rough.middle):
        parts.append(np.linspace(low, high, math.ceil((high - low) / most) + 1)[1:])
    middle = np.concatenate(parts)
    row = np.rint(np.interp(middle, rough.middle, np.arange(len(rough.middle))))
    return Turns(rough.point[row.astype(int)], middle)


def render_moving(
    dry: np.ndarray, source: Way, listener: Way, known: Known, emits: Directivity | None = None
) -> np.ndarray:
    """(9, n) float32 sound field at a listener of a dry mono signal (m,) whose first sample leaves at 0 s.

    `emits`: directivity of the source, in world axes. It lasts as long as the signal and the echograms' duration
    after it. Raises `PointError`.
    """
    until = len(dry) / known.rate
    a = _turns(source, known, until, "sources")
    b = _turns(listener, known, until, "listeners")
    plain = cache(known.echogram)
    out = np.zeros((CHANNELS, len(dry) + _tail(known)), np.float32)
    low = plain(int(a.point[0]), int(b.point[0])).low
    scene = _Scene(dry, source, listener, known, out, out if low is None else np.zeros_like(out))
    for i, j in _meeting(a, b, known.duration):
        s, l = int(a.point[i]), int(b.point[j])
        whole, back = plain(s, l), plain(l, s)
        echoes = directed(whole, back, emits, speed_of_sound=known.speed_of_sound)
        _add_responses(scene, a, i, b, j, without_arrivals(echoes))
        for arrival, left in zip(echoes.early, departures(whole.early, back.early), strict=True):
            length = arrival.delay * known.speed_of_sound
            path = _mirrored(
                known.points[l] + length * arrival.direction, known.points[s] + length * left, length
            )
            _add_arrival(scene, a, i, b, j, echoes, arrival.energy * length**2, arrival.delay, path)
    if emits is not None:
        a, b = _refined(a, _COLOUR_S), _refined(b, _COLOUR_S)
    for i, j in _meeting(a, b, known.duration):
        echoes = plain(int(a.point[i]), int(b.point[j]))
        if echoes.direct is None:
            continue
        apart = float(np.linalg.norm(known.points[a.point[i]] - known.points[b.point[j]]))
        energy = echoes.direct.energy * max(apart, LEAST_DISTANCE) ** 2
        to = aim(emits, echoes.bands, "power")
        if to is not None:
            energy = energy * gains(to, listener.at(b.middle[[j]]) - source.at(a.middle[[i]]))[0]
        path = _straight(LEAST_DISTANCE)
        _add_arrival(scene, a, i, b, j, echoes, energy, echoes.direct.delay, path)
    if low is None:
        return out
    return out + above(scene.discrete, low.edge, known.rate, arrivals=True)


class _Scene(NamedTuple):
    dry: np.ndarray
    source: Way
    listener: Way
    known: Known
    out: np.ndarray
    discrete: np.ndarray  # of discrete arrivals: `out`, unless there are waves below an edge


def _tail(known: Known) -> int:
    return math.ceil(known.duration * known.rate)


def _meeting(a: Turns, b: Turns, duration: float) -> Iterator[tuple[int, int]]:
    """Turns (i, j) of which what leaves in i is heard in j."""
    for i in range(len(a.point)):
        for j in range(len(b.point)):
            if b.begin(j) <= a.end(i) + duration and a.begin(i) <= b.end(j):
                yield i, j


def _straight(least: float) -> Path:
    """From one end to the other."""

    def path(s: np.ndarray, l: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset = s - l
        length = np.linalg.norm(offset, axis=1)
        known = length[:, None] > 0.0
        direction = np.where(known, offset / np.where(known, length[:, None], 1.0), 0.0)
        return np.maximum(length, least), direction

    return path


def _mirrored(image: np.ndarray, seen: np.ndarray, length: float) -> Path:
    """By way of mirrors: `image` (3,) of the source as heard, `seen` (3,) that of the listener as the source
    has it, both for ends `length` m apart along the path."""

    def path(s: np.ndarray, l: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        towards = image - l
        heard = np.linalg.norm(towards, axis=1)
        left = np.linalg.norm(seen - s, axis=1)
        return heard + left - length, towards / heard[:, None]

    return path


def _add_responses(scene: _Scene, a: Turns, i: int, b: Turns, j: int, late: Echogram) -> None:
    """Reverberation and, of echograms that have them, waves: of two points the latter are one field, so their
    pressures are cross-faded and not their powers."""
    pair, low = (int(a.point[i]), int(b.point[j])), late.low
    if low is None:
        _add_convolved(scene, a, i, b, j, scene.known.respond(late, *pair), 0.5)
        return
    noise = scene.known.respond(replace(late, low=replace(low, signal=0.0 * low.signal)), *pair)
    _add_convolved(scene, a, i, b, j, noise, 0.5)
    waves = below(low, noise.shape, scene.known.rate)
    _add_convolved(scene, a, i, b, j, waves, 1.0)


def _add_convolved(
    scene: _Scene, a: Turns, i: int, b: Turns, j: int, response: np.ndarray, power: float
) -> None:
    """What is emitted in turn i, through a response, as heard in turn j; `power` of the turns' weights."""
    rate, n = scene.known.rate, scene.out.shape[1]
    said = a.weight(i, np.arange(len(scene.dry)) / rate) ** power
    voiced = np.flatnonzero(said)
    if len(voiced) == 0:
        return
    first, last = int(voiced[0]), int(voiced[-1]) + 1
    voice = (scene.dry[first:last] * said[first:last]).astype(np.float32)
    part = convolve(voice, response)[:, : n - first]
    heard = b.weight(j, (first + np.arange(part.shape[1])) / rate) ** power
    scene.out[:, first : first + part.shape[1]] += part * heard.astype(np.float32)


def _add_arrival(
    scene: _Scene,
    a: Turns,
    i: int,
    b: Turns,
    j: int,
    echoes: Echogram,
    energy: np.ndarray,
    delay: float,
    path: Path,
) -> None:
    """One path, of which `energy` (bands,) arrives at 1 m, air as after `delay` s, i and j are its ends."""
    known, rate = scene.known, scene.known.rate
    low = max(a.begin(i), b.begin(j), 0.0)
    high = min(a.end(i) + known.duration, b.end(j), scene.out.shape[1] / rate)
    if high <= low or not energy.max() > 0.0:
        return
    heard = np.arange(math.floor(low / _CONTROL_S), math.ceil(high / _CONTROL_S) + 2) * _CONTROL_S
    left, length, direction = _emission(scene, heard, path)
    share = a.weight(i, left) * b.weight(j, heard) / length
    inside = (left > -_CONTROL_S) & (left < len(scene.dry) / rate + _FILTER_S)
    use = np.flatnonzero((share > 0.0) & inside)
    if len(use) == 0:
        return
    rows = slice(max(use[0] - 1, 0), use[-1] + 2)
    heard, left = heard[rows], left[rows]
    tone = spherical_harmonics(direction[rows])
    tone[~direction[rows].any(axis=1)] = np.eye(CHANNELS)[0]  # at the very place: from all around
    levels = (tone * share[rows, None]).T
    first = math.ceil(heard[0] * rate)
    time = np.arange(first, min(math.floor(heard[-1] * rate) + 1, scene.out.shape[1])) / rate
    sound, start = _filtered(scene.dry, left[0] * rate, left[-1] * rate, energy, delay, echoes, rate)
    _play(
        scene.discrete,
        sound,
        first,
        scipy.interpolate.CubicSpline(heard, left)(time) * rate - start,
        np.stack([np.interp(time, heard, row) for row in levels]).astype(np.float32),
        sinc_table(echoes.bands, rate),
    )


def _emission(scene: _Scene, heard: np.ndarray, path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """When what is heard at times (n,) left, and the length and direction (n, 3) of its path: a fixed point,
    closer by the Mach number of the source with each step."""
    places, left = scene.listener.at(heard), heard
    for _ in range(_MOST_STEPS):
        length, direction = path(scene.source.at(left), places)
        before, left = left, heard - length / scene.known.speed_of_sound
        if np.abs(left - before).max() < _SAME_S:
            break
    return left, length, direction


def _filtered(
    dry: np.ndarray,
    first: float,
    last: float,
    energy: np.ndarray,
    delay: float,
    echoes: Echogram,
    rate: int,
) -> tuple[np.ndarray, int]:
    """Samples `first` to `last` of a signal with the colour of band energies, and the number of its first one."""
    colour = echoes.bands, rate, echoes.air, np.array([delay])
    response, starts = arrival_filters(energy[None], np.zeros(1), *colour)
    reach = response.shape[1]
    low = max(math.floor(first) - 2 * reach, 0)
    part = dry[low : max(math.ceil(last) + reach, low + 1)]
    if len(part) == 0:
        return np.zeros(1, np.float32), low
    return convolve(part, response.astype(np.float32))[0], low + int(starts[0])


@kernel
def _play(
    out: np.ndarray,
    sound: np.ndarray,
    first: int,
    position: np.ndarray,
    gains: np.ndarray,
    table: np.ndarray,
) -> None:
    """Add `sound` (m,) to `out` (c, n) from sample `first` on, read at fractional samples `position` (k,) and times
    `gains` (c, k). `table` (phases + 1, taps): `filters.sinc_table`, between whose rows values are linear."""
    phases, taps = table.shape[0] - 1, table.shape[1]
    for i in range(len(position)):
        whole = math.floor(position[i])
        row = (position[i] - whole) * phases
        k = min(int(row), phases - 1)
        mix = row - k
        start = int(whole) - taps // 2 + 1
        y = 0.0
        for j in range(max(0, -start), min(taps, len(sound) - start)):
            y += ((1.0 - mix) * table[k, j] + mix * table[k + 1, j]) * sound[start + j]
        for c in range(out.shape[0]):
            out[c, first + i] += gains[c, i] * y


def render_ways(
    rendering: Rendering,
    audio: ArrayLike,
    sources: ArrayLike,
    listeners: ArrayLike,
    orientations_deg: ArrayLike,
    source: Directivity | str | Sequence[Directivity | str | None] | None,
    points: np.ndarray,
    echogram: Callable[[int, int], Echogram],
    duration: float,
) -> np.ndarray:
    """(2, n): a dry signal by a `rendering`, whose source and listener move along rows (t, x, y, z) in s and m.
    `points` (N, 3) m, at least two: between them `echogram` gives echograms of `duration` s. Raises `PointError`,
    `ConfigError`."""
    if not (source is None or isinstance(source, Directivity | str)):
        raise ConfigError("source: expected one directivity where a way is given in metres")
    dry = as_mono(audio)
    spacing = np.asarray(KDTree(points).query(points, 2)[0])[:, 1]
    known = Known(
        points=points,
        echogram=echogram,
        respond=rendering.ambisonic,
        duration=duration,
        rate=rendering.rate,
        speed_of_sound=rendering.c,
        reach=float(np.median(spacing)),
    )
    a, b = as_way(sources, "sources", rendering.c), as_way(listeners, "listeners", rendering.c)
    field = render_moving(dry, a, b, known, as_directivity(source, "source"))
    turns, ears = np.atleast_2d(np.asarray(orientations_deg, float)), as_ears(rendering.ears)
    return binaural_moving(
        field, turns, rendering.rate, ears.hrtf, decoder=ears.decoder, equalisation=ears.equalisation
    )
