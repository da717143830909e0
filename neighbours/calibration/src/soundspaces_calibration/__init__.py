"""Materials of a measured room: absorption fitted to T30, EDT, C80 and D50, or to measured responses.

import soundspaces_calibration as cal
found = cal.calibrate(scene, cal.read_measured("parameters.csv"))
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
