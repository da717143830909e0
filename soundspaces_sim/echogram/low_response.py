"""Sound below an edge as waves: pressure and velocity at one point, sampled at little more than twice the edge.

Conventions: signals are those of ambisonics of first order. Pressures are those of a source whose free field is
1 / (sqrt(4 pi) r), as of discrete arrivals (1 J emitted per band); velocities are -rho c u along x, y and z, in the
unit of pressure, so that a plane wave from direction e has velocity = pressure times e.

Directive ends and places beside the point take the field for what its pressure and velocity say of the plane waves
that it is made of: their density over directions d is p + 3 v.d, to the first order of the spherical harmonics
about the point. At a distance o pressures are off by (k o)² / 3 at most. Velocities change there with the second
order, which is not known but for its divergence: they are off by k o at most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

CHANNELS = 4  # pressure; velocity along x, y and z
HIGH_PASS = 8.0  # Hz, of a Butterworth filter of second order: a source of steady flow would press air into a room
# Of the edge, up to which responses are whole; from there they fall to the Nyquist frequency.
WHOLE = 1.03
LEAD_S = 0.05  # of responses, before the sound is emitted: a band with an end rings before its beginning
_RATE = 2.3  # of responses, over the edge
_PAD_S = 0.1  # room for what a displacement moves
_NODES = 16  # of directions of the sphere, in z; twice as many about it


def response_rate(edge: float) -> float:
    """Hz, of responses up to `edge`."""
    return _RATE * edge


def lead_samples(edge: float) -> int:
    """Samples of a response before the emission."""
    return int(np.ceil(LEAD_S * response_rate(edge)))


def response_samples(edge: float, duration: float) -> int:
    """Of a response of `duration` s after the emission, with the lead before it."""
    return lead_samples(edge) + int(np.ceil(duration * response_rate(edge)))


def band_gain(frequency: np.ndarray, edge: float) -> np.ndarray:
    """Complex gain of responses: a causal high-pass, and an end above the edge without phase."""
    x = np.asarray(frequency, float) / HIGH_PASS
    high_pass = -(x**2) / (1.0 - x**2 + np.sqrt(2.0) * 1j * x)
    top = 0.5 * response_rate(edge)
    fall = np.clip((frequency - WHOLE * edge) / (top - WHOLE * edge), 0.0, 1.0)
    return np.asarray(high_pass * np.cos(0.5 * np.pi * fall) ** 2)


@dataclass(frozen=True)
class LowResponse:
    """Of one source at one listener below `edge` Hz: `signal` (4, n), pressure and velocity at `rate` Hz, of which
    `lead` is that of emission."""

    edge: float
    signal: np.ndarray

    def __repr__(self) -> str:
        seconds = (self.signal.shape[1] - self.lead) / self.rate
        return f"LowResponse: below {self.edge:g} Hz, {seconds:.2f} s at {self.rate:.1f} Hz"

    @property
    def rate(self) -> float:
        """Hz."""
        return response_rate(self.edge)

    @property
    def lead(self) -> int:
        """Samples before the emission."""
        return lead_samples(self.edge)

    def transfer(self) -> tuple[np.ndarray, np.ndarray]:
        """((k,) Hz, (4, k) complex): transfer functions, pressure first, from 10 Hz to the edge, for a source whose
        free field is exp(-i k r) / (sqrt(4 pi) r): the band's own gain and the lead are divided out."""
        frequency = np.fft.rfftfreq(self.signal.shape[1], 1.0 / self.rate)
        frequency = frequency[(frequency >= 10.0) & (frequency <= self.edge)]
        return frequency, self.at(frequency)

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """(4, k) complex: transfer functions at (k,) Hz, above 0 and up to the edge."""
        time = (np.arange(self.signal.shape[1]) - self.lead) / self.rate
        turn = np.exp(-2j * np.pi * np.outer(time, frequency))
        return np.asarray(self.signal.astype(float) @ turn / band_gain(frequency, self.edge))


@lru_cache(maxsize=2)
def sphere(nodes: int = _NODES) -> tuple[np.ndarray, np.ndarray]:
    """((n, 3), (n,)): directions in which patterns are given, and their shares of the sphere: Gauss-Legendre with
    `nodes` in z, even in azimuth."""
    z, weight = np.polynomial.legendre.leggauss(nodes)
    phi = (np.arange(2 * nodes) + 0.5) * (np.pi / nodes)
    z, phi = (x.ravel() for x in np.meshgrid(z, phi, indexing="ij"))
    r = np.sqrt(1.0 - z**2)
    directions = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
    return directions, np.repeat(weight / (4.0 * nodes), 2 * nodes)


def seen(
    frequency: np.ndarray, offset: np.ndarray, pattern: np.ndarray | None, speed_of_sound: float
) -> np.ndarray:
    """(k, 4, 4) at frequencies (k,), Hz: pressure and velocity that a microphone hears, of those at the point. It
    is `offset` (3,) m beside it; its `pattern` has amplitudes (n,) in the directions of `sphere`.

    The mean over directions d of pattern (1, d) (1, 3 d) exp(i k offset.d).
    """
    directions, share = sphere()
    weight = share if pattern is None else share * pattern
    first = np.concatenate([np.ones((len(directions), 1)), directions], axis=1)
    turn = np.outer(2j * np.pi * frequency / speed_of_sound, directions @ offset)
    parts = np.einsum("n,ni,nj->nij", weight, first, first * [1.0, 3.0, 3.0, 3.0])
    return np.asarray(
        (np.exp(turn) @ parts.reshape(len(directions), -1)).reshape(-1, CHANNELS, CHANNELS)
    )


def heard(
    low: LowResponse, offset: np.ndarray, pattern: np.ndarray | None, speed_of_sound: float
) -> LowResponse:
    """The response of a microphone as in `seen`."""
    n = low.signal.shape[1]
    size = n + int(np.ceil(_PAD_S * low.rate))
    matrix = seen(np.fft.rfftfreq(size, 1.0 / low.rate), offset, pattern, speed_of_sound)
    spectrum = np.einsum("kij,jk->ik", matrix, np.fft.rfft(low.signal.astype(float), size))
    signal = np.fft.irfft(spectrum, size)[:, :n]
    return replace(low, signal=signal.astype(np.float32))


def emitted(
    low: LowResponse, back: LowResponse, offset: np.ndarray, pattern: np.ndarray, speed_of_sound: float
) -> LowResponse:
    """The response to a source with a `pattern`, `offset` as in `seen`; `back`: from the listener to the source.

    Pressures are those that the source would hear as a microphone, since they are reciprocal. Of the velocity at
    the listener the course stays, that of an omnidirectional source, at the level of the pressure.
    """
    pressure = heard(back, offset, pattern, speed_of_sound).signal[0]
    before, after = (float(np.square(x, dtype=float).sum()) for x in (low.signal[0], pressure))
    level = np.sqrt(after / before) if before > 0.0 else 0.0
    signal = np.concatenate([pressure[None], (level * low.signal[1:]).astype(np.float32)])
    return replace(low, signal=signal)
