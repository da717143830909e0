"""Air: speed of sound and absorption (ISO 9613-1:1993)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def speed_of_sound(temperature_c: float) -> float:
    """Speed of sound in air, m/s (ISO 9613-1, eq. A.5)."""
    return float(343.2 * np.sqrt((temperature_c + 273.15) / 293.15))


def absorption(
    frequency_hz: ArrayLike, temperature_c: float, humidity_percent: float, pressure_kpa: float
) -> np.ndarray:
    """Energy attenuation coefficient m of pure tones, 1/m: energy falls as exp(-m x).

    ISO 9613-1, eqs. 3 to 5 and B.1 to B.3; m = (attenuation in dB/m) * ln(10) / 10.
    """
    f = np.asarray(frequency_hz, float)
    kelvin = temperature_c + 273.15
    relative_t = kelvin / 293.15
    relative_p = pressure_kpa / 101.325
    saturation = 10.0 ** (-6.8346 * (273.16 / kelvin) ** 1.261 + 4.6151)
    h = humidity_percent * saturation / relative_p
    oxygen = relative_p * (24.0 + 4.04e4 * h * (0.02 + h) / (0.391 + h))
    nitrogen = (
        relative_p
        * relative_t**-0.5
        * (9.0 + 280.0 * h * np.exp(-4.170 * (relative_t ** (-1.0 / 3.0) - 1.0)))
    )
    db_per_m = 8.686 * f**2 * (
        1.84e-11 / relative_p * np.sqrt(relative_t)
        + relative_t**-2.5
        * (
            0.01275 * np.exp(-2239.1 / kelvin) / (oxygen + f**2 / oxygen)
            + 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen + f**2 / nitrogen)
        )
    )  # fmt: skip
    return np.asarray(db_per_m * np.log(10.0) / 10.0)
