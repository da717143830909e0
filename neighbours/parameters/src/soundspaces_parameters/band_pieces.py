"""Echograms in other bands than those that were simulated: octaves, thirds of octaves.

What is stored of band b is the energy E_b(t) that coefficients averaged over the logarithm of frequency give.
Energies are products of coefficients, so the mean of ln E over a band is known, and how it runs within is not.
It is taken as linear over log frequency in each band, with the monotonized central slope (van Leer 1977) of the
bands' means,

    s_b = sgn(d) min(2 |d-|, 2 |d+|, |d|),  d = (d- + d+) / 2,   0 if d- and d+ differ in sign,

where d- and d+ are the differences per octave to the bands below and above; 0 in the lowest and the highest
band. So means stay, and no value lies beyond those of the neighbours. The edges of both sets of bands divide a
band asked for into pieces; its energy is the mean of theirs, weighted by their widths in Hz, as sound with the
same energy at every frequency has it. A stored band that is asked for, or several, are thereby given as they are.

Air is known at every frequency (ISO 9613-1): it is taken out before and put back after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from soundspaces_sim import ConfigError, Echogram
from soundspaces_sim.parts import air_left, check_edges, log_edges

_SAME = 1.02  # ratio of two edges that are taken for one: 176 Hz and the octave's 177.8 Hz
_FLOOR = 1e-9  # of the strongest band: least energy of which a slope is taken
_NOTHING = 1e-300


@dataclass(frozen=True)
class Pieces:
    """P pieces of K bands asked for, each within one of B stored bands."""

    edges: tuple[float, ...]  # (P + 1,) Hz
    stored: np.ndarray  # (P,) the stored band of each
    target: np.ndarray  # (P,) the band asked for of each
    offset: np.ndarray  # (P,) octaves of its centre above its stored band's
    filled: np.ndarray  # (P,) share of its stored band that it fills, in octaves
    weight: np.ndarray  # (P,) share of the band asked for, in Hz

    def means(self, values: np.ndarray) -> np.ndarray:
        """(…, K) means over the bands asked for of values (…, P) of pieces."""
        first = np.flatnonzero(np.diff(self.target, prepend=-1))  # pieces of a band follow each other
        return np.add.reduceat(values * self.weight, first, axis=-1)


def pieces_of(stored: Sequence[float], edges: Sequence[float]) -> Pieces:
    """Pieces of bands between `edges` (K + 1, Hz) of bands between `stored` (B + 1, Hz).

    An edge asked for within 2 % of a stored one is taken for that. Raises `ConfigError` unless all lie above 0
    Hz and within what is stored.
    """
    return _pieces(tuple(map(float, stored)), check_edges(edges))


@lru_cache(maxsize=64)
def _pieces(stored: tuple[float, ...], edges: tuple[float, ...]) -> Pieces:
    own, asked = np.array(stored), np.array(edges)
    near = np.abs(np.log(np.maximum(own, _NOTHING)[None] / np.maximum(asked, _NOTHING)[:, None]))
    close = near.min(axis=1) <= np.log(_SAME)
    asked = np.where(close, own[near.argmin(axis=1)], asked)
    if not (
        asked[0] > 0.0 and asked[0] >= own[0] and asked[-1] <= own[-1] and (np.diff(asked) > 0.0).all()
    ):
        raise ConfigError(
            f"bands: expected edges above 0 Hz, from {own[0]:g} to {own[-1]:g} Hz, where this was simulated, got "
            f"{asked[0]:g} to {asked[-1]:g} Hz"
        )
    cuts = np.unique(np.concatenate([asked, own[(own > asked[0]) & (own < asked[-1])]]))
    of_stored = np.searchsorted(own, cuts[:-1], "right") - 1
    of_target = np.searchsorted(asked, cuts[:-1], "right") - 1
    logs, low = np.log2(cuts), np.log2(log_edges(list(own)))
    if own[0] == 0.0:  # a band from 0 Hz reaches as far down as is asked for
        low[0] = min(low[0], logs[0])
    centre, width = 0.5 * (low[1:] + low[:-1]), np.diff(low)
    return Pieces(
        tuple(cuts.tolist()),
        of_stored,
        of_target,
        0.5 * (logs[1:] + logs[:-1]) - centre[of_stored],
        np.diff(logs) / width[of_stored],
        np.diff(cuts) / np.diff(asked)[of_target],
    )


def slopes(log_energy: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(…, B) monotonized central slopes, per octave, of values (…, B) of bands with centres (B,) in octaves."""
    out = np.zeros_like(log_energy)
    step = np.diff(log_energy, axis=-1) / np.diff(centre)
    below, above = step[..., :-1], step[..., 1:]
    central = 0.5 * (below + above)
    least = np.minimum(2.0 * np.minimum(np.abs(below), np.abs(above)), np.abs(central))
    out[..., 1:-1] = np.where(below * above > 0.0, np.sign(central) * least, 0.0)
    return out


def without_air(echogram: Echogram) -> Echogram:
    """The echogram, arrivals and all, as if the air took nothing."""
    air, bands = echogram.air, echogram.bands
    if air is None:
        return echogram

    def plain(energy: np.ndarray, travelled: np.ndarray) -> np.ndarray:
        if not len(energy):
            return energy
        left = air_left(air, bands, travelled).reshape(len(energy), *(1,) * (energy.ndim - 2), -1)
        return np.divide(energy, left, out=np.zeros(energy.shape), where=left > _NOTHING)

    times = 0.5 * (echogram.time_edges[1:] + echogram.time_edges[:-1])
    direct, early = echogram.direct, echogram.early
    if direct is not None:
        level = plain(np.asarray(direct.energy)[None], np.array([direct.delay]))[0]
        direct = replace(direct, energy=level)
    early = replace(early, energy=plain(early.energy, early.delay))
    energy = plain(echogram.energy, times).astype(np.float32)
    return replace(echogram, energy=energy, direct=direct, early=early, air=None)


def _through_air(echogram: Echogram, p: Pieces, energy: np.ndarray, travelled: np.ndarray) -> np.ndarray:
    """(n, P) energies of pieces after air."""
    if echogram.air is None or not len(energy):
        return energy
    return np.asarray(energy * air_left(echogram.air, p.edges, travelled))


def in_bands(
    echogram: Echogram,
    edges: Sequence[float],
    *,
    staircase: bool = False,
    plain: Echogram | None = None,
) -> Echogram:
    """The echogram in bands between `edges` (K + 1, Hz); directions are those of the stored bands.

    `staircase`: without slopes within bands. `plain`: what `without_air` gives, if it is known. `relative_error`
    is averaged: bands share their subpaths. Raises `ConfigError` for bands outside those that were simulated.
    """
    if tuple(edges) == tuple(echogram.bands):
        return echogram
    p, plain = pieces_of(echogram.bands, edges), plain or without_air(echogram)
    logs = np.log2(log_edges(echogram.bands))
    centre = 0.5 * (logs[1:] + logs[:-1])

    def split(energy: np.ndarray, travelled: np.ndarray) -> np.ndarray:
        """(n, P) energies of pieces of (n, B), of sound that has travelled for (n,) s."""
        energy = energy.astype(float)
        most = np.maximum(energy.max(axis=1, keepdims=True, initial=0.0), _NOTHING)
        slope = slopes(np.log(np.maximum(energy, _FLOOR * most)), centre)
        rise = 0.0 if staircase else slope[:, p.stored] * p.offset
        return _through_air(echogram, p, energy[:, p.stored] * np.exp(rise), travelled)

    times = 0.5 * (echogram.time_edges[1:] + echogram.time_edges[:-1])
    total = echogram.energy[:, :1]
    ratio = np.divide(echogram.energy, total, out=np.zeros_like(echogram.energy), where=total > 0.0)
    parts = split(plain.energy[:, 0], times)
    energy = p.means(ratio[:, :, p.stored] * parts[:, None]).astype(np.float32)
    direct = plain.direct
    if direct is not None:
        level = p.means(split(np.asarray(direct.energy)[None], np.array([direct.delay])))[0]
        direct = replace(direct, energy=level)
    early = p.means(split(plain.early.energy, plain.early.delay))
    return replace(
        echogram,
        bands=tuple(float(e) for e in edges),
        energy=energy,
        direct=direct,
        early=replace(echogram.early, energy=early),
        relative_error=p.means(echogram.relative_error[:, p.stored]).astype(np.float32),
    )
