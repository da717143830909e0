"""Pictures (extra ``figures``: matplotlib). Every function draws on a given Axes and returns nothing.

Lengths in m, levels in dB. Colours are those of Okabe & Ito and of maps that the colour-blind can read.
"""

from soundspaces_sim.figures.decay import draw_decay
from soundspaces_sim.figures.field import draw_error, draw_field, interpolate, levels_of
from soundspaces_sim.figures.lobes import draw_lobes, lobe
from soundspaces_sim.figures.plan import draw_map, draw_plan
from soundspaces_sim.figures.response import draw_spectrogram, draw_waveform

__all__ = [
    "draw_decay",
    "draw_error",
    "draw_field",
    "draw_lobes",
    "draw_map",
    "draw_plan",
    "draw_spectrogram",
    "draw_waveform",
    "interpolate",
    "levels_of",
    "lobe",
]
