"""Air: speed of sound and absorption (ISO 9613-1:1993), of pure tones and of bands.

A band stands for sound with the same energy at every frequency in it (J/m² per Hz), as renderers make it. After a
path of L m the share of the band's energy that is left is the mean over its frequencies of exp(-m(f) L), which is
no exponential of L: what is absorbed most goes first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

_NODES = 16  # of Gauss and Legendre's rule, in each octave of a band: to 1e-6 over 20 km
_LOWEST = 100.0  # Hz; below it air absorbs evenly enough for one such interval


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
    db_per_m = (
        8.686
        * f**2
        * (
            1.84e-11 / relative_p * np.sqrt(relative_t)
            + relative_t**-2.5
            * (
                0.01275 * np.exp(-2239.1 / kelvin) / (oxygen + f**2 / oxygen)
                + 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen + f**2 / nitrogen)
            )
        )
    )
    return np.asarray(db_per_m * np.log(10.0) / 10.0)


@dataclass(frozen=True)
class Air:
    """Air that sound travels through."""

    temperature_c: float = 20.0
    humidity_percent: float = 50.0
    pressure_kpa: float = 101.325  # no setting: 83, 1,600 m up, change attenuation by at most 1.5 %
    speed_of_sound: float = 343.0  # m/s

    def attenuation(self, frequency_hz: ArrayLike) -> np.ndarray:
        """`absorption` of pure tones in this air, 1/m."""
        return absorption(frequency_hz, self.temperature_c, self.humidity_percent, self.pressure_kpa)

    def transmission(self, bands: Sequence[float], lengths_m: ArrayLike) -> np.ndarray:
        """(…, B) share of the energy in bands between these edges (B + 1, Hz) that is left after paths (…) in m."""
        lengths = np.asarray(lengths_m, float)
        out = np.empty((*lengths.shape, len(bands) - 1))
        nodes, weights = _gauss_legendre()
        for b in range(len(bands) - 1):
            cuts = _octaves(bands[b], bands[b + 1])
            left = np.zeros(lengths.shape)
            for low, high in pairwise(cuts):
                rate = self.attenuation(0.5 * (high + low) + 0.5 * (high - low) * nodes)
                # A matrix product's last digits depend on how many lengths there are.
                mean = np.einsum("...n,n", np.exp(-lengths[..., None] * rate), 0.5 * weights)
                left += mean * (high - low) / (bands[b + 1] - bands[b])
            out[..., b] = left
        return out


@cache
def _gauss_legendre() -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(_NODES)


def _octaves(low: float, high: float) -> np.ndarray:
    """Edges that divide a band into parts of an octave at most above `_LOWEST`, Hz."""
    start = max(low, _LOWEST)
    if start >= high:
        return np.array([low, high])
    inner = np.geomspace(start, high, int(np.ceil(np.log2(high / start) - 1e-9)) + 1)
    return inner if start == low else np.concatenate([[low], inner])
