"""Echograms between endpoints displaced by a few decimetres: a mouth before a talker's centre, a head above its
point.

Delays, levels and directions of discrete arrivals follow from the displaced endpoints: of the direct sound from the
line between them, of specular reflections from how much each displacement changes the distance to the other's image
source. Reverberation stays: over the width of a head it is the same field. Waves follow the listener.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from soundspaces_sim.echogram.echogram import Arrival, Echogram
from soundspaces_sim.echogram.low_response import heard as heard_low

_LEAST_M = 0.05  # length of a path, below which levels stay


def displaced(
    echogram: Echogram,
    source: np.ndarray,
    listener: np.ndarray,
    departures: np.ndarray,
    speed_of_sound: float,
) -> tuple[Echogram, np.ndarray, np.ndarray]:
    """The echogram between ends displaced by `source` and `listener`, (3,) m in world axes.

    `departures` (n, 3): directions in which early arrivals leave the source. Also returned: the direct sound's
    direction of departure (3,), and those of the early ones, from the displaced source.
    """
    early, first = echogram.early, echogram.direct
    left_direct = np.zeros(3)
    if first is not None:
        length = first.delay * speed_of_sound
        between = length * first.direction + source - listener  # from the listener to the source
        own = float(np.linalg.norm(between))
        direction = between / own if own > 0.0 else np.zeros(3)
        level = (max(length, _LEAST_M) / max(own, _LEAST_M)) ** 2
        first = Arrival(own / speed_of_sound, first.energy * level, direction, first.planes)
        left_direct = -direction
    lengths = early.delay[:, None] * speed_of_sound
    heard, left = lengths * early.direction - listener, lengths * departures - source
    to_image, to_listener = (np.linalg.norm(x, axis=1, keepdims=True) for x in (heard, left))
    paths = np.maximum(to_image + to_listener - lengths, _LEAST_M)
    moved = replace(
        early,
        delay=paths[:, 0] / speed_of_sound,
        energy=early.energy * (lengths / paths) ** 2,
        direction=heard / np.maximum(to_image, 1e-9),
    )
    low = echogram.low
    if low is not None and listener.any():
        low = heard_low(low, listener, None, speed_of_sound)
    return (
        replace(echogram, direct=first, early=moved, low=low),
        left_direct,
        left / np.maximum(to_listener, 1e-9),
    )
