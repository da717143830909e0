"""From echograms to the responses of listeners: mono, binaural and ambisonic (ACN, N3D, world axes).

Nothing sounds before the shortest path: samples before it are exact zeros, but for the `_LEAD` samples in
which a band-limited pulse rises.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from soundspaces_rlr.propagation import seen_from
from soundspaces_rlr.records import ChannelLayout, ChannelLayoutType, Config
from soundspaces_sim import (
    Echogram,
    SimulationConfig,
    ambisonic_rir,
    binaural_rirs,
)
from soundspaces_sim.parts import (
    LEAST_DISTANCE,
    PLANE_WAVES as WAVES,
    WaveField,
    arrival_filters,
    convert_ambisonics as convert,
    direction_filters,
    harmonics_n3d,
    place_responses as place,
    response_length,
    rotation_matrix,
    spherical_harmonics,
    without_arrivals,
)
from soundspaces_sim.rendering import load_hrtf

_LEAD = 8  # samples in which a pulse rises
_HEAD_LEAD_S = 0.0003  # an ear hears before the middle of its head
_EAR_DELAY_S = 0.0012  # of binaural responses, so that zeros before the onset cut nothing of the filters
#: Ears have the direct sound of a source as 1 / r, microphones as sqrt(1 / 4 pi) / r: as the original, whose ears
#: have 10 dB more at low frequencies and, with the colour of its own HRTF, 9.5 to 14 dB more from 250 Hz up.
_EAR_GAIN = float(np.sqrt(4.0 * np.pi))
_LEAST_OPENING_S = 0.0003  # of the time bin in which sound begins
_TAIL_ORDER = 2  # of the echogram's moments


@dataclass(frozen=True)
class GroupListener:
    """A listener of a group: `offset` (3,) m from the group's place, its layout, and for binaural ones
    `head` (3, 3), whose columns are front, left and up in world axes, and the path of an HRTF."""

    offset: np.ndarray
    layout: ChannelLayout
    head: np.ndarray
    hrtf: str | None


def response_samples(echogram: Echogram, config: Config) -> int:
    """Samples of a response to an echogram."""
    rate = round(config.sample_rate)
    return min(response_length(echogram, rate), round(config.max_ir_length * rate))


def render_group(
    echogram: Echogram,
    listeners: Sequence[GroupListener],
    distance: Sequence[float],
    config: Config,
    seed: int,
) -> list[np.ndarray]:
    """(C, n) float64 response of each listener of a group to one source.

    `distance` (m) is each listener's from the source. Raises `ConfigError` for a rate that cannot be rendered.
    """
    rate = round(config.sample_rate)
    n = response_samples(echogram, config)
    middle = min(range(len(listeners)), key=lambda i: float(np.linalg.norm(listeners[i].offset)))
    late = _from_onset(without_arrivals(echogram), _onset(echogram, distance[middle]))
    out = []
    for ears, metres, tail in zip(
        listeners, distance, _tails(late, listeners, config, n, seed), strict=True
    ):
        own = seen_from(echogram, ears.offset, LEAST_DISTANCE)
        out.append(_response(own, tail, ears, metres, config, rate))
    return out


def _tails(
    late: Echogram, listeners: Sequence[GroupListener], config: Config, n: int, seed: int
) -> list[np.ndarray]:
    """(C, n) reverberation of each listener: one field of plane waves for all, unless there is but one listener,
    whose order the echogram's moments reach."""
    rate, others = round(config.sample_rate), listeners[1:]
    kinds = [(ears.layout.type, _tail_order(ears.layout, config)) for ears in listeners]
    kind, order = kinds[0]
    if not others and kind is not ChannelLayoutType.Mono and order <= _TAIL_ORDER:
        tail = _fit(ambisonic_rir(late, rate, seed), n)
        if kind is ChannelLayoutType.Binaural:
            return [tail]
        return [convert(tail, "n3d")[: (order + 1) ** 2]]
    field = WaveField(late, n, rate, seed, WAVES if others or kind is not ChannelLayoutType.Mono else 1)
    weights = [_weights(kind, order, field.directions) for kind, order in kinds]
    counts = [len(w) for w in weights]
    offsets = np.repeat([ears.offset for ears in listeners], counts, axis=0)
    signals = field.at(offsets, np.concatenate(weights), SimulationConfig().c)
    return np.split(signals, np.cumsum(counts)[:-1])


def _tail_order(layout: ChannelLayout, config: Config) -> int:
    """Order up to which reverberation is wanted in an ambisonic layout; 2 for others."""
    if layout.type is not ChannelLayoutType.Ambisonics:
        return _TAIL_ORDER
    held = int(np.ceil(np.sqrt(layout.channels))) - 1
    return max(0, min(config.indirect_sh_order, held))


def _weights(kind: ChannelLayoutType, order: int, directions: np.ndarray) -> np.ndarray:
    """(C, K) of each wave in each channel of a tail."""
    if kind is ChannelLayoutType.Mono:
        return np.ones((1, len(directions)))
    if kind is ChannelLayoutType.Binaural:
        return spherical_harmonics(directions).T
    return harmonics_n3d(directions, order).T


def _response(
    echogram: Echogram, tail: np.ndarray, ears: GroupListener, distance: float, config: Config, rate: int
) -> np.ndarray:
    """(C, n) float64: arrivals put on a tail, brought to the listener's channels, silent before its onset."""
    kind, n = ears.layout.type, tail.shape[1]
    start = _onset(echogram, distance)
    if kind is ChannelLayoutType.Mono:
        full = np.array(tail[:1], np.float32)
        _add(full, echogram, np.ones((1, 1)), np.ones((len(echogram.early), 1)), rate)
    elif kind is ChannelLayoutType.Binaural:
        full = np.float32(_EAR_GAIN) * _at_ears(echogram, tail, ears, rate)
        start = max(start - _HEAD_LEAD_S, 0.0)
    else:
        full = np.zeros((ears.layout.channels, n), np.float32)
        rows = min(len(full), len(tail))
        full[:rows] = tail[:rows]
        direct_of, early_of = _directions(echogram)
        direct = _cut(harmonics_n3d(direct_of, max(0, config.direct_sh_order)), len(full))
        early = _cut(harmonics_n3d(early_of, max(0, config.indirect_sh_order)), len(full))
        _add(full, echogram, direct, early, rate)
    return config.global_volume * _silence(full.astype(float), start, rate)


def _at_ears(echogram: Echogram, tail: np.ndarray, ears: GroupListener, rate: int) -> np.ndarray:
    """(2, n): reverberation through a decoder of second order, discrete arrivals each through the HRTF of the
    direction nearest to its own; later by `_EAR_DELAY_S`."""
    shift, n = round(_EAR_DELAY_S * rate), tail.shape[1]
    turned = rotation_matrix(ears.head).astype(np.float32) @ tail
    turned = np.pad(turned, ((0, 0), (shift, 0)))[:, :n]
    out: np.ndarray = binaural_rirs(turned, rate, [(0.0, 0.0, 0.0)], ears.hrtf)[0]
    if not echogram.arrivals:
        return out
    responses, starts = _arrival_responses(echogram, rate)
    hrtf = load_hrtf(ears.hrtf)
    filters, delay = direction_filters(rate, ears.hrtf)
    directions = np.array([a.direction for a in echogram.arrivals])
    own = filters[(directions @ ears.head @ hrtf.directions.T).argmax(axis=1)]
    own[~directions.any(axis=1)] = np.tensordot(hrtf.weights, filters, axes=1)  # from all around
    heard = scipy.signal.fftconvolve(responses[:, None], own, axes=2)
    for ear in range(2):
        each = np.ascontiguousarray(heard[:, ear], np.float32)
        place(out[ear : ear + 1], each, starts + shift - delay, np.ones((len(each), 1), np.float32))
    return out


def _arrival_responses(echogram: Echogram, rate: int) -> tuple[np.ndarray, np.ndarray]:
    """`arrival_filters` of the discrete arrivals, the direct sound first."""
    arrivals = echogram.arrivals
    return arrival_filters(
        np.array([a.energy for a in arrivals]),
        np.array([a.delay for a in arrivals]),
        echogram.bands,
        rate,
        echogram.air,
    )


def _directions(echogram: Echogram) -> tuple[np.ndarray, np.ndarray]:
    direct = echogram.direct.direction if echogram.direct else np.zeros(3)
    return direct[None], echogram.early.direction


def _fit(signal: np.ndarray, n: int) -> np.ndarray:
    """A (C, …) signal cut or padded with zeros to n samples."""
    return np.pad(signal[:, :n], ((0, 0), (0, max(n - signal.shape[1], 0))))


def _cut(harmonics: np.ndarray, channels: int) -> np.ndarray:
    """Harmonics for exactly that many channels; those of higher order are silent."""
    out = np.zeros((len(harmonics), channels))
    rows = min(channels, harmonics.shape[1])
    out[:, :rows] = harmonics[:, :rows]
    return out


def _add(out: np.ndarray, echogram: Echogram, direct: np.ndarray, early: np.ndarray, rate: int) -> None:
    """Add the discrete arrivals to (C, n); `direct` (1, C) and `early` (A, C) are their harmonics."""
    if not echogram.arrivals:
        return
    harmonics = np.concatenate([direct, early]) if echogram.direct is not None else early
    responses, starts = _arrival_responses(echogram, rate)
    place(out, responses, starts, np.ascontiguousarray(harmonics, np.float32))


def _onset(echogram: Echogram, distance: float) -> float:
    """When the first sound may arrive, s: after the straight distance at the earliest."""
    straight = distance / SimulationConfig().c
    if echogram.direct is not None or echogram.visible:
        return straight
    begins = [a.delay for a in echogram.early]
    loud = np.flatnonzero(echogram.energy[:, 0].max(axis=1) > 0.0)
    if len(loud):
        begins.append(float(echogram.time_edges[loud[0]]))
    return max(straight, min(begins, default=straight))


def _from_onset(echogram: Echogram, start: float) -> Echogram:
    """The echogram with all energy of its bins after `start` (s), none of it lost.

    Bins are wider than a sample, and detectors have a size: some energy is filed a little before its time.
    """
    edges = echogram.time_edges
    first = int(np.searchsorted(edges[1:], start + _LEAST_OPENING_S))
    if first >= len(edges) - 1:
        return echogram
    energy = echogram.energy.copy()
    energy[first] += energy[:first].sum(axis=0)
    energy[:first] = 0.0
    width = edges[first + 1] - edges[first]
    energy[first] *= width / min(width, edges[first + 1] - start)
    return replace(echogram, energy=energy)


def _silence(signal: np.ndarray, start: float, rate: int) -> np.ndarray:
    """Exact zeros before `start` (s) less the rise of a pulse."""
    first = int(start * rate) - _LEAD + 1
    if first > 0:
        signal[:, :first] = 0.0
    return signal
