"""Energy against time: echograms, room measures, band filters.

Measures, which need SciPy, are loaded when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
