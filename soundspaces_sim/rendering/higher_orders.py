"""Ambisonics of order 3 to 7: discrete arrivals exactly, reverberation as plane waves.

Conventions as `ambisonics`: ACN, SN3D, world axes. A discrete arrival has the harmonics of its own direction in all
channels. Of reverberation an echogram knows energy and moments of order 1 and 2; the waves of `waves.WaveField`
have them, and of all that have them those are taken whose directions have the largest entropy. So what orders
above 2 add to reverberation is no knowledge: they say what a field with those moments most likely has. A diffuse
field gives all channels the same energy in N3D, and none in common.
"""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.rendering.ambisonics import response_length, with_arrivals
from soundspaces_sim.rendering.harmonics import harmonics_sn3d
from soundspaces_sim.rendering.waves import WaveField

LOWEST, HIGHEST = 3, 7
WAVES = 320  # a lattice of these keeps channels of order 7 apart to 1 %


def check_order(order: int) -> int:
    """An order of ambisonics that `higher_order_rir` makes. Raises `ConfigError`."""
    if not (isinstance(order, int | np.integer) and LOWEST <= order <= HIGHEST):
        raise ConfigError(f"order: expected {LOWEST} to {HIGHEST}, got {order!r}")
    return int(order)


def higher_order_rir(echogram: Echogram, rate: int, seed: int, order: int) -> np.ndarray:
    """((order + 1)², n) float32 room impulse response at `rate` Hz, world axes, ACN/SN3D. The noise is a function
    of `seed` alone. Raises `ConfigError`."""
    order = check_order(order)
    field = WaveField(echogram, response_length(echogram, rate), rate, seed, WAVES)
    weights = harmonics_sn3d(field.directions, order).T
    out = field.at(np.zeros((len(weights), 3)), weights, 1.0)  # all channels at one place: no travel
    return with_arrivals(out, echogram, rate)
