"""Walls and layers as passive branches: a mass, a resistance and a stiffness in series.

A table gives absorption at random incidence, two or three values below the first band's edge. A locally
reacting wall of complex impedance zeta = |zeta| exp(i mu) absorbs (Kuttruff, Room Acoustics, 2.5)

    a = (8 cos mu / |zeta|) (1 + cos(2 mu) / sin(mu) / |zeta| * atan(|zeta| sin mu / (1 + |zeta| cos mu))
                             - cos mu / |zeta| * ln(1 + 2 |zeta| cos mu + |zeta|²)).

The table does not tell the phase mu. What is taken is the branch of least reactance: a real impedance for one
value (or equal ones), and of the others only so much mass (absorption that falls with frequency) or stiffness
(that rises) as the values need. `reactance` takes another phase, to see what it does. No such wall absorbs more
than .951; `Branch.misfit` states what is left.

A wall that transmits is a limp mass between the cells on its two sides, of the table's transmission at random
incidence: tau = (4 / m²) ln(1 + m² / 4), m = omega times its mass per area over rho c. A porous layer that
hangs free is a flow resistance 2 zeta on the link (equation T13); both sides stay open.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from soundspaces_sim import MaterialTable
from soundspaces_sim.parts import flow_resistance, surface_impedance as impedance

_LEAST = 1e-6  # absorption and transmission below this are none
_FLOOR = 0.02  # of absorption, against which misfits count
_LEANING = 1e-3  # weight of reactance against misfit


class Branch(NamedTuple):
    """Impedance R + i omega m + k / (i omega) over that of air; R infinite for a rigid wall."""

    resistance: float
    mass: float  # s
    stiffness: float  # 1/s
    misfit: float = 0.0  # largest difference from the table's absorption

    def impedance(self, frequency: np.ndarray) -> np.ndarray:
        """Complex, at frequencies in Hz."""
        omega = 2.0 * np.pi * np.asarray(frequency, float)
        return np.asarray(self.resistance + 1j * omega * self.mass - 1j * self.stiffness / omega)


RIGID = Branch(np.inf, 0.0, 0.0)


class WallBranches(NamedTuple):
    """What the m materials of a table are to waves."""

    wall: tuple[Branch, ...]  # of a wall with air on one side: all that does not come back
    face: tuple[Branch, ...]  # of either face of a wall with air on both: what is absorbed
    mass: np.ndarray  # (m,) s, of limp walls that transmit; inf of those that do not
    resistance: np.ndarray  # (m,) of layers that hang free; NaN of all others


def random_incidence(zeta: np.ndarray) -> np.ndarray:
    """Absorption at random incidence of locally reacting walls of complex impedance `zeta` over that of air."""
    size, mu = np.abs(zeta), np.angle(zeta)
    cos, sin = np.cos(mu), np.sin(mu)
    small = np.abs(sin) < 1e-6
    x, y = 1.0 + size * cos, size * sin
    turn = np.where(small, size / x, np.arctan2(y, x) / np.where(small, 1.0, sin))
    brackets = (
        1.0 + np.cos(2.0 * mu) / size * turn - cos / size * np.log(1.0 + 2.0 * size * cos + size**2)
    )
    return np.asarray(8.0 * cos / size * brackets)


def fit_branch(frequency: np.ndarray, absorption: np.ndarray, reactance: float = 0.0) -> Branch:
    """The branch whose absorption at random incidence is nearest to the table's at some frequencies, Hz.

    `reactance`: Im/Re of the impedance at their geometric middle that is added: negative for stiffness.
    """
    if not absorption.max() >= _LEAST:
        return RIGID
    target = np.asarray(absorption, float)
    middle = 2.0 * np.pi * float(np.exp(np.log(frequency).mean()))
    start = float(impedance(np.array(target.mean())))

    def branch(x: np.ndarray) -> Branch:
        size, tilt = start * np.exp(x[0]), x[1] + reactance
        even = x[2] if len(x) > 2 else 0.0  # mass and stiffness that cancel in the middle
        mass, stiffness = max(tilt, 0.0) + max(even, 0.0), max(-tilt, 0.0) + max(even, 0.0)
        return Branch(size, size * mass / middle, size * stiffness * middle)

    def misfits(x: np.ndarray) -> np.ndarray:
        found = random_incidence(branch(x).impedance(frequency))
        return np.concatenate([(found - target) / np.maximum(target, _FLOOR), _LEANING * x[1:]])

    flat = np.ptp(target) < 1e-9
    starts = (
        [[0.0]] if flat else [[0.0, tilt, *even] for tilt in (-0.5, 0.5) for even in _evens(len(target))]
    )
    shaped = (np.array(x) for x in _shaped(starts, flat))
    fits = [scipy.optimize.least_squares(misfits, x, xtol=1e-12, ftol=1e-12) for x in shaped]
    best = branch(min(fits, key=lambda fit: fit.cost).x)
    error = random_incidence(best.impedance(frequency)) - absorption
    return best._replace(misfit=float(np.abs(error).max()))


def _evens(values: int) -> list[list[float]]:
    return [[]] if values < 3 else [[0.1], [1.0]]


def _shaped(starts: list[list[float]], flat: bool) -> list[list[float]]:
    """A flat spectrum needs size and no tilt: the second unknown stays 0."""
    return [[s[0], 0.0] for s in starts] if flat else starts


def limp_mass(transmission: float, frequency: float) -> float:
    """Mass per area over rho c, s, of a limp wall of this transmission at random incidence at a frequency in
    Hz."""
    if not transmission >= _LEAST:
        return np.inf

    def over(log_m: float) -> float:
        quarter = np.exp(2.0 * log_m) / 4.0
        return float(np.log1p(quarter) / quarter - transmission)

    if over(np.log(1e-3)) <= 0.0:
        return 0.0
    return float(
        np.exp(scipy.optimize.brentq(over, np.log(1e-3), np.log(1e5))) / (2.0 * np.pi * frequency)
    )


def wall_branches(table: MaterialTable, edge: float, reactance: float = 0.0) -> WallBranches:
    """The materials of a table as waves below `edge`, Hz, meet them: by its values at frequencies below the edge
    (by its first one, if there is none)."""
    below = table.frequency_hz < edge
    below[0] = True
    frequency = np.minimum(
        table.frequency_hz[below], edge / np.sqrt(2.0)
    )  # a table goes on flat below its first
    highest = int(np.flatnonzero(below)[-1])
    absorbed, passed = table.absorption[:, below], table.transmission[:, below]
    free = table.free_hanging
    kept = np.minimum(absorbed + passed, 1.0)
    layer = 2.0 * flow_resistance(absorbed.mean(axis=1))
    return WallBranches(
        tuple(fit_branch(frequency, a, reactance) for a in kept),
        tuple(fit_branch(frequency, a, reactance) for a in absorbed),
        np.array([limp_mass(t, float(frequency[-1])) for t in table.transmission[:, highest]]),
        np.where(free, layer, np.nan),
    )
