"""What two ears hear during a step, of sources that go on sounding, from spectra that are kept.

Conventions: block j of `block` samples is heard during step j, at the pose reached by it. Partitioned convolution
by overlap and save: a response is cut into partitions of one block, whose spectra multiply those of the source's
windows; windows reach `fade` samples beyond their block, so a pose's sound goes on into the next block, and the two
poses' sounds are cross-faded there, linearly in amplitude. An agent thus moves in the first `fade` samples of a
step and rests for the others; no sample jumps.

Reverberation of a pair is kept as binaural spectra for five headings 72 degrees apart. Order-2 ambisonics have no
harmonic above the second in the heading, so that any other heading is their trigonometric interpolation, exactly.
Several points add with the roots of their shares: their noises are independent, so their powers add as shares.
Of discrete paths the colour is kept; level, delay and direction follow the place. What both ears hear of them there
is kept by harmonics of the heading, for an agent that turns.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import scipy.fft

from soundspaces_continuous.signals import SourceSignal
from soundspaces_continuous.sound_field import Place, SoundField
from soundspaces_sim import ConfigError, Echogram, binaural_rirs
from soundspaces_sim.parts import (
    BlockCache,
    air_spectrum,
    arrival_filters,
    decoder_filters,
    kernel,
    kernel_part as part,
    spherical_harmonics,
    without_arrivals,
)

HEADINGS = 5  # of kept reverberation, and harmonics of the heading: 2 N + 1 for order N = 2
#: Of each ambisonic channel: where its cosine goes among the harmonics of the heading; the channel of the same
#: degree and order with sine for cosine.
_HARMONIC, _PARTNER = np.array([0, 1, 0, 1, 3, 1, 0, 1, 3]), np.array([0, 3, 2, 1, 8, 7, 6, 5, 4])
_MOST_PLACES = 32  # whose discrete paths are kept
_LEGS = 3  # straight stretches of a discrete path, at most

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


class _Pair(NamedTuple):
    late: np.ndarray  # (partitions, 5, 2, 2 F) float32, real and imaginary in turn
    colour: (
        np.ndarray
    )  # (paths, 2, f) float32 spectra of its paths, arriving at 0 s, real and imaginary apart
    ahead: np.ndarray  # (), samples by which a colour begins before its path arrives


def heading_weights(heading: float) -> np.ndarray:
    """(5,) shares of headings 0, 72, … degrees in a function of the heading (rad) without harmonics above the
    second:
    Dirichlet's kernel."""
    x = heading - np.arange(HEADINGS) * (2.0 * np.pi / HEADINGS)
    return np.asarray((1.0 + 2.0 * np.cos(x) + 2.0 * np.cos(2.0 * x)) / HEADINGS)


def _harmonics(heading: float) -> np.ndarray:
    """(5,) float32: 1, and cosine and sine of the heading (rad) and of twice the heading."""
    x = heading * np.array([0.0, 1.0, 1.0, 2.0, 2.0])
    return np.where([True, True, False, True, False], np.cos(x), np.sin(x)).astype(np.float32)


def _tones(directions: np.ndarray) -> np.ndarray:
    """(k, 9) float32 harmonics of directions (k, 3)."""
    tone = spherical_harmonics(directions).astype(np.float32)
    tone[~directions.any(axis=1)] = np.eye(9)[0]  # at the very place: from all around
    return tone


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
        self.size = int(scipy.fft.next_fast_len(self.window, real=True))
        filters, self._lead = decoder_filters(self.rate, self._hrtf, "aligned", "diffuse-field")
        longest = _LEGS * field.scene.diagonal / field.c
        probe = arrival_filters(np.ones((1, len(ds.manifest.config.simulation.bands) - 1)), np.zeros(1),
                                ds.manifest.config.simulation.bands, self.rate)  # fmt: skip
        taps = filters.shape[2] + probe[0].shape[1]
        self._early_size = int(scipy.fft.next_fast_len(math.ceil(longest * self.rate) + taps, real=True))
        self._early_parts = -(-(self._early_size - self._lead) // block)
        ears = scipy.fft.rfft(filters.astype(np.float32), self._early_size)
        self._filters = np.ascontiguousarray(np.stack([ears.real, ears.imag], axis=2), np.float32)
        bins = self._early_size // 2 + 1
        self._sum, self._path = np.zeros((9, 2, bins), np.float32), np.zeros((2, bins), np.float32)
        self._both = np.empty((HEADINGS, 2, bins), np.complex64)
        self._kept: LastUsed[tuple[bytes, bytes], np.ndarray] = LastUsed(_MOST_PLACES)
        self._air = self._air_of_a_metre()
        self._rise = ((np.arange(fade) + 0.5) / fade).astype(np.float32)
        self._key = (id(field), block, fade)

    def _air_of_a_metre(self) -> np.ndarray:
        """(2, f) float32: logarithm of what a metre of air does, real and imaginary; zeros where echograms do not
        tell its course within bands."""
        air = self.field.ds.manifest.config.simulation.air
        if air is None:
            return np.zeros((2, self._early_size // 2 + 1), np.float32)
        log = air_spectrum(air, self.rate, self._early_size)
        return np.ascontiguousarray(np.stack([log.real, log.imag]), np.float32)

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
        bins = self.size // 2 + 1
        total = np.zeros((2, bins), np.complex64)
        heard = False
        for source in sounding:
            response = self._response(source.place, listener, heading)
            spectra = [source.signal.spectrum(step - p, self) for p in range(len(response))]
            for partition, spectrum in zip(response, spectra, strict=True):
                if spectrum is not None:
                    _multiply(total, spectrum, partition)
                    heard = True
        out = np.zeros((2, self.block), np.float32)
        if heard:
            whole = scipy.fft.irfft(total, self.size, overwrite_x=True)
            out[:] = whole[:, self.block : 2 * self.block]
            after = whole[:, 2 * self.block : self.window]
        else:
            after = np.zeros((2, self.fade), np.float32)
        if tail is not None:
            out[:, : self.fade] = tail + (out[:, : self.fade] - tail) * self._rise
        return out, np.ascontiguousarray(after)

    def _response(self, source: Place, listener: Place, heading: float) -> np.ndarray:
        """(partitions, 2, F) complex64 spectra of the response between two places."""
        turn = heading_weights(heading)
        key = source.position.tobytes(), listener.position.tobytes()
        early = self._kept.get(key, lambda: self._early(source, listener))
        first = self._pair(source.points[0], listener.points[0])
        parts = max(len(first.late), len(early))
        out = np.zeros((parts, 2, 2 * (self.size // 2 + 1)), np.float32)
        _accumulate(out, early, _harmonics(heading))
        for s, of_s in zip(source.points, source.shares, strict=True):
            for l, of_l in zip(listener.points, listener.shares, strict=True):
                weights = (math.sqrt(of_s * of_l) * turn).astype(np.float32)
                _accumulate(out, self._pair(s, l).late, weights)
        return out.view(np.complex64)

    def _early(self, source: Place, listener: Place) -> np.ndarray:
        """(partitions, 5, 2, 2 F) float32 spectra of the discrete paths at both ears, by harmonics of the
        heading."""
        field = self._sum
        field[:] = 0.0
        if self.field.paths == "simulated":
            found = self.field.simulated.arriving(source.position, listener.position)
            echogram, _ = self.field.pair(source.points[0], listener.points[0])
            colour, ahead = self._colours(found.energy, found.length, echogram)
            rows, tone = np.arange(len(colour)), _tones(found.direction)
            turns, further = self._turns(found.length, ahead), np.zeros(len(rows))
            _add_paths(field, colour, rows, tone, turns, (self._air, further), self._path)
        else:
            for heard in self.field.heard(source, listener):
                pair, tone = self._pair(*heard.pair), _tones(heard.direction)
                tone *= heard.gain[:, None]
                turns = self._turns(heard.length, float(pair.ahead))
                air = self._air, heard.further
                _add_paths(field, pair.colour, heard.rows, tone, turns, air, self._path)
        _decode(self._both, field, self._filters)
        response = scipy.fft.irfft(self._both, self._early_size)[:, :, self._lead :]
        return self._in_parts(response, self._early_parts)

    def _in_parts(self, responses: np.ndarray, count: int) -> np.ndarray:
        """(count, n, 2, 2 F) float32 spectra of the partitions of responses (n, 2, samples), real and imaginary in
        turn."""
        parts = np.zeros((count, *responses.shape[:2], self.block), np.float32)
        for p, partition in enumerate(parts):
            piece = responses[:, :, p * self.block : (p + 1) * self.block]
            partition[:, :, : piece.shape[2]] = piece
        return np.asarray(scipy.fft.rfft(parts, self.size)).view(np.float32)

    def _turns(self, length: np.ndarray, ahead: float) -> np.ndarray:
        """(k,) rad per bin, of paths of `length` (k,) m whose colours begin `ahead` samples before them."""
        delay = length * (self.rate / self.field.c) + ahead
        return np.asarray(delay * (-2.0 * np.pi / self._early_size))

    def _colours(
        self, energy: np.ndarray, length: np.ndarray, echogram: Echogram
    ) -> tuple[np.ndarray, float]:
        """((k, 2, f) float32 spectra of paths of `energy` (k, b) and `length` (k,) m that arrive at 0 s, real and
        imaginary apart; samples by which they begin before). Bands and air are those of `echogram`."""
        # Half a sample late, where the windowed sinc rolls off before Nyquist's frequency: shifts ring no more.
        at, delay = np.full(len(length), 0.5 / self.rate), length / self.field.c
        responses, starts = arrival_filters(energy, at, echogram.bands, self.rate, echogram.air, delay)
        spectra = scipy.fft.rfft(responses.astype(np.float32), self._early_size)
        colour = np.stack([spectra.real, spectra.imag], axis=1)
        ahead = float(starts[0]) - 0.5 if len(starts) else 0.0
        return np.ascontiguousarray(colour, np.float32), ahead

    def _pair(self, s: int, l: int) -> _Pair:
        key = (*self._key, s, l)
        found = self.memory.get(key, lambda: self._make(s, l)._asdict())
        return _Pair(found["late"], found["colour"], found["ahead"])

    def _make(self, s: int, l: int) -> _Pair:
        ds = self.field.ds
        echogram, paths = self.field.pair(s, l)
        field = ds.rendered(without_arrivals(echogram), s, l)
        turns = [(360.0 / HEADINGS * k, 0.0, 0.0) for k in range(HEADINGS)]
        ears = binaural_rirs(field, self.rate, turns, self._hrtf)
        late = self._in_parts(ears, -(-ears.shape[2] // self.block))
        colour, ahead = self._colours(paths.energy, paths.length, echogram)
        return _Pair(late, colour, np.asarray(ahead))


@kernel
def _accumulate(out: np.ndarray, late: np.ndarray, weights: np.ndarray) -> None:
    """Add `late` (P, 5, 2, 2 F) to `out` (P or more, 2, 2 F), `weights` (5,) of its headings or harmonics."""
    a, b, c, d, e = weights
    for p in range(late.shape[0]):
        for ear in range(2):
            into = out[p, ear]
            h0, h1, h2 = late[p, 0, ear], late[p, 1, ear], late[p, 2, ear]
            h3, h4 = late[p, 3, ear], late[p, 4, ear]
            for f in range(len(into)):
                into[f] += a * h0[f] + b * h1[f] + c * h2[f] + d * h3[f] + e * h4[f]


@kernel
def _multiply(out: np.ndarray, spectrum: np.ndarray, part: np.ndarray) -> None:
    """Add `spectrum` (F,) times `part` (2, F) to `out` (2, F)."""
    for ear in range(2):
        into, of_ear = out[ear], part[ear]
        for f in range(len(spectrum)):
            into[f] += spectrum[f] * of_ear[f]


@kernel
def _add_paths(
    out: np.ndarray,
    colour: np.ndarray,
    rows: np.ndarray,
    tone: np.ndarray,
    turns: np.ndarray,
    air: tuple[np.ndarray, np.ndarray],
    work: np.ndarray,
) -> None:
    """Add paths to the spectra `out` (9, 2, f) of a field: colours of `rows` (k,) of `colour` (n, 2, f), turned by
    `turns` (k,) rad per bin, times `tone` (k, 9). `air`: logarithm (2, f) of what a metre of it does, and how many
    metres (k,) of it there are more than in the colours; few, so that terms of second order are below 2e-4 at 8 kHz
    for 1.5 m. `work` (2, f): scratch."""
    bins = out.shape[2]
    for k in range(len(rows)):
        u, v = 1.0, 0.0
        step_u, step_v = math.cos(turns[k]), math.sin(turns[k])
        own_re, own_im = colour[rows[k], 0], colour[rows[k], 1]
        re, im = work[0], work[1]
        more, air_re, air_im = np.float32(air[1][k]), air[0][0], air[0][1]
        for f in range(bins):
            a, b = np.float32(1.0) + more * air_re[f], more * air_im[f]
            s, t = np.float32(u), np.float32(v)
            p, q = a * s - b * t, a * t + b * s
            re[f] = own_re[f] * p - own_im[f] * q
            im[f] = own_re[f] * q + own_im[f] * p
            u, v = u * step_u - v * step_v, u * step_v + v * step_u
        for c in range(9):
            y = tone[k, c]
            if y == 0.0:
                continue
            into_re, into_im = out[c, 0], out[c, 1]
            for f in range(bins):
                into_re[f] += y * re[f]
            for f in range(bins):
                into_im[f] += y * im[f]


@kernel
def _decode(out: np.ndarray, field: np.ndarray, filters: np.ndarray) -> None:
    """Two ears `out` (5, 2, f) of a field (9, 2, f) in the world's axes, through `filters` (2, 9, 2, f) of a
    head's, by harmonics of its heading: 1, cos, sin, cos 2, sin 2 (`_harmonics`). A turned head hears the harmonics
    of degree m, c of cosine and s of sine, as c cos m + s sin m and s cos m - c sin m of the heading."""
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
