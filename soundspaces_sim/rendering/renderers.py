"""Renderers: how an echogram becomes an ambisonic response. Chosen by `DatasetConfig.renderer`.

A renderer is a function ``(echogram, rate, seed) -> (9, n) float32``, ACN/SN3D, world axes, whose noise is
a function of the seed alone. A new one is a file in this room and a line below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.core.registry import Entry, check_name, find
from soundspaces_sim.echogram.echogram import Echogram, without_arrivals
from soundspaces_sim.rendering.ambisonics import ambisonic_rir

if TYPE_CHECKING:
    import numpy as np

    from soundspaces_sim.echogram.echogram import Echogram


# A renderer of the direct sound alone: what is heard where nothing answers.
#
# Waves hold all sound, so there are none below an edge either. Sound that walls or furniture block wholly is
# silent; what passes through them counts as direct. For comparisons: what are reflections, bending and
# reverberation worth to who listens?


def direct_rir(echogram: Echogram, rate: int = 44100, seed: int = 0) -> np.ndarray:
    """(9, n) float32 response of the direct path alone, as long as the whole one; ACN/SN3D, world axes.

    Arguments and errors as `ambisonics.ambisonic_rir`.
    """
    silent = replace(without_arrivals(echogram), energy=np.zeros_like(echogram.energy))
    return ambisonic_rir(replace(silent, direct=echogram.direct, low=None), rate, seed)


Renderer = Callable[["Echogram", int, int], "np.ndarray"]

RENDERERS: Mapping[str, Entry] = {
    "default": Entry(
        "soundspaces_sim.rendering.ambisonics:ambisonic_rir",
        "noise with the echogram's directional moments",
    ),
    "smooth": Entry(
        "soundspaces_sim.rendering.smooth:smooth_rir",
        "as default, without steps at band edges or holes in tails",
    ),
    "paper": Entry("soundspaces_sim.rendering.seed_paper:paper_rir", "as the seed paper does it"),
    "direct": Entry(
        "soundspaces_sim.rendering.renderers:direct_rir", "the direct sound alone, as default"
    ),
}
_SETTING = "dataset.renderer"


def check_renderer(name: str) -> None:
    """Raise `ConfigError` if there is no renderer of that name; loads none."""
    check_name(_SETTING, RENDERERS, name)


def find_renderer(name: str) -> Renderer:
    """The renderer of that name. Raises `ConfigError`."""
    make: Renderer = find(_SETTING, RENDERERS, name)
    return make
