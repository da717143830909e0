"""Responses below an edge, as users get them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from soundspaces_sim import PairIndexError
from soundspaces_sim.parts import LEAD_S, LowResponse, lead_samples


@dataclass(frozen=True)
class Discretisation:
    """What a lattice could resolve.

    `spacing` m; `step` s; `cells` in all; `velocity_error`: largest difference of the phase velocity between
    directions at the edge, relative; `material`, `misfit`: the material in use whose branch misses the table's
    absorption by most, and by how much.
    """

    spacing: float
    step: float
    cells: int
    velocity_error: float
    material: str
    misfit: float


@dataclass(frozen=True)
class LowResponses:
    """Responses of S sources × L listeners below `edge` Hz, sampled at `rate` Hz.

    `pressure` (S, L, n) and `velocity` (S, L, n, 3) float32: the latter is -rho c u along x, y and z, so a
    plane wave from direction e has velocity = pressure times e: with the pressure, ambisonics of first order.
    The unit is that of rendered responses: direct sound at distance r is a pulse of amplitude 1 / (sqrt(4 pi)
    r), before the band is cut. Sound is emitted at sample `lead` (50 ms): a band with an end rings before its
    beginning. A causal high-pass of second order at 8 Hz takes away the steady pressure that a source of net
    flow leaves in a room; up to 1.03 times the edge nothing else is taken away, from there the band falls to
    the Nyquist frequency. (s, l) and (l, s) have the same pressure up to rounding.
    """

    pressure: np.ndarray
    velocity: np.ndarray
    rate: float
    edge: float
    sources: np.ndarray
    listeners: np.ndarray
    discretisation: Discretisation

    def __repr__(self) -> str:
        s, l, n = self.pressure.shape
        return (
            f"LowResponses: {s} × {l} pairs below {self.edge:g} Hz, {n / self.rate - LEAD_S:.2f} s at "
            f"{self.rate:.1f} Hz; cells of {100.0 * self.discretisation.spacing:.1f} cm"
        )

    @property
    def lead(self) -> int:
        """Samples before the emission."""
        return lead_samples(self.edge)

    def __getitem__(self, pair: tuple[int, int]) -> LowResponse:
        s, l = pair
        if not (0 <= s < self.pressure.shape[0] and 0 <= l < self.pressure.shape[1]):
            n_s, n_l = self.pressure.shape[:2]
            raise PairIndexError(f"pair ({s}, {l}) is not among {n_s} sources × {n_l} listeners")
        signal = np.concatenate([self.pressure[s, l][None], self.velocity[s, l].T])
        return LowResponse(self.edge, signal)

    def transfer(self, s: int, l: int) -> tuple[np.ndarray, np.ndarray]:
        """((k,) Hz, (4, k) complex) transfer functions of a pair: `LowResponse.transfer`."""
        return self[s, l].transfer()
