"""ISO 9613-1:1993, written apart from the package: attenuation of tones and what is left of bands."""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad


def db_per_m(frequency: float, celsius: float = 20.0, humidity: float = 50.0) -> float:
    """Clause 6.3 at 101.325 kPa: molar humidity by eqs. B.1 to B.3, relaxation by eqs. 3 and 4, then eq. 5."""
    t = celsius + 273.15
    h = humidity * 10.0 ** (-6.8346 * (273.16 / t) ** 1.261 + 4.6151)
    f_o = 24.0 + 40400.0 * h * (0.02 + h) / (0.391 + h)
    f_n = (t / 293.15) ** -0.5 * (9.0 + 280.0 * h * np.exp(-4.17 * ((t / 293.15) ** (-1 / 3) - 1.0)))
    classical = 1.84e-11 * (t / 293.15) ** 0.5
    oxygen = 0.01275 * np.exp(-2239.1 / t) * f_o / (f_o**2 + frequency**2)
    nitrogen = 0.1068 * np.exp(-3352.0 / t) * f_n / (f_n**2 + frequency**2)
    return float(8.686 * frequency**2 * (classical + (t / 293.15) ** -2.5 * (oxygen + nitrogen)))


def left(low: float, high: float, metres: float) -> float:
    """Share of the energy of a band, even per Hz from `low` to `high`, that is left after a path at 20 °C, 50 %."""
    whole = quad(lambda f: 10.0 ** (-0.1 * metres * db_per_m(f)), low, high, limit=200)[0]
    return float(whole / (high - low))
