"""A renderer of the direct sound alone: what is heard where nothing answers.

Waves hold all sound, so there are none below an edge either. Sound that walls or furniture block wholly is silent;
what passes through them counts as direct. For comparisons: what are reflections, bending and reverberation worth to
who listens?
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from soundspaces_sim.echogram.echogram import Echogram, without_arrivals
from soundspaces_sim.rendering.ambisonics import ambisonic_rir


def direct_rir(echogram: Echogram, rate: int = 44100, seed: int = 0) -> np.ndarray:
    """(9, n) float32 response of the direct path alone, as long as the whole one; ACN/SN3D, world axes.

    Arguments and errors as `ambisonics.ambisonic_rir`.
    """
    silent = replace(without_arrivals(echogram), energy=np.zeros_like(echogram.energy))
    return ambisonic_rir(replace(silent, direct=echogram.direct, low=None), rate, seed)
