"""Renderers: how an echogram becomes an ambisonic response. Chosen by `DatasetConfig.renderer`.

A renderer is a function ``(echogram, rate, seed) -> (9, n) float32``, ACN/SN3D, world axes, whose noise is
a function of the seed alone. A new one is a file in this room and a line below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from soundspaces_sim.core.registry import Entry, check_name, find

if TYPE_CHECKING:
    import numpy as np

    from soundspaces_sim.echogram.echogram import Echogram

Renderer = Callable[["Echogram", int, int], "np.ndarray"]

RENDERERS: Mapping[str, Entry] = {
    "default": Entry(
        "soundspaces_sim.rendering.ambisonics:ambisonic_rir",
        "noise with the echogram's directional moments",
    ),
    "smooth": Entry(
        "soundspaces_renderers.smooth:smooth_rir",
        "as default, without steps at band edges or holes in tails",
        "renderers",
    ),
    "paper": Entry("soundspaces_sim.rendering.seed_paper:paper_rir", "as the seed paper does it"),
    "direct": Entry("soundspaces_sim.rendering.direct:direct_rir", "the direct sound alone, as default"),
}
_SETTING = "dataset.renderer"


def check_renderer(name: str) -> None:
    """Raise `ConfigError` if there is no renderer of that name; loads none."""
    check_name(_SETTING, RENDERERS, name)


def find_renderer(name: str) -> Renderer:
    """The renderer of that name. Raises `ConfigError`."""
    return find(_SETTING, RENDERERS, name)
