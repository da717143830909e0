"""Reflection by angle: locally reacting walls of real impedance, and thin porous layers that hang free.

Tables give absorption at random incidence. With c the cosine of the angle of incidence:

A wall that reacts locally, of real impedance zeta over that of air, absorbs 4 zeta c / (1 + zeta c)²; at random
incidence (Paris 1928; Kuttruff, Room Acoustics, 2.5)

    a = (8 / zeta²) (1 + zeta - 1 / (1 + zeta) - 2 ln(1 + zeta)),

which is .951 at most, at zeta = 1.567; stiffer walls are the branch above. `a` is all that does not come back:
absorption and transmission share it alike at every angle.

A porous layer that hangs free, of flow resistance 2 zeta, absorbs 2 zeta c / (1 + zeta c)², transmits
1 / (1 + zeta c)² and reflects (zeta c)² / (1 + zeta c)²: at grazing incidence all goes through. Its branch is the
one below 1.567.

Means over random incidence (weight 2 c) are those of the table, always. Where a table exceeds the largest
absorption of a law, the rest shrinks alike at all angles; where a layer's table transmits less (more) than the law,
transmission (reflection) shrinks so, and reflection (transmission) takes the rest.

Every factor is (n0 + n1 c + n2 c²) / (1 + zeta c)²; its parameters are n0, n1, n2, zeta.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.rows import unique_rows

_MOST = 1.56692415  # zeta of the greatest absorption
_SMALL = 0.2  # below, closed forms lose digits, and few nodes integrate exactly
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_HALVINGS = 200


@part(forceinline=True)
def factor(parameters: np.ndarray, cos: float) -> float:
    """Energy at an angle of incidence over that at random incidence."""
    below = 1.0 + parameters[3] * cos
    above = parameters[0] + cos * (parameters[1] + cos * parameters[2])
    return max(above, 0.0) / (below * below)


def parameters(absorption: np.ndarray, transmission: np.ndarray, free: np.ndarray) -> np.ndarray:
    """(m, 2, b, 4) of materials with these (m, b) fractions at random incidence, of which `free` (m,) hang free: of
    what is reflected and of what is transmitted."""
    first, row = unique_rows(np.column_stack([absorption, transmission, free]))
    absorption, transmission, free = absorption[first], transmission[first], free[first]
    wall = _wall(absorption + transmission)
    layer = _layer(absorption, np.maximum(1.0 - absorption - transmission, 0.0), transmission)
    return np.where(free[:, None, None, None], layer, wall)[row]


def _means(zeta: np.ndarray) -> np.ndarray:
    """(…, 3) means over random incidence of 1, c and c² over (1 + zeta c)²."""
    c = 0.5 + 0.5 * _NODES
    powers = np.stack([c, c**2, c**3], axis=-1) * _WEIGHTS[:, None]
    small = np.minimum(zeta, _SMALL)[..., None]
    by_nodes = (1.0 / (1.0 + small * c) ** 2) @ powers
    z = np.maximum(zeta, _SMALL)
    zero = 2.0 / z**2 * (np.log1p(z) + 1.0 / (1.0 + z) - 1.0)
    one = 2.0 / z**3 * (1.0 + z - 1.0 / (1.0 + z) - 2.0 * np.log1p(z))
    closed = np.stack([zero, one, (1.0 - zero - 2.0 * z * one) / z**2], axis=-1)
    return np.asarray(np.where(zeta[..., None] < _SMALL, by_nodes, closed))


def random_incidence(zeta: np.ndarray) -> np.ndarray:
    """Absorption at random incidence (Paris) of a locally reacting wall of real impedance `zeta` over air's."""
    zeta = np.asarray(zeta, float)
    return np.asarray(4.0 * zeta * _means(zeta)[..., 1])


def impedance(absorption: np.ndarray) -> np.ndarray:
    """Real impedance, over that of air, of walls of this absorption at random incidence, 1.567 and more.

    Infinite for none; 1.567 also beyond .951, which no such wall reaches.
    """
    a = np.asarray(absorption, float)
    highest = np.maximum(8.0 / np.maximum(a, 1e-9), 2.0 * _MOST)
    zeta = _halve(lambda z: random_incidence(z) > a, np.full(a.shape, _MOST), highest)
    return np.where(a > 0.0, zeta, np.inf)


def flow_resistance(absorption: np.ndarray) -> np.ndarray:
    """Half the flow resistance, over air's impedance, of free layers that absorb so much in a pass at random
    incidence: 0 to 1.567, which absorbs most (.476)."""
    a = np.asarray(absorption, float)
    return _halve(lambda z: ~(0.5 * random_incidence(z) > a), np.zeros(a.shape), np.full(a.shape, _MOST))


def _halve(below: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The end, from `low` to `high`, of what is `below`, by halves until nothing moves any more."""
    for _ in range(_HALVINGS):
        half = 0.5 * (low + high)
        up, before = below(half), (low, high)
        low, high = np.where(up, half, low), np.where(up, high, half)
        if np.array_equal(before, (low, high)):
            break
    return low


def _polynomial(zeta: np.ndarray, n0: float, n1: float, n2: float) -> np.ndarray:
    """(…, 3) coefficients of n0 + n1 zeta c + n2 (zeta c)²."""
    return np.stack([np.full(zeta.shape, n0), n1 * zeta, n2 * zeta**2], axis=-1)


def _over(numerator: np.ndarray, mean: np.ndarray, zeta: np.ndarray) -> np.ndarray:
    """A numerator over its mean; where that is nothing, the same at all angles."""
    some = (mean > 1e-12)[..., None]
    flat = _polynomial(zeta, 1.0, 2.0, 1.0)
    return np.where(some, numerator / np.where(some, mean[..., None], 1.0), flat)


def _with_zeta(reflected: np.ndarray, transmitted: np.ndarray, zeta: np.ndarray) -> np.ndarray:
    """(m, 2, b, 4) parameters of two (m, b, 3) polynomials over the same (1 + zeta c)²."""
    numerator = np.stack([reflected, transmitted], axis=1)
    shared = np.broadcast_to(zeta[:, None, :, None], (*numerator.shape[:3], 1))
    return np.concatenate([numerator, shared], axis=3)


def _wall(kept: np.ndarray) -> np.ndarray:
    zeta = np.where(kept > 0.0, impedance(np.maximum(kept, 1e-12)), 0.0)
    most = random_incidence(zeta)
    scale = ((1.0 - kept) / (1.0 - most))[..., None]  # below 1 only where no wall keeps as much
    back = scale * _polynomial(zeta, 1.0, -2.0, 1.0)
    through = _polynomial(zeta, 1.0, 2.0, 1.0) - back
    return _with_zeta(_over(back, 1.0 - kept, zeta), _over(through, kept, zeta), zeta)


def _layer(absorption: np.ndarray, back: np.ndarray, through: np.ndarray) -> np.ndarray:
    zeta = flow_resistance(absorption)
    means = _means(zeta)
    scale = (1.0 - absorption) / (1.0 - 2.0 * zeta * means[..., 1])
    law_back, law_through = (
        scale[..., None] * _polynomial(zeta, 0.0, 0.0, 1.0),
        scale[..., None] * _polynomial(zeta, 1.0, 0.0, 0.0),
    )
    rest = law_back + law_through
    mean_back, mean_through = scale * zeta**2 * means[..., 2], scale * means[..., 0]
    less = (through <= mean_through)[..., None]
    by_through = law_through * (through / np.maximum(mean_through, 1e-300))[..., None]
    by_back = law_back * (back / np.maximum(mean_back, 1e-300))[..., None]
    of_through = np.where(less, by_through, rest - by_back)
    of_back = np.where(less, rest - by_through, by_back)
    return _with_zeta(_over(of_back, back, zeta), _over(of_through, through, zeta), zeta)
