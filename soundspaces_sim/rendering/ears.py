"""Whose ears, and through which headphones: what turns a sound field into two signals, as one setting.

A set of head-related transfer functions holds for sources as far away as its loudspeakers were. Nearer than a
metre the head's shadow deepens: there the direct sound is corrected by the responses of a rigid sphere at both
distances (`near_field_gains`), in magnitude, since interaural delays hardly change (Brungart & Rabinowitz
1999). Where the ears sit on the head is in the set itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
import scipy.fft
from scipy.special import eval_legendre, spherical_jn, spherical_yn

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.axes import head_matrix
from soundspaces_sim.echogram.displaced import displaced
from soundspaces_sim.echogram.echogram import Echogram, without_arrivals
from soundspaces_sim.echogram.endpoints import check_offset
from soundspaces_sim.echogram.filters import minimum_phase
from soundspaces_sim.rendering.ambisonics import add_arrivals
from soundspaces_sim.rendering.binaural import binaural_rirs
from soundspaces_sim.rendering.decoder import Equalisation, Method
from soundspaces_sim.rendering.hrtf import load_hrtf
from soundspaces_sim.rendering.low_band import above

HEAD_RADIUS = 0.0875  # m, the mean of Kuhn (1977) that Duda & Martens use
_SPEED = 343.0  # m/s
_LARGE = 1e200
_CLOSE = 1e-7  # of the sum: where it ends
_NEAREST = 1.05  # radii


def sphere_response(frequency: np.ndarray, distance: float, cosine: float) -> np.ndarray:
    """(n,) complex response on a rigid head at frequencies (n,) Hz; the source is `distance` m from its centre.

    `cosine` of the angle between the ear and the source. A source nearer than 1.05 radii counts as there.
    """
    rho = max(distance / HEAD_RADIUS, _NEAREST)
    mu = np.maximum(2.0 * np.pi * np.asarray(frequency, float) * HEAD_RADIUS / _SPEED, 1e-4)
    total = np.zeros(len(mu), complex)
    most = int(np.ceil(mu.max() + np.log(1.0 / _CLOSE) / np.log(rho))) + 8
    for m in range(most):
        # where they overflow, their ratio is that of their static limits
        ratio = -mu / ((m + 1.0) * rho ** (m + 1.0)) + 0j
        with np.errstate(over="ignore", invalid="ignore"):
            top = spherical_jn(m, mu * rho) + 1j * spherical_yn(m, mu * rho)
            bottom = spherical_jn(m, mu, derivative=True) + 1j * spherical_yn(m, mu, derivative=True)
            usable = (np.abs(top) < _LARGE) & (np.abs(bottom) < _LARGE)
        ratio[usable] = top[usable] / bottom[usable]
        total += (2.0 * m + 1.0) * eval_legendre(m, cosine) * ratio
    return np.asarray(-(rho / mu) * np.exp(-1j * mu * rho) * total)


def near_field_gains(
    frequency: np.ndarray, distance: float, reference: float, direction: np.ndarray
) -> np.ndarray:
    """(2, n) magnitudes that a set of HRTFs measured at `reference` m lacks for a source at `distance` m in
    `direction` (3,) of head axes: the sphere's responses at both distances, over each other (distance variation
    functions, Kan, Jin & van Schaik 2009)."""
    out = []
    for ear in (1.0, -1.0):  # left is +Y
        near, far = (
            np.abs(sphere_response(frequency, r, ear * float(direction[1])))
            for r in (distance, reference)
        )
        out.append(near / far)
    return np.array(out)


NEAR_M = 1.0


@dataclass(frozen=True)
class Ears:
    """`hrtf`: path of a SOFA file (SimpleFreeFieldHRIR); None is MIT's KEMAR.

    `equalisation`: ``diffuse-field`` for headphones and loudspeakers that are flat in a diffuse field, as most
    are meant to be; ``none`` keeps the colour of the set, for headphones equalised at the listener's own ears.
    `decoder` as in `decoder.design_decoder`. `offset` (x, y, z) m: the head's centre from the point it is
    simulated for, forward, left and up of its heading. `near_field`: correct sources
    within a metre.
    """

    hrtf: str | Path | None = None
    equalisation: Equalisation = "diffuse-field"
    decoder: Method = "aligned"
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near_field: bool = True

    def __post_init__(self) -> None:
        for what, value, kinds in (
            ("equalisation", self.equalisation, get_args(Equalisation)),
            ("decoder", self.decoder, get_args(Method)),
        ):
            if value not in kinds:
                raise ConfigError(f"{what}: expected {' or '.join(kinds)}, got {value!r}")
        check_offset("offset", self.offset)
        load_hrtf(self.hrtf)  # raises


def as_ears(given: str | Path | Ears | None) -> Ears:
    """`Ears` themselves, or of a SOFA file. Raises `ConfigError`."""
    if isinstance(given, Ears):
        return given
    if given is None or isinstance(given, str | Path):
        return Ears(given, near_field=False)
    raise ConfigError(f"hrtf: expected the path of a SOFA file, Ears or None, got {given!r}")


def ear_rirs(
    echogram: Echogram,
    render: Callable[[Echogram], np.ndarray],
    rate: int,
    orientations_deg: np.ndarray,
    ears: Ears,
    speed_of_sound: float = 343.0,
) -> np.ndarray:
    """(k, 2, n) float32 responses at `rate` Hz for k heads (k, 3) of heading, pitch and roll.

    `render` makes the (9, n) response of an echogram.
    """
    if not any(ears.offset):
        return _at_the_point(echogram, render, rate, orientations_deg, ears, speed_of_sound)
    out = []
    for turn in orientations_deg:
        shift = head_matrix(float(turn[0]), 0.0, 0.0) @ np.asarray(ears.offset, float)
        moved, *_ = displaced(echogram, np.zeros(3), shift, -echogram.early.direction, speed_of_sound)
        out.append(_at_the_point(moved, render, rate, turn[None], ears, speed_of_sound)[0])
    length = max(o.shape[1] for o in out)
    return np.stack([np.pad(o, ((0, 0), (0, length - o.shape[1]))) for o in out])


def _at_the_point(
    echogram: Echogram,
    render: Callable[[Echogram], np.ndarray],
    rate: int,
    turns: np.ndarray,
    ears: Ears,
    speed_of_sound: float,
) -> np.ndarray:
    first = echogram.direct
    distance = first.delay * speed_of_sound if first is not None else np.inf
    if not ears.near_field or first is None or not 0.0 < distance < NEAR_M:
        return _decoded(render(echogram), rate, turns, ears)
    field = render(replace(echogram, direct=None))
    alone = np.zeros_like(field)
    add_arrivals(alone, replace(without_arrivals(echogram), direct=first), rate)
    if echogram.low is not None:  # waves are in the field, the direct sound's as well
        alone = above(alone, echogram.low.edge, rate, arrivals=True)
    out, near = _decoded(field, rate, turns, ears), _decoded(alone, rate, turns, ears)
    reference = load_hrtf(ears.hrtf).distance
    n = field.shape[1]
    size = scipy.fft.next_fast_len(2 * n, real=True)
    size += size % 2
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    coarse = np.geomspace(20.0, 0.5 * rate, 200)
    for k, turn in enumerate(turns):
        own = head_matrix(*turn).T @ first.direction
        for ear, gain in enumerate(near_field_gains(coarse, distance, reference, own)):
            log = np.interp(np.log(np.maximum(frequency, 1e-9)), np.log(coarse), np.log(gain))
            filtered = scipy.fft.rfft(near[k, ear], size) * np.exp(minimum_phase(log))
            out[k, ear] += scipy.fft.irfft(filtered, size)[:n].astype(np.float32)
    return out


def _decoded(field: np.ndarray, rate: int, turns: np.ndarray, ears: Ears) -> np.ndarray:
    return binaural_rirs(
        field, rate, turns, ears.hrtf, decoder=ears.decoder, equalisation=ears.equalisation
    )
