"""What two ears hear during a step, of sources that go on sounding, from responses that are kept.

Conventions: block j of `block` samples is heard during step j, at the pose reached by it. Partitioned convolution
by overlap and save: a response is cut into partitions of one block, whose spectra multiply those of the source's
windows; windows reach `fade` samples beyond their block, so a pose's sound goes on into the next block, and the two
poses' sounds are cross-faded there, linearly in amplitude. An agent thus moves in the first `fade` samples of a
step and rests for the others; no sample jumps.

Reverberation of a pair is kept as what both ears hear, by harmonics of the heading: order-2 ambisonics have none
above the second, so that five give any heading exactly. Several points add with the roots of their shares: their
noises are independent, so their powers add as shares. The sum is transformed, not each pair. Of discrete paths the
colour is kept; level, delay and direction follow the place. What both ears hear of them there is kept by harmonics
of the heading, for an agent that turns.

What is kept of a pair is rounded to 16 bits with one scale for each `_STRETCH` samples, that of their peak; to 8
bits where that stays below 2^-8 of the response's. So the error is at most 2^-16 of the response's peak (-96 dB).
Spectra were five times as large; of these responses all pairs of a home fit into memory.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import scipy.fft

from soundspaces_continuous.moved_paths import Paths
from soundspaces_continuous.signals import SourceSignal
from soundspaces_continuous.sound_field import Place, SoundField
from soundspaces_sim import ConfigError, Echogram
from soundspaces_sim.parts import (
    BlockCache,
    air_spectrum,
    arrival_filters,
    decoder_filters,
    harmonics_of_direction as harmonics,
    kernel,
    kernel_part as part,
    without_arrivals,
)

HARMONICS = 5  # of the heading: 2 N + 1 for order N = 2
#: Of each ambisonic channel: where its cosine goes among the harmonics of the heading; the channel of the same
#: degree and order with sine for cosine.
_HARMONIC, _PARTNER = np.array([0, 1, 0, 1, 3, 1, 0, 1, 3]), np.array([0, 3, 2, 1, 8, 7, 6, 5, 4])
_MOST_PLACES = 32  # whose discrete paths are kept
_LEGS = 3  # straight stretches of a discrete path, at most
_GRIDS = 4  # sizes of transforms of discrete paths, by the longest
_SIDE_BY_SIDE = 4  # rows that a transform takes at once; others it takes one by one, as slowly as four
_LANES = 64  # bins that are turned together
_STRETCH = 128  # samples with one scale
_FINE, _COARSE = 32767.0, 127.0  # the largest of 16 and of 8 bits
_LOUD = 2.0**-8  # of a response's peak, from which 16 bits are kept

_Key = TypeVar("_Key", bound=Hashable)
_Kept = TypeVar("_Kept")


class LastUsed(Generic[_Key, _Kept]):
    """What was made last by key, at most `most` of it. Not shared between threads."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._kept: OrderedDict[_Key, _Kept] = OrderedDict()

    def get(self, key: _Key, make: Callable[[], _Kept]) -> _Kept:
        """What is kept under `key`; made, and kept, if there is nothing."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        made = self._kept[key] = make()
        if len(self._kept) > self.most:
            self._kept.popitem(last=False)
        return made


class Sounding(NamedTuple):
    """A source that sounds."""

    signal: SourceSignal
    place: Place


class _Packed(NamedTuple):
    """Samples (g, r, n), of groups whose rows share their scales."""

    fine: np.ndarray  # (g, r, m) int16, the first m
    coarse: np.ndarray  # (g, r, n - m) int8
    scale: np.ndarray  # (g, stretches) float32


class _Grid(NamedTuple):
    """Frequencies at which discrete paths are added up, and room for it."""

    size: int  # samples
    ears: np.ndarray  # (2, 9, 2, f) of the decoder
    air: (
        np.ndarray
    )  # (2, f) logarithm of what a metre of air does; zeros where echograms do not tell its course
    field: np.ndarray  # (9, 2, f)
    path: np.ndarray  # (2, f)
    lanes: np.ndarray  # (2, _LANES)
    both: (
        np.ndarray
    )  # (5 + 1, 2, f) complex64: ears by harmonics of the heading, and silence (`_SIDE_BY_SIDE`)


def _longest(late: list[tuple[_Packed, np.ndarray]]) -> int:
    return max(packed.fine.shape[2] + packed.coarse.shape[2] for packed, _ in late)


def _harmonics(heading: float) -> np.ndarray:
    """(5,) float32: 1, and cosine and sine of the heading (rad) and of twice the heading."""
    c, s = math.cos(heading), math.sin(heading)
    return np.array([1.0, c, s, c * c - s * s, 2.0 * c * s], np.float32)


class StepRenderer:
    """Renders steps in one `field`. `block`, `fade`: samples, of a step and of the cross-fade in it; `memory`: of
    spectra, shared by scenes if it is given. Raises `ConfigError` for ears that are not those of a SOFA file."""

    def __init__(self, field: SoundField, block: int, fade: int, memory: BlockCache) -> None:
        ds = field.ds
        if not 0 < fade <= block:
            raise ConfigError(f"fade: expected 1 to {block} samples, a step, got {fade}")
        if not (ds.hrtf is None or isinstance(ds.hrtf, str | Path)):
            raise ConfigError(
                "hrtf: expected the path of a SOFA file or None where poses are continuous"
            )
        self.field, self.block, self.fade, self.memory = field, block, fade, memory
        self.rate, self._hrtf = ds.rate, ds.hrtf
        self.window = 2 * block + fade
        self.size = 2 * int(scipy.fft.next_fast_len(-(-self.window // 2), real=True))
        self._filters, self._lead = decoder_filters(self.rate, self._hrtf, "aligned", "diffuse-field")
        self._reach = _LEGS * field.scene.diagonal
        bands = ds.manifest.config.simulation.bands
        probe, starts = arrival_filters(np.ones((1, len(bands) - 1)), np.zeros(1), bands, self.rate)
        self._colour_taps, self._taps = probe.shape[1], self._filters.shape[2]
        self._ahead = float(starts[0]) - 0.5  # samples by which a colour begins before its path arrives
        self._ears = lru_cache(maxsize=4)(lambda size: _apart(scipy.fft.rfft(self._filters, size)))
        self._grids = lru_cache(maxsize=_GRIDS)(self._make_grid)
        self._tone = np.empty(9)
        self._kept: LastUsed[tuple[bytes, bytes], np.ndarray] = LastUsed(_MOST_PLACES)
        turns = np.exp(np.arange(self.size // 4 + 1) * (2.0j * np.pi / self.size))
        self._turns, self._folded = turns.astype(np.complex64), np.empty((4, len(turns)), np.complex64)
        self._cut = np.zeros((0, 2, self.size), np.float32)  # partitions, and silence as long
        self._rise = ((np.arange(fade) + 0.5) / fade).astype(np.float32)
        self._key = (id(field), block, fade)

    def _make_grid(self, number: int) -> _Grid:
        """For paths of up to `number` of `_GRIDS` parts of the longest."""
        longest = math.ceil(number / _GRIDS * self._reach / self.field.c * self.rate)
        size = int(scipy.fft.next_fast_len(longest + self._taps + self._colour_taps, real=True))
        bins, air = size // 2 + 1, self.field.ds.manifest.config.simulation.air
        log = np.zeros(bins) if air is None else air_spectrum(air, self.rate, size)
        return _Grid(
            size, _apart(scipy.fft.rfft(self._filters, size)), _apart(log),
            np.empty((9, 2, bins), np.float32), np.empty((2, bins), np.float32), np.empty((2, _LANES)),
            np.zeros((HARMONICS + 1, 2, bins), np.complex64),
        )  # fmt: skip

    def hear(
        self,
        step: int,
        sounding: Sequence[Sounding],
        listener: Place,
        heading: float,
        tail: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(2, block) float32 during step `step` at a place, facing `heading` rad; and the tail (2, fade)
        that goes on into the next step. `tail`: that of the step before; None: there was none."""
        total = np.zeros((2, self.size // 2 + 1), np.complex64)
        out, after = np.zeros((2, self.block), np.float32), np.zeros((2, self.fade), np.float32)
        heard = False
        for source in sounding:
            if not source.signal.has_begun(step, self):
                continue  # nor is anything made for it
            late = self._late_of(source.place, listener, _harmonics(heading))
            longest = max(_longest(late), self._grids(_GRIDS).size - self._lead)
            parts = range(-(-longest // self.block))
            spectra = [source.signal.spectrum(step - p, self) for p in parts]
            last = max((p + 1 for p in parts if spectra[p] is not None), default=0)
            if last:
                early = self._early_of(source.place, listener)
                partitions = self._partitions(early, late, heading, last)
                for spectrum, partition in zip(spectra, partitions, strict=False):
                    if spectrum is not None:
                        _multiply(total, spectrum, partition)
                heard = True
        if heard:
            _fold(self._folded, total, self._turns)
            halves = scipy.fft.irfft(self._folded, self.size // 2)
            _interleave(out, halves, self.block)
            _interleave(after, halves, 2 * self.block)
        if tail is not None:
            out[:, : self.fade] = tail + (out[:, : self.fade] - tail) * self._rise
        return out, after

    def _late_of(
        self, source: Place, listener: Place, turn: np.ndarray
    ) -> list[tuple[_Packed, np.ndarray]]:
        """Reverberation of pairs, with weights (5,) of their harmonics, from a place at another."""
        return [
            (self._late_of_pair(s, l), np.float32(math.sqrt(of_s * of_l)) * turn)
            for s, of_s in zip(source.points, source.shares, strict=True)
            for l, of_l in zip(listener.points, listener.shares, strict=True)
        ]

    def _early_of(self, source: Place, listener: Place) -> np.ndarray:
        """`_early`, kept for the last places."""
        key = source.position.tobytes(), listener.position.tobytes()
        return self._kept.get(key, lambda: self._early(source, listener))

    def _partitions(
        self, early: np.ndarray, late: list[tuple[_Packed, np.ndarray]], heading: float, count: int
    ) -> np.ndarray:
        """(count, 2, F) complex64 spectra of the first partitions of a response."""
        if count > len(self._cut):
            self._cut = np.zeros((count, 2, self.size), np.float32)
        cut, block = self._cut[:count], self.block
        cut[:, :, :block] = 0.0
        _add_early(cut, block, early, self._lead, _harmonics(heading))
        for packed, weights in late:
            _add_late(cut, block, packed.fine[0], packed.scale[0], weights, 0)
            _add_late(cut, block, packed.coarse[0], packed.scale[0], weights, packed.fine.shape[2])
        return np.asarray(scipy.fft.rfft(cut))

    def _early(self, source: Place, listener: Place) -> np.ndarray:
        """(5 + 1, 2, samples) float32: the discrete paths at both ears, by harmonics of the heading; `_lead`
        samples late."""
        if self.field.paths == "simulated":
            found = self.field.simulated.arriving(source.position, listener.position)
            echogram, _ = self.field.pair(source.points[0], listener.points[0])
            n, length, direction = len(found.length), found.length, found.direction
            gain, further = np.ones(n), np.zeros(n)
        else:
            heard = self.field.heard(source, listener)
            gain, length, direction, further = heard[3:]
            n = len(length)
        if n == 0:
            return np.empty((HARMONICS + 1, 2, 0), np.float32)
        part_of = math.ceil(float(length.max()) * _GRIDS / self._reach)
        grid = self._grids(min(max(part_of, 1), _GRIDS))
        rows = -(-n // _SIDE_BY_SIDE) * _SIDE_BY_SIDE
        colour, first = np.zeros((rows, grid.size), np.float32), 0
        if self.field.paths == "simulated":
            colour[:n, : self._colour_taps] = self._colours(found.energy, found.length, echogram)
        else:
            for pair, end in zip(heard.pairs, heard.ends, strict=True):
                if end > first:
                    _unpacked(self._colour_of_pair(*pair), heard.rows[first:end], colour[first:end])
                first = end
        paths = np.stack([gain, length * (self.rate / self.field.c) + self._ahead, further])
        _add_paths(grid, scipy.fft.rfft(colour), np.ascontiguousarray(direction), paths, self._tone)
        _decode(grid.both, grid.field, grid.ears)
        return np.asarray(scipy.fft.irfft(grid.both, grid.size))

    def _colours(self, energy: np.ndarray, length: np.ndarray, echogram: Echogram) -> np.ndarray:
        """(k, taps) float32 responses of paths of `energy` (k, b) and `length` (k,) m that arrive at 0 s. Bands and
        air are those of `echogram`."""
        # Half a sample late, where the windowed sinc rolls off before Nyquist's frequency: shifts ring no more.
        at, delay = np.full(len(length), 0.5 / self.rate), length / self.field.c
        found, _ = arrival_filters(energy, at, echogram.bands, self.rate, echogram.air, delay)
        return found.astype(np.float32)

    def _late_of_pair(self, s: int, l: int) -> _Packed:
        """(1, 5 * 2, n): reverberation between two points at both ears, by harmonics of the heading."""
        return self._of_pair("late", s, l, lambda echogram, _: self._late(echogram, s, l))

    def _colour_of_pair(self, s: int, l: int) -> _Packed:
        """(paths, 1, taps): responses of the paths between two points, arriving at 0 s. Made when one of them is
        first heard: of the lighter points around a place it may be none, and none where paths are simulated."""
        return self._of_pair(
            "colour",
            s,
            l,
            lambda echogram, paths: self._colours(paths.energy, paths.length, echogram)[:, None],
        )

    def _of_pair(
        self, what: str, s: int, l: int, make: Callable[[Echogram, Paths], np.ndarray]
    ) -> _Packed:
        return _Packed(
            **self.memory.get(
                (*self._key, what, s, l), lambda: _packed(make(*self.field.pair(s, l)))._asdict()
            )
        )

    def _late(self, echogram: Echogram, s: int, l: int) -> np.ndarray:
        """(1, 5 * 2, n) float32 reverberation of an echogram of a pair: both ears, by harmonics of the heading."""
        field = self.field.ds.rendered(without_arrivals(echogram), s, l)
        n = field.shape[1]
        size = int(scipy.fft.next_fast_len(n + self._taps, real=True))
        both = np.empty((HARMONICS, 2, size // 2 + 1), np.complex64)
        _decode(both, _apart(scipy.fft.rfft(field, size)), self._ears(size))
        ears = scipy.fft.irfft(both, size, overwrite_x=True)[:, :, self._lead : self._lead + n]
        return ears.reshape(1, 2 * HARMONICS, n)


def _apart(spectra: np.ndarray) -> np.ndarray:
    """(…, 2, f) float32 of spectra (…, f): real and imaginary."""
    out = np.empty((*spectra.shape[:-1], 2, spectra.shape[-1]), np.float32)
    out[..., 0, :], out[..., 1, :] = spectra.real, spectra.imag
    return out


def _packed(samples: np.ndarray) -> _Packed:
    """Of samples (g, r, n)."""
    groups, rows, n = samples.shape
    samples = np.ascontiguousarray(samples, np.float32)
    scale = np.empty((groups, -(-n // _STRETCH)), np.float32)
    _peaks(samples, scale)
    loudest = scale.max(axis=1, keepdims=True, initial=0.0)
    loud = ((scale >= _LOUD * loudest) & (scale > 0.0)).any(axis=0)
    stretches = int(np.flatnonzero(loud)[-1]) + 1 if loud.any() else 0
    scale[:, :stretches] /= np.float32(_FINE)
    scale[:, stretches:] /= np.float32(_COARSE)
    split = min(stretches * _STRETCH, n)
    out = _Packed(
        np.empty((groups, rows, split), np.int16), np.empty((groups, rows, n - split), np.int8), scale
    )
    _round(samples, out.fine, scale, 0)
    _round(samples, out.coarse, scale, split)
    return out


def _unpacked(packed: _Packed, groups: np.ndarray, out: np.ndarray) -> None:
    """Fill the beginning of `out` (k, n) float32 with the first rows of some groups (k,)."""
    _unpack(out, packed.fine, packed.scale, groups, 0)
    _unpack(out, packed.coarse, packed.scale, groups, packed.fine.shape[2])


@kernel
def _peaks(samples: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (g, stretches) with the peaks of samples (g, r, n)."""
    groups, rows, n = samples.shape
    out[:] = 0.0
    for g in range(groups):
        for r in range(rows):
            for k in range(out.shape[1]):
                peak = out[g, k]
                for i in range(k * _STRETCH, min((k + 1) * _STRETCH, n)):
                    peak = max(peak, abs(samples[g, r, i]))
                out[g, k] = peak


@kernel
def _round(samples: np.ndarray, out: np.ndarray, scale: np.ndarray, first: int) -> None:
    """Fill `out` (g, r, m) with samples (g, r, n) from `first` on, where a stretch begins, in units of `scale`."""
    groups, rows, m = out.shape
    for g in range(groups):
        for r in range(rows):
            for start in range(0, m, _STRETCH):
                unit = scale[g, (first + start) // _STRETCH]
                inverse = np.float32(1.0) / unit if unit > 0.0 else np.float32(0.0)
                row, into = samples[g, r, first + start :], out[g, r, start:]
                for i in range(min(_STRETCH, m - start)):
                    into[i] = np.rint(row[i] * inverse)


@kernel
def _unpack(
    out: np.ndarray, samples: np.ndarray, scale: np.ndarray, groups: np.ndarray, first: int
) -> None:
    """Fill `out` (k, n) from `first` on with the first rows of `groups` (k,)."""
    n = samples.shape[2]
    for k in range(len(groups)):
        for start in range(0, n, _STRETCH):
            unit = scale[groups[k], (first + start) // _STRETCH]
            row, into = samples[groups[k], 0, start:], out[k, first + start :]
            for i in range(min(_STRETCH, n - start)):
                into[i] = np.float32(row[i]) * unit


@kernel
def _add_early(out: np.ndarray, block: int, early: np.ndarray, lead: int, weights: np.ndarray) -> None:
    """Add `early` (5 + 1, 2, n) from sample `lead` on to partitions `out` (k, 2, `block` or more), `weights` (5,)
    of its harmonics; what is beyond the last is left out."""
    a, b, c, d, e = weights
    for p in range(len(out)):
        first = lead + p * block
        for ear in range(2):
            into = out[p, ear]
            h0, h1, h2 = early[0, ear, first:], early[1, ear, first:], early[2, ear, first:]
            h3, h4 = early[3, ear, first:], early[4, ear, first:]
            for i in range(min(block, len(h0))):
                into[i] += a * h0[i] + b * h1[i] + c * h2[i] + d * h3[i] + e * h4[i]


@kernel
def _add_late(
    out: np.ndarray, block: int, late: np.ndarray, scale: np.ndarray, weights: np.ndarray, first: int
) -> None:
    """As `_add_early`, of packed samples (5 * 2, n) that begin at sample `first`, with `scale` (stretches,)."""
    n = min(len(out) * block - first, late.shape[1])
    for ear in range(2):
        start = 0
        while start < n:
            at = first + start
            k, p = at // _STRETCH, at // block
            unit = scale[k]
            a, b, c = weights[0] * unit, weights[1] * unit, weights[2] * unit
            d, e = weights[3] * unit, weights[4] * unit
            into = out[p, ear, at - p * block :]
            h0, h1, h2 = late[ear, start:], late[2 + ear, start:], late[4 + ear, start:]
            h3, h4 = late[6 + ear, start:], late[8 + ear, start:]
            stop = min((k + 1) * _STRETCH - at, (p + 1) * block - at, n - start)
            for i in range(stop):
                into[i] += (
                    a * np.float32(h0[i])
                    + b * np.float32(h1[i])
                    + c * np.float32(h2[i])
                    + d * np.float32(h3[i])
                    + e * np.float32(h4[i])
                )
            start += stop


@kernel
def _multiply(out: np.ndarray, spectrum: np.ndarray, part: np.ndarray) -> None:
    """Add `spectrum` (F,) times `part` (2, F) to `out` (2, F)."""
    for ear in range(2):
        into, of_ear = out[ear], part[ear]
        for f in range(len(spectrum)):
            into[f] += spectrum[f] * of_ear[f]


@kernel
def _fold(out: np.ndarray, spectra: np.ndarray, turns: np.ndarray) -> None:
    """Fill `out` (4, M / 2 + 1) with spectra of the even and of the odd samples of two signals with `spectra`
    (2, M + 1): four transforms of M samples take half as long as two of 2 M (`_SIDE_BY_SIDE`). `turns`
    (M / 2 + 1,): by half a sample."""
    m = spectra.shape[1] - 1
    half = np.float32(0.5)
    for ear in range(2):
        own, even, odd = spectra[ear], out[2 * ear], out[2 * ear + 1]
        for k in range(len(turns)):
            a, b = own[k], own[m - k].conjugate()
            even[k] = half * (a + b)
            odd[k] = half * (a - b) * turns[k]


@kernel
def _interleave(out: np.ndarray, halves: np.ndarray, first: int) -> None:
    """Fill `out` (2, n) with samples from `first` on of two signals, of which `halves` (4, M) has the even and the
    odd ones."""
    n, h = out.shape[1], first // 2
    for ear in range(2):
        into, one, two = out[ear], halves[2 * ear, h:], halves[2 * ear + 1, h:]
        if first % 2 == 1:
            one, two = two, halves[2 * ear, h + 1 :]
        for i in range(n // 2):
            into[2 * i], into[2 * i + 1] = one[i], two[i]
        if n % 2 == 1:
            into[n - 1] = one[n // 2]


@kernel
def _add_paths(
    grid: _Grid, colour: np.ndarray, direction: np.ndarray, paths: np.ndarray, tone: np.ndarray
) -> None:
    """Fill the field of a grid with paths (3, k): gain, delay in samples, metres of air that are not in `colour`
    (k or more, f); few, so that terms of second order are below 2e-4 at 8 kHz for 1.5 m. `direction` (k, 3): unit;
    zero: from all around, at the very place. `tone` (9,): scratch."""
    bins = colour.shape[1]
    out, lanes, re, im = grid.field, grid.lanes, grid.path[0], grid.path[1]
    air_re, air_im = grid.air[0], grid.air[1]
    out[:] = 0.0
    for k in range(len(direction)):
        x, y, z = direction[k, 0], direction[k, 1], direction[k, 2]
        harmonics(x, y, z, tone)
        if x == 0.0 and y == 0.0 and z == 0.0:
            tone[1:] = 0.0
        turn, more = -2.0 * math.pi * paths[1, k] / grid.size, np.float32(paths[2, k])
        step_u, step_v = math.cos(turn), math.sin(turn)
        u, v = 1.0, 0.0
        for i in range(_LANES):
            lanes[0, i], lanes[1, i] = u, v
            u, v = u * step_u - v * step_v, u * step_v + v * step_u
        step_u, step_v = u, v
        u, v = 1.0, 0.0
        for start in range(0, bins, _LANES):
            own, a_re, a_im = colour[k, start:], air_re[start:], air_im[start:]
            to_re, to_im, lane_u, lane_v = re[start:], im[start:], lanes[0], lanes[1]
            for f in range(min(_LANES, bins - start)):
                s = np.float32(u * lane_u[f] - v * lane_v[f])
                t = np.float32(u * lane_v[f] + v * lane_u[f])
                a, b = np.float32(1.0) + more * a_re[f], more * a_im[f]
                p, q = a * s - b * t, a * t + b * s
                to_re[f] = own[f].real * p - own[f].imag * q
                to_im[f] = own[f].real * q + own[f].imag * p
            u, v = u * step_u - v * step_v, u * step_v + v * step_u
        for c in range(9):
            part_of = np.float32(tone[c] * paths[0, k])
            if part_of == 0.0:
                continue
            into_re, into_im = out[c, 0], out[c, 1]
            for f in range(bins):
                into_re[f] += part_of * re[f]
            for f in range(bins):
                into_im[f] += part_of * im[f]


@kernel
def _decode(out: np.ndarray, field: np.ndarray, filters: np.ndarray) -> None:
    """Two ears `out` (5 or more, 2, f) of a field (9, 2, f) in the world's axes, through `filters` (2, 9, 2, f) of
    a head's, by harmonics of its heading: 1, cos, sin, cos 2, sin 2 (`_harmonics`). A turned head hears the
    harmonics of degree m, c of cosine and s of sine, as c cos m + s sin m and s cos m - c sin m of the heading."""
    out[:] = 0.0
    for ear in range(2):
        for c in range(9):
            _add_product(out[_HARMONIC[c], ear], filters[ear, c], field[c], 1.0)
            if _PARTNER[c] != c:  # the sine's harmonic has the minus
                sign = 1.0 if _PARTNER[c] < c else -1.0
                _add_product(out[_HARMONIC[c] + 1, ear], filters[ear, c], field[_PARTNER[c]], sign)


@part(forceinline=True)
def _add_product(out: np.ndarray, a: np.ndarray, b: np.ndarray, sign: float) -> None:
    """Add `sign` times the product of two spectra (2, f) to `out` (f,)."""
    s = np.float32(sign)
    for f in range(len(out)):
        re = a[0, f] * b[0, f] - a[1, f] * b[1, f]
        im = a[0, f] * b[1, f] + a[1, f] * b[0, f]
        out[f] += np.complex64(complex(s * re, s * im))
