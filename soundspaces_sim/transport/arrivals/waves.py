"""What arrives at a pair, wave by wave, and how what is diffracted joins what it arrives together with.

Every wave i of a pair has a pressure P_i(k) at the wave numbers of all bands, without the phase of its own length
l_i; the pair's pressure is sum_i P_i e^(-jk l_i). An arrival of an echogram has an energy and no phase, and is
heard at its delay. So a diffracted wave that arrives within a band's coherence length of a stronger one is added
to it as a pressure (T36): that keeps the sum at every wave number, and with it the level.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.arrivals.field import Spectrum

_COHERENT = (
    math.pi
)  # phase of a difference of lengths up to which two waves are one; from twice that on, two
_GEOMETRICAL = 0.25  # of a diffracted wave's energy that a geometrical one has at least that it joins
_NEAR = 0.01  # square of a phase: what is nearer is together
_MOST = 16.0  # times the free field: one wall doubles a pressure, a corner of two doubles it twice
_TINY = 1e-12  # m²
_LEAST = 1e-3  # of a pair's energy in a band: a diffracted wave with less in every band is left out


class Waves(NamedTuple):
    """Room for W waves of the pair at hand, the direct sound first; `number` (1,) of them, beyond W not stored."""

    number: np.ndarray
    length: np.ndarray  # (W,) m
    field: np.ndarray  # (W, b, g) complex, 1/m
    at_p: np.ndarray  # (W, 3) unit
    at_q: np.ndarray  # (W, 3)
    planes: np.ndarray  # (W, 2)
    kind: np.ndarray  # (W,)
    wedges: np.ndarray  # (W, 2)
    groups: np.ndarray  # (W, 3)
    moves: np.ndarray  # (W,) whether it is diffracted
    joined: np.ndarray  # (W, b, g) complex, what it has with all that joins it
    energy: np.ndarray  # (W, b) of its own, times 4 pi
    share: np.ndarray  # (W,)
    order: np.ndarray  # (W,)
    nearby: np.ndarray  # (W,) by length


def make_waves(room: int, spectrum: Spectrum) -> Waves:
    """Empty."""
    shape = room, *spectrum.k.shape
    return Waves(
        number=np.zeros(1, np.int64),
        length=np.empty(room),
        field=np.empty(shape, np.complex128),
        at_p=np.empty((room, 3)),
        at_q=np.empty((room, 3)),
        planes=np.empty((room, 2), np.int64),
        kind=np.empty(room, np.int64),
        wedges=np.empty((room, 2), np.int64),
        groups=np.empty((room, 3), np.int64),
        moves=np.empty(room, np.bool_),
        joined=np.empty(shape, np.complex128),
        energy=np.empty(shape[:2]),
        share=np.empty(room),
        order=np.empty(room, np.int64),
        nearby=np.empty(room, np.int64),
    )


class Path(NamedTuple):
    """Which way a wave comes, from the pair's first end p to q."""

    length: float
    at_p: Vec3
    at_q: Vec3
    planes: tuple[int, int]
    kind: int
    wedges: tuple[int, int]
    groups: tuple[int, int, int]


@part
def add_wave(waves: Waves, path: Path, field: np.ndarray, energy: np.ndarray, moves: bool) -> None:
    """Add a wave: `field` (b, g) times the root of what reflects it, `energy` (b,)."""
    i = waves.number[0]
    waves.number[0] = i + 1
    if i >= len(waves.length):
        return
    waves.length[i], waves.kind[i], waves.moves[i] = path.length, path.kind, moves
    for axis in range(3):
        waves.at_p[i, axis], waves.at_q[i, axis] = path.at_p[axis], path.at_q[axis]
        waves.groups[i, axis] = path.groups[axis]
    for n in range(2):
        waves.planes[i, n], waves.wedges[i, n] = path.planes[n], path.wedges[n]
    for b in range(field.shape[0]):
        size = math.sqrt(energy[b])
        for g in range(field.shape[1]):
            waves.field[i, b, g] = size * field[b, g]


@part
def _mean_squares(field: np.ndarray, count: int, weight: np.ndarray, energy: np.ndarray) -> None:
    for i in range(count):
        for b in range(energy.shape[1]):
            total = 0.0
            for g in range(len(weight)):
                p = field[i, b, g]
                total += weight[g] * (p.real * p.real + p.imag * p.imag)
            energy[i, b] = total


@part
def _to_common_phase(waves: Waves, spectrum: Spectrum) -> None:
    """Let every field have the phase of its path, but for that of the direct sound's; `joined` is the same."""
    for i in range(waves.number[0]):
        for b in range(waves.field.shape[1]):
            for g in range(waves.field.shape[2]):
                turn = spectrum.k[b, g] * (waves.length[i] - waves.length[0])
                waves.field[i, b, g] *= complex(math.cos(turn), -math.sin(turn))
                waves.joined[i, b, g] = waves.field[i, b, g]


@part(forceinline=True)
def _is_before(waves: Waves, i: int, j: int, b: int) -> bool:
    """Whether wave i joins others before j does: what is diffracted first, the weaker before."""
    if waves.moves[i] != waves.moves[j]:
        return waves.moves[i]
    return waves.energy[i, b] < waves.energy[j, b]


@part
def _sort_by_length(waves: Waves) -> None:
    """Into `nearby`."""
    nearby, length = waves.nearby, waves.length
    for i in range(waves.number[0]):
        n = i
        while n > 0 and length[nearby[n - 1]] > length[i]:
            nearby[n] = nearby[n - 1]
            n -= 1
        nearby[n] = i


@part
def _sort_by_energy(waves: Waves, b: int) -> None:
    """All but the direct sound, into `order`, in which they are as they were of another band."""
    order = waves.order
    for n in range(1, waves.number[0] - 1):
        i = order[n]
        m = n
        while m > 0 and _is_before(waves, i, order[m - 1], b):
            order[m] = order[m - 1]
            m -= 1
        order[m] = i


@part
def _changed(waves: Waves, i: int, b: int) -> float:
    """Whether what has joined a wave has changed it: 0 up to half of its pressure, as at its boundary, 1 from
    nearly all of it on."""
    change, whole = 0.0, 0.0
    for g in range(waves.field.shape[2]):
        p, d = waves.field[i, b, g], waves.joined[i, b, g] - waves.field[i, b, g]
        whole += p.real * p.real + p.imag * p.imag
        change += d.real * d.real + d.imag * d.imag
    return smooth(2.0 * change / whole - 0.5)


@part(forceinline=True)
def smooth(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


@part(forceinline=True)
def _share_to(waves: Waves, i: int, j: int, b: int, phase: float) -> float:
    """w_ij of `join`, at a phase between both."""
    if j == i or (waves.moves[j] and not waves.moves[i]):
        return 0.0
    firm = j == 0 or (waves.moves[i] and not waves.moves[j])
    least = _GEOMETRICAL * waves.energy[i, b] if firm else waves.energy[i, b]
    if waves.energy[j, b] <= least:
        return 0.0
    return smooth(waves.energy[j, b] / least - 1.0) * smooth(2.0 - phase / _COHERENT)


@part
def join(waves: Waves, spectrum: Spectrum) -> None:
    """Let diffracted waves join stronger ones: into `joined`. The weakest is first, and takes along what joined it.

    Wave i goes to j by w_ij = c(k |l_i - l_j|) s(E_j / E_i): c is 1 up to a phase of pi, 0 from 2 pi on, at
    the band's centre; s is 0 of equal energies and 1 from twice the energy on, and of a geometrical wave j 1 from
    half the energy on. In all 1 - prod_j (1 - w_ij) of it goes, to each in proportion to w_ij² E_j over the
    square of the phase.
    """
    count, joined, share, nearby = waves.number[0], waves.joined, waves.share, waves.nearby
    _mean_squares(waves.field, count, spectrum.weight, waves.energy)
    _to_common_phase(waves, spectrum)
    _sort_by_length(waves)
    for i in range(1, count):
        waves.order[i - 1] = i
    for b in range(joined.shape[1]):
        _sort_by_energy(waves, b)
        far = 2.0 * _COHERENT / spectrum.centre[b]
        for n in range(count - 1):
            i = waves.order[n]
            stays, total = 1.0, 0.0
            if waves.energy[i, b] <= 0.0:
                continue
            goes = 1.0 if waves.moves[i] else _changed(waves, i, b)
            if goes <= 0.0:
                continue
            length = waves.length[i]
            first = last = _first_from(waves, length - far)
            while last < count and waves.length[nearby[last]] < length + far:
                j = nearby[last]
                phase = spectrum.centre[b] * abs(waves.length[j] - length)
                w = goes * _share_to(waves, i, j, b, phase)
                stays *= 1.0 - w
                share[last] = w * w * waves.energy[j, b] / (_NEAR + phase * phase)
                total += share[last]
                last += 1
            if total <= 0.0:
                continue
            for m in range(first, last):
                if share[m] <= 0.0:
                    continue
                part_of = (1.0 - stays) * share[m] / total
                for g in range(joined.shape[2]):
                    joined[nearby[m], b, g] += part_of * joined[i, b, g]
            for g in range(joined.shape[2]):
                joined[i, b, g] *= stays
    _mean_squares(joined, count, spectrum.weight, waves.energy)


@part(forceinline=True)
def _first_from(waves: Waves, length: float) -> int:
    """Row of `nearby` of the first wave that is longer."""
    low, high = 0, waves.number[0]
    while low < high:
        middle = (low + high) // 2
        if waves.length[waves.nearby[middle]] > length:
            high = middle
        else:
            low = middle + 1
    return low


@part
def fade(waves: Waves, energy: np.ndarray) -> None:
    """Let what is diffracted fade, between 25 and 30 dB below the pair's energy in every band, and nothing be
    louder than in a corner; `energy` (b,) is worked in."""
    count = waves.number[0]
    energy[:] = 0.0
    for i in range(count):
        most = _MOST / max(waves.length[i] * waves.length[i], _TINY)
        for b in range(len(energy)):
            waves.energy[i, b] = min(waves.energy[i, b], most)
            energy[b] += waves.energy[i, b]
    for i in range(count):
        if not waves.moves[i]:
            continue
        most = 0.0
        for b in range(len(energy)):
            if energy[b] > 0.0:
                most = max(most, waves.energy[i, b] / energy[b])
        left = smooth((most / _LEAST - 1.0) / 2.0)
        for b in range(len(energy)):
            waves.energy[i, b] *= left


@part(forceinline=True)
def energy_of(waves: Waves, i: int, b: int) -> float:
    """J/m² for 1 J, without air."""
    return INV_4PI * waves.energy[i, b]
