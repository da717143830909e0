"""Echograms to pressure on a device, in batches, as tensors (extra ``torch``): what `ambisonics`, `smooth`,
`seed_paper`, `waves`, `microphones` and `binaural` do for one response, with the same noise.

Plans, filters and tables are those of the NumPy renderers, made once and kept on the device. Amplitudes are made in
double precision where a device has it, once for all samples that lie in one time bin; samples are in single
precision. Gradients pass from responses to energies.

Shapes: k responses, B bands, A arrivals, c channels, n samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.fft
import torch
from soundspaces_renderers.smooth import (
    LANES as SMOOTH_LANES,
    continued as continued_decay,
    energies as smooth_energies,
    step_plans,
)
from torch import Tensor

from soundspaces_sim.parts import (
    FILTER_FLOOR,
    SECOND_ORDER_CHANNELS as CHANNELS,
    WAVE_LANES,
    Air,
    Equalisation,
    Method,
    air_left,
    air_spectrum,
    band_noise,
    band_plans,
    decoder_transform,
    gain_above,
    harmonics_sn3d,
    head_matrix,
    hop_and_ring,
    hop_filters,
    kernel,
    left_after,
    log_steps,
    make_scratch,
    modulate_noise as modulate,
    place_responses as place,
    rotation_matrices,
    sinc_table,
    transform_size,
    white_noise,
)

_LEAST_VARIANCE = 1e-6  # as `synthesis`
_MOST = 1e37  # that air takes: beyond it single precision holds no energy
_FRACTION = 36  # binary digits of a delay after the point, s: exact on devices without double precision
SECOND = 2.0**_FRACTION  # of delays
_GAMMA, _MIX_1, _MIX_2 = (
    np.uint64(x) for x in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
)


@kernel
def cut_frames(
    first: int, last: int, frames: np.ndarray, signal: np.ndarray, window: np.ndarray, n: int, ring: int
) -> None:
    """Fill rows `first` to `last` of `frames` (R, k, m) with stretches of the first n samples of `signal` (R, N),
    times `window` (2 hop,), from sample `ring` of a frame on; frame k begins (k - 1) hop samples after the
    signal."""
    length = len(window)
    hop = length // 2
    for row in range(first, last):
        for k in range(frames.shape[1]):
            start = (k - 1) * hop
            begin, end = max(0, -start), min(length, n - start)
            frames[row, k] = 0.0
            if begin >= end:
                continue
            here, there, from_, some = (
                np.uintp(begin),
                np.uintp(ring + begin),
                np.uintp(start + begin),
                np.uintp(end - begin),
            )
            for i in range(some):
                frames[row, k, there + i] = window[here + i] * signal[row, from_ + i]


@kernel
def join_frames(first: int, last: int, out: np.ndarray, frames: np.ndarray, hop: int, ring: int) -> None:
    """Fill rows `first` to `last` of `out` (R, n) with sums of the first 2 hop + 2 ring samples of `frames` (R, k,
    m), placed as `cut_frames` takes them."""
    n, length = out.shape[1], 2 * hop + 2 * ring
    for row in range(first, last):
        out[row] = 0.0
        for k in range(frames.shape[1]):
            start = (k - 1) * hop - ring
            begin, end = max(0, -start), min(length, n - start)
            if begin >= end:
                continue
            here, there, some = np.uintp(begin), np.uintp(start + begin), np.uintp(end - begin)
            for i in range(some):
                out[row, there + i] += frames[row, k, here + i]


class EchogramBatch(NamedTuple):
    """k echograms on a device. Arrivals that fill a row up have no energy."""

    energy: Tensor  # (k, B, 9, bins) float32
    delay: Tensor  # (k, A) int64, s times 2**36
    arrivals: Tensor  # (k, A, B) float32 energies
    direction: Tensor  # (k, A, 3), as precise as the device can


@dataclass(frozen=True)
class Course:
    """What k echograms share, and where their responses are made."""

    bands: tuple[float, ...]
    time_edges: np.ndarray
    air: Air | None
    rate: int
    n: int
    device: torch.device

    def tensor(self, values: np.ndarray) -> Tensor:
        """Values on the device, in single precision if they are real and the device has no other."""
        found = np.ascontiguousarray(values)
        if self.device.type == "mps" and found.dtype == np.float64:
            found = found.astype(np.float32)
        return torch.from_numpy(found.copy()).to(self.device)


def fixed(delay: np.ndarray) -> np.ndarray:
    """Delays in s as `EchogramBatch.delay` holds them."""
    return np.rint(np.asarray(delay, float) * SECOND).astype(np.int64)


def _mixed(x: np.ndarray) -> np.ndarray:
    z = (x ^ (x >> np.uint64(30))) * _MIX_1
    z = (z ^ (z >> np.uint64(27))) * _MIX_2
    return np.asarray(z ^ (z >> np.uint64(31)))


def combined_keys(key: np.ndarray, value: np.ndarray | int) -> np.ndarray:
    """`rng.combine` of arrays of uint64 keys and values."""
    with np.errstate(over="ignore"):
        values = np.asarray(value).astype(np.uint64)
        return _mixed(np.asarray(key, np.uint64) ^ (_mixed(values + _GAMMA) + _GAMMA))


def pair_seeds(seed: int, pairs: np.ndarray) -> np.ndarray:
    """(k,) uint64 `ambisonics.pair_seed` of (k, 2) pairs."""
    sources = combined_keys(np.full(len(pairs), seed % 2**64, np.uint64), pairs[:, 0])
    return combined_keys(sources, pairs[:, 1])


@lru_cache(maxsize=4)
def _noise_table(device: torch.device, more: int) -> Tensor:
    """The table of white noise with its first `more` samples again behind it."""
    table = white_noise()
    return torch.from_numpy(np.concatenate([table, np.resize(table, more)])).to(device)


def _noise(starts: np.ndarray, n: int, device: torch.device) -> Tensor:
    """(…, n) samples of the table from `starts` (…) on."""
    more = 1 << max(n - 1, 1).bit_length()
    rows = _noise_table(device, more).unfold(0, n, 1)
    flat = torch.from_numpy((starts.ravel() % len(white_noise())).astype(np.int64)).to(device)
    return rows.index_select(0, flat).reshape(*starts.shape, n)


# Reverberation


class _Spread(NamedTuple):
    """How bins become samples: U amplitudes, each of energies `share` (U, m) of bins `bin` (U, m); sample t has
    that of `row` (n,)."""

    bin: Tensor
    share: Tensor
    row: Tensor


@lru_cache(maxsize=64)
def _spread(edges: bytes, dt: float, n: int, device: torch.device) -> _Spread:
    """As `synthesis.modulate` spreads bins over samples `dt` s apart. Samples within one bin are alike."""
    time_edges = np.frombuffer(edges)
    bins, middle = len(time_edges) - 1, np.arange(n)
    low, high = np.maximum((middle - 0.5) * dt, time_edges[0]), (middle + 0.5) * dt
    first = np.searchsorted(time_edges[1:], low, "right")
    last = np.maximum(np.searchsorted(time_edges[:-1], high, "left"), first)
    alike = (last - first == 1) & (high <= time_edges[np.minimum(first + 1, bins)]) & (low < high)
    alike[0] = False  # of the first sample only a half lies behind the first edge
    of_bin, own = np.unique(first[alike]), np.flatnonzero(~alike)
    low = np.concatenate([np.zeros(len(of_bin)), low[own]])
    high = np.concatenate([np.full(len(of_bin), dt), high[own]])
    low[: len(of_bin)] = time_edges[of_bin]
    high[: len(of_bin)] += time_edges[of_bin]
    begin, end = np.concatenate([of_bin, first[own]]), np.concatenate([of_bin + 1, last[own]])
    at = begin[:, None] + np.arange(max(int((end - begin).max(initial=1)), 1))
    inside = at < end[:, None]
    at = np.minimum(at, bins - 1)
    width = time_edges[at + 1] - time_edges[at]
    covered = np.minimum(high[:, None], time_edges[at + 1]) - np.maximum(low[:, None], time_edges[at])
    alone = np.arange(len(at)) < len(of_bin)
    share = np.where(inside, np.where(alone[:, None], dt, covered) / width, 0.0)
    row = np.empty(n, np.int64)
    row[alike] = np.searchsorted(of_bin, first[alike])
    row[own] = len(of_bin) + np.arange(len(own))
    kind = np.float32 if device.type == "mps" else np.float64
    return _Spread(*(torch.from_numpy(x).to(device) for x in (at, share.astype(kind), row)))


def _sample_energies(energy: Tensor, course: Course, dt: float, n: int) -> tuple[Tensor, Tensor]:
    """((k, c, U) energies of samples and moments, (n,) which of them each sample has), of energies (k, c, bins)."""
    spread = _spread(np.asarray(course.time_edges, float).tobytes(), dt, n, course.device)
    whole = energy.to(spread.share.dtype)
    parts = [whole.index_select(-1, b) * s for b, s in zip(spread.bin.T, spread.share.T, strict=True)]
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total, spread.row


def _root(x: Tensor) -> Tensor:
    """Square roots, of nothing and less 0, without a gradient there."""
    known = x > 0.0
    return torch.where(known, torch.sqrt(torch.where(known, x, 1.0)), 0.0)


def _over(x: Tensor, y: Tensor, known: Tensor) -> Tensor:
    return torch.where(known, x / torch.where(known, y, 1.0), 0.0)


def _gains(e: Tensor) -> Tensor:
    """(k, 16, U) float32 amplitudes of energies and moments (k, 9, U), see `synthesis._set_gains`: 0 to 8 those of
    the noise that all channels share; 9 to 11 of Y's noise in Y, Z, X; 12 and 13 of Z's in Z, X; 14 of X's; 15 of
    the own noise of each channel of order 2."""
    heard = e[:, :1] > 0.0
    s = _over(e, e[:, :1].expand_as(e), heard.expand_as(e))
    root, root3 = _root(e[:, 0]), math.sqrt(3.0)
    y, z, x = s[:, 1], s[:, 2], s[:, 3]
    zz = (1.0 + 2.0 * s[:, 6]) / 3.0
    xx, yy = 0.5 * (1.0 - zz) + s[:, 8] / root3, 0.5 * (1.0 - zz) - s[:, 8] / root3
    y_own = _root(yy - y * y)
    known = y_own * y_own > _LEAST_VARIANCE
    zy = _over(s[:, 5] / root3 - y * z, y_own, known)
    xy = _over(s[:, 4] / root3 - x * y, y_own, known)
    z_own = _root(zz - z * z - zy * zy)
    xz = _over(s[:, 7] / root3 - x * z - zy * xy, z_own, z_own * z_own > _LEAST_VARIANCE)
    x_own = _root(xx - x * x - xy * xy - xz * xz)
    second = _root((1.0 - (s[:, 4:] * s[:, 4:]).sum(1)) / 5.0)
    rows = torch.stack([y_own, zy, xy, z_own, xz, x_own, second], 1)
    return (torch.cat([s, rows], 1) * root[:, None]).float()


def _modulated(energy: Tensor, course: Course, dt: float, n: int, start: np.ndarray) -> Tensor:
    """(k, 9, n) noise with energies and moments (k, 9, bins) of one band, from `start` (k,) of the table on."""
    if _by_kernels(energy):
        return _modulated_by_kernel(energy, course, dt, n, start)
    e, row = _sample_energies(energy, course, dt, n)
    gain = _gains(e).index_select(-1, row)
    lane = len(white_noise()) // CHANNELS
    noise = _noise(start[:, None] + lane * np.arange(CHANNELS), n, course.device)
    out = gain[:, :9] * noise[:, :1]
    out[:, 1:4] += gain[:, 9:12] * noise[:, 1:2]
    out[:, 2:4] += gain[:, 12:14] * noise[:, 2:3]
    out[:, 3] += gain[:, 14] * noise[:, 3]
    out[:, 4:] += gain[:, 15:] * noise[:, 4:]
    return out


def _by_kernels(given: Tensor) -> bool:
    """Whether kernels may do it, in one thread: on a processor, where nobody asks for gradients."""
    return given.device.type == "cpu" and not (given.requires_grad and torch.is_grad_enabled())


def _modulated_by_kernel(energy: Tensor, course: Course, dt: float, n: int, start: np.ndarray) -> Tensor:
    out = torch.empty(len(energy), CHANNELS, n)
    samples, table = out.numpy(), np.ascontiguousarray(energy.detach().numpy().transpose(0, 2, 1))
    noise = white_noise()
    edges, lane, scratch = np.asarray(course.time_edges, float), len(noise) // CHANNELS, make_scratch()
    for k in range(len(samples)):
        modulate(samples[k], table[k], edges, dt, noise, int(start[k]), lane, scratch)
    return out


class _Place(NamedTuple):
    """A part of the spectrum, made of every `step`-th sample: its bins from `of` on go to `first` to `last`, times
    `gain`."""

    step: int
    of: int
    first: int
    last: int
    gain: Tensor  # twice each, for `_times`


@lru_cache(maxsize=16)
def _places(
    kind: str, bands: tuple[float, ...], rate: int, n: int, device: torch.device
) -> tuple[int, tuple[_Place, ...]]:
    """(samples of the transform, its parts) of the renderer ``default`` or ``smooth``."""

    def on_device(gain: np.ndarray) -> Tensor:
        return torch.from_numpy(np.repeat(gain, 2)).to(device)

    if kind == "smooth":
        size = transform_size(n, rate)
        rows = step_plans(bands, rate, size)
        return size, tuple(_Place(p[2], 0, p[0], p[1], on_device(p[3])) for p in rows)
    size, plans = band_plans(bands, rate, n)
    return size, tuple(_Place(p.step, p.first, p.first, p.last, on_device(p.gain)) for p in plans)


def _times(spectrum: Tensor, gain: Tensor) -> Tensor:
    """A spectrum (…, f) times real gains, each twice in a row (…, 2 f), as real numbers: half the work."""
    return torch.view_as_complex(
        (torch.view_as_real(spectrum).flatten(-2) * gain).unflatten(-1, (-1, 2))
    )


def reverberation(energy: Tensor, course: Course, seeds: np.ndarray, kind: str = "default") -> Tensor:
    """(k, 9, n) of energies without air (k, B, 9, bins), or of the steps of ``smooth``, through the air, without
    discrete arrivals."""
    size, places = _places(kind, course.bands, course.rate, course.n, course.device)
    lanes = combined_keys(seeds, SMOOTH_LANES if kind == "smooth" else 1)
    spectrum = torch.zeros(
        len(energy), CHANNELS, size // 2 + 1, dtype=torch.complex64, device=course.device
    )
    for b, at in enumerate(places):
        start = combined_keys(lanes, b) % np.uint64(len(white_noise()))
        dt, count = at.step / course.rate, size // at.step
        made = torch.fft.rfft(_modulated(energy[:, b], course, dt, count, start.astype(np.int64)))
        bins = made[..., at.of : at.of + at.last - at.first]
        spectrum[..., at.first : at.last] += _times(bins, at.gain)
    return through_air(torch.fft.irfft(spectrum, size), course)


def step_energies(energy: np.ndarray, course: Course) -> np.ndarray:
    """(k, K, 9, bins) energies of the steps of ``smooth``, of energies (k, B, 9, bins) without air."""
    tables = (continued_decay(e.transpose(2, 1, 0), course.time_edges) for e in energy)
    return np.stack([smooth_energies(t, course.bands).transpose(0, 2, 1) for t in tables])


def paper_reverberation(energy: Tensor, course: Course, seeds: np.ndarray) -> Tensor:
    """(k, 9, n) as `seed_paper.paper_rir` makes it, without discrete arrivals."""
    noise = band_noise(course.bands, course.rate)
    e, row = _sample_energies(energy[:, : len(noise)].flatten(0, 1), course, 1.0 / course.rate, course.n)
    e = e.index_select(-1, row).reshape(len(energy), len(noise), CHANNELS, course.n)
    length = noise.shape[1]
    starts = (combined_keys(seeds, 1) % np.uint64(length)).astype(np.int64)
    at = (starts[:, None] + np.arange(course.n)) % length
    heard = course.tensor(noise)[:, torch.from_numpy(at).to(course.device)].transpose(0, 1)
    mono = (_root(e[:, :, 0]) * heard).sum(1)
    total = e.sum(1)
    known = total[:, :1] > 0.0
    shares = _over(total, total[:, :1].expand_as(total), known.expand_as(total))
    return (mono[:, None] * shares).float()


def without_air(energy: Tensor, course: Course) -> Tensor:
    """`air.without_air` of energies (k, B, 9, bins)."""
    if course.air is None:
        return energy
    edges = course.time_edges
    left = air_left(course.air, course.bands, 0.5 * (edges[1:] + edges[:-1])).T
    # divided as there, to the bit: moments of one direction leave rounding errors alone for the other noises
    some = course.tensor(np.where(left > 0.0, np.maximum(left, 1.0 / _MOST), np.inf))[:, None]
    return (energy.to(some.dtype) / some).float()


class _AirTables(NamedTuple):
    """What `air.through_air` has of a response's length and rate."""

    hop: int
    ring: int
    size: int  # samples of a frame's transform
    window: Tensor  # (2 hop,)
    filters: Tensor  # (frames, 2 f), for `_times`


@lru_cache(maxsize=8)
def _air_tables(air: Air, rate: int, n: int, device: torch.device) -> _AirTables:
    hop, ring = hop_and_ring(rate)
    window = np.sin(np.pi * (np.arange(2 * hop) + 0.5) / (2 * hop)) ** 2
    size = int(scipy.fft.next_fast_len(2 * hop + 2 * ring, real=True))
    gains = np.repeat(hop_filters(air, rate, hop, -(-n // hop) + 1, size), 2, axis=1)
    found = (torch.from_numpy(x).to(device) for x in (window.astype(np.float32), gains))
    return _AirTables(hop, ring, size, *found)


def through_air(response: Tensor, course: Course) -> Tensor:
    """(k, c, n) `air.through_air` of the first n samples of responses (k, c, N)."""
    n = course.n
    if course.air is None:
        return response[..., :n]
    tables = _air_tables(course.air, course.rate, n, course.device)
    if _by_kernels(response):
        return _through_air_by_kernels(response.detach().contiguous(), n, tables)
    hop, ring, count = tables.hop, tables.ring, len(tables.filters)
    cut = torch.nn.functional.pad(response[..., :n], (hop, count * hop - n))
    frames = cut.unfold(-1, 2 * hop, hop)
    padded = response.new_zeros(*frames.shape[:-1], tables.size)  # with room for what filters put before
    padded[..., ring : ring + 2 * hop] = frames * tables.window
    made = torch.fft.irfft(_times(torch.fft.rfft(padded), tables.filters), tables.size)
    length = 2 * hop + 2 * ring
    parts = -(-length // hop)
    out = response.new_zeros(*response.shape[:-1], count + parts - 1, hop)
    for p in range(parts):
        some = min(hop, length - p * hop)
        out[..., p : p + count, :some] += made[..., p * hop : p * hop + some]
    return out.flatten(-2)[..., hop + ring : hop + ring + n]


def _through_air_by_kernels(response: Tensor, n: int, tables: _AirTables) -> Tensor:
    """One response after the other, so that its frames stay in the processor's cache."""
    channels, count, size = response.shape[1], len(tables.filters), tables.size
    out = torch.empty(len(response), channels, n)
    frames = torch.empty(channels, count, size)
    spectrum = torch.empty(channels, count, size // 2 + 1, dtype=torch.complex64)
    numbers, window = torch.view_as_real(spectrum).flatten(-2), tables.window.numpy()
    for signal, into in zip(response.numpy(), out.numpy(), strict=True):
        cut_frames(0, channels, frames.numpy(), signal, window, n, tables.ring)
        torch.fft.rfft(frames, out=spectrum)
        numbers *= tables.filters
        torch.fft.irfft(spectrum, size, out=frames)
        join_frames(0, channels, into, frames.numpy(), tables.hop, tables.ring)
    return out


# Discrete arrivals


def harmonics(direction: Tensor, channels: int = CHANNELS) -> Tensor:
    """(…, c) spherical harmonics, ACN and SN3D, of unit vectors (…, 3); of no direction, the first alone."""
    if channels != CHANNELS:
        flat = direction.detach().reshape(-1, 3).double().cpu().numpy()
        found = harmonics_sn3d(flat, math.isqrt(channels) - 1).astype(np.float32)
        return torch.from_numpy(found).to(direction.device).reshape(*direction.shape[:-1], channels)
    x, y, z = direction.unbind(-1)
    root3, some = math.sqrt(3.0), (direction != 0.0).any(-1)
    rows = [
        torch.ones_like(x), y, z, x, root3 * x * y, root3 * y * z, 0.5 * (2.0 * z * z - x * x - y * y),
        root3 * x * z, 0.5 * root3 * (x * x - y * y),
    ]  # fmt: skip
    return torch.stack([rows[0], *(torch.where(some, row, 0.0) for row in rows[1:])], -1)


class _ArrivalTables(NamedTuple):
    """What `filters.arrival_filters` has of bands and rate."""

    steps: Tensor  # (B' - 1, f) complex
    n: int
    sinc: Tensor  # (phases + 1, taps)
    air: Tensor | None  # (f,) complex, logarithm of the spectrum of a metre
    left: Tensor | None  # (metres + 1, B) logarithm of what air leaves
    fade: Tensor


@lru_cache(maxsize=8)
def _arrival_tables(
    bands: tuple[float, ...], rate: int, air: Air | None, metres: int, device: torch.device
) -> _ArrivalTables:
    steps, n = log_steps(bands, rate)
    fade = n // 8
    fall = np.cos(0.5 * np.pi * np.arange(1, fade + 1, dtype=np.float32) / fade) ** 2
    found = [
        steps, sinc_table(bands, rate).astype(np.float32),
        None if air is None else air_spectrum(air, rate, n),
        None if air is None else left_after(air, bands, metres).astype(np.float32),
        np.concatenate([np.ones(n - fade, np.float32), fall]),
    ]  # fmt: skip
    made = [None if x is None else torch.from_numpy(np.array(x)).to(device) for x in found]
    return _ArrivalTables(made[0], n, made[1], made[2], made[3], made[4])  # type: ignore[arg-type]


def arrival_filters(energy: Tensor, delay: Tensor, course: Course) -> tuple[Tensor, Tensor]:
    """((k, A, m) responses, (k, A) sample at which each begins): `filters.arrival_filters` of energies (k, A,
    B)."""
    seconds = delay.to(torch.float32) / SECOND
    metres = 1
    if course.air is not None:
        farthest = float(seconds.max()) * course.air.speed_of_sound if seconds.numel() else 0.0
        metres = 1 << (math.ceil(farthest) + 1).bit_length()
    tables = _arrival_tables(course.bands, course.rate, course.air, metres, course.device)
    if course.air is not None and tables.left is not None:
        length = seconds * course.air.speed_of_sound
        metre = length.floor().long().clamp(max=metres - 1)
        u = (length - metre)[..., None]
        lost = -((1.0 - u) * tables.left[metre] + u * tables.left[metre + 1])
        energy = energy * torch.exp(lost.clamp(max=math.log(_MOST)))
    gains = _root(energy[..., : len(tables.steps) + 1])
    floor = FILTER_FLOOR * gains.amax(-1, keepdim=True).detach()
    level = torch.log(torch.maximum(gains, torch.clamp(floor, min=1e-30)))
    rises = level.diff(dim=-1)
    real = level[..., :1] + rises @ tables.steps.real
    turn = rises @ tables.steps.imag
    if course.air is not None and tables.air is not None:
        real, turn = (
            real + length[..., None] * tables.air.real,
            turn + length[..., None] * tables.air.imag,
        )
    size = torch.exp(real)
    spectrum = torch.complex(size * torch.cos(turn), size * torch.sin(turn))
    position = delay * course.rate
    phases, taps = len(tables.sinc) - 1, tables.sinc.shape[1]
    part = (position & ((1 << _FRACTION) - 1)).to(torch.float32) * (phases / SECOND)
    k = part.long().clamp(max=phases - 1)
    mix = (part - k)[..., None]
    sinc = (1.0 - mix) * tables.sinc[k] + mix * tables.sinc[k + 1]
    response = torch.fft.irfft(torch.fft.rfft(sinc, tables.n) * spectrum, tables.n) * tables.fade
    return response, (position >> _FRACTION) - taps // 2 + 1


def placed(response: Tensor, start: Tensor, gains: Tensor, onto: Tensor) -> Tensor:
    """`onto` (k, c, n), which is used up, and responses (k, A, m), each from sample `start` (k, A) on and times
    `gains` (k, A, c)."""
    n, m = onto.shape[-1], response.shape[-1]
    if response.shape[1] == 0 or n == 0:
        return onto
    if all(_by_kernels(given) for given in (response, gains, onto)):
        out = onto.detach().contiguous()
        arrays = [x.detach().contiguous().numpy() for x in (out, response, start, gains)]
        for of_response in zip(*arrays, strict=True):
            place(*of_response)
        return out
    first, last = int(start.min()), int(start.max()) + m
    at = torch.arange(first, last, device=start.device) - start[..., None]
    inside = (at >= 0) & (at < m)
    each = torch.gather(response, -1, at.clamp(0, m - 1)) * inside
    low, high = max(first, 0), min(last, n)
    if low >= high:
        return onto
    made = gains.transpose(1, 2) @ each[..., low - first : high - first]
    return onto + torch.nn.functional.pad(made, (low, n - high))


def with_arrivals(batch: EchogramBatch, course: Course, onto: Tensor) -> Tensor:
    """Responses `onto` (k, c, n), which are used up, with discrete arrivals."""
    response, start = arrival_filters(batch.arrivals, batch.delay, course)
    gains = harmonics(batch.direction, onto.shape[1]).float() * (
        batch.arrivals.amax(-1, keepdim=True) > 0.0
    )
    return placed(response, start, gains, onto)


# Waves below an edge


def above(signal: Tensor, edge: float, course: Course, of_arrivals: bool) -> Tensor:
    """`low_band.above` of signals (k, c, n)."""
    size, gain = gain_above(signal.shape[-1], course.rate, edge, of_arrivals)
    spectrum = torch.fft.rfft(signal, size) * course.tensor(gain)
    return torch.fft.irfft(spectrum, size)[..., : signal.shape[-1]]


# Plane waves


class WaveShares(NamedTuple):
    """How k fields are made of K plane waves."""

    direction: np.ndarray  # (k, K, 3)
    share: Tensor  # (k, B, bins, K) of the energy of a bin


def plane_waves(
    energy: Tensor,
    course: Course,
    shares: WaveShares,
    seeds: np.ndarray,
    offsets: np.ndarray,
    weights: Callable[[int], np.ndarray],
    speed_of_sound: float,
) -> Tensor:
    """(k, R, n) at R places `offsets` (R, 3) m beside the points: `waves.WaveField.at` of energies (k, B, bins).

    `weights(i)`: (R, K) or (R, b, K) of the waves of response i.
    """

    size, places = _places("default", course.bands, course.rate, course.n, course.device)
    stream = combined_keys(seeds, WAVE_LANES)
    count, receivers = shares.direction.shape[1], len(offsets)
    out = []
    for i in range(len(energy)):
        spectrum = torch.zeros(receivers, size // 2 + 1, dtype=torch.complex64, device=course.device)
        level = weights(i)
        each = level if level.ndim == 3 else level[:, None]
        each = np.broadcast_to(each, (receivers, max(len(places), each.shape[1]), count))
        turns = offsets @ shares.direction[i].T / speed_of_sound * (2.0 * np.pi * course.rate / size)
        for b, at in enumerate(places):
            if at.last <= at.first:
                continue
            whole = energy[i, b][None] * shares.share[i, b].T
            dt, samples = at.step / course.rate, size // at.step
            e, row = _sample_energies(whole[None], course, dt, samples)
            gain = _root(e[0]).float().index_select(-1, row)
            keys = combined_keys(combined_keys(stream[i : i + 1], b), np.arange(count))
            starts = (keys % np.uint64(len(white_noise()))).astype(np.int64)
            made = torch.fft.rfft(gain * _noise(starts, samples, course.device))
            bins = _times(made[:, at.first : at.last], at.gain)
            amplitude = course.tensor(np.ascontiguousarray(each[:, b], np.float32))
            spectrum[:, at.first : at.last] += _gathered(bins, amplitude, turns, at.first, course)
        out.append(torch.fft.irfft(spectrum, size)[..., : course.n])
    return through_air(torch.stack(out), course)


def _gathered(bins: Tensor, amplitude: Tensor, turns: np.ndarray, first: int, course: Course) -> Tensor:
    """(R, f) sums over waves (K, f) of `amplitude` (R, K), turned by `turns` (R, K) rad a bin from bin `first`
    on."""
    if not turns.any():
        return torch.complex(amplitude @ bins.real, amplitude @ bins.imag)
    frequency = np.arange(first, first + bins.shape[1])
    rows = []
    for r, turn in enumerate(turns):  # phases in double precision: thousands of turns
        phase = np.remainder(turn[:, None] * frequency, 2.0 * np.pi).astype(np.float32)
        phasor = torch.from_numpy(phase).to(course.device)
        wave = torch.complex(torch.cos(phasor), torch.sin(phasor)) * bins
        rows.append((amplitude[r][:, None] * wave).sum(0))
    return torch.stack(rows)


# Two ears, and dry sounds


@lru_cache(maxsize=8)
def _decoder(
    n: int,
    rate: int,
    hrtf: object,
    method: Method,
    equalisation: Equalisation,
    device: torch.device,
) -> tuple[int, Tensor, int]:
    size, spectra, delay = decoder_transform(n, rate, hrtf, method, equalisation)  # type: ignore[arg-type]
    return size, torch.from_numpy(spectra.copy()).to(device), delay


def decoded(
    field: Tensor,
    orientations_deg: np.ndarray,
    rate: int,
    hrtf: object = None,
    method: Method = "aligned",
    equalisation: Equalisation = "diffuse-field",
) -> Tensor:
    """(k, 2, n) ears of ambisonic responses (k, 9, n), each with a head (k, 3) of heading, pitch and roll."""
    n = field.shape[-1]
    size, spectra, delay = _decoder(n, rate, hrtf, method, equalisation, field.device)
    turns = rotation_matrices(np.stack([head_matrix(*turn) for turn in orientations_deg]))
    turned = torch.from_numpy(turns.astype(np.float32)).to(field.device) @ field
    spectrum = torch.fft.rfft(turned, size)
    both = torch.stack([(spectrum * ear).sum(1) for ear in spectra], 1)
    return torch.fft.irfft(both, size)[..., delay : delay + n]


def convolved(dry: Tensor, response: Tensor) -> Tensor:
    """(k, c, m + n - 1): dry signals (k, m) or (m,) through responses (k, c, n)."""
    length = dry.shape[-1] + response.shape[-1] - 1
    size = int(scipy.fft.next_fast_len(length, real=True))
    spectrum = torch.fft.rfft(dry, size)[..., None, :] * torch.fft.rfft(response, size)
    return torch.fft.irfft(spectrum, size)[..., :length]


def stacked(responses: Sequence[Tensor]) -> Tensor:
    """(k, c, n) responses (c, any length), padded with zeros."""
    longest = max(r.shape[-1] for r in responses)
    return torch.stack([torch.nn.functional.pad(r, (0, longest - r.shape[-1])) for r in responses])
