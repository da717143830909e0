"""Pictures (extra ``figures``: matplotlib). `draw_…` draw on given Axes and return nothing; the others write
files.

Lengths in m, levels in dB. Colours are those of Okabe & Ito and of maps that the colour-blind can read.
Names are loaded when they are first used, so that the list of pages (`registry`) needs no matplotlib.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
