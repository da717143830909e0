"""Echograms to pressure: ambisonic and binaural responses, and dry sounds through them; loaded when first
used."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
