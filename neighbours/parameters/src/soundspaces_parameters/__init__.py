"""Room-acoustic parameters (ISO 3382-1, -2, -3, IEC 60268-16) of datasets and of single echograms, with error bars.

A parameter is a function of a `response.Response`, or of several, and a line in `registry.PARAMETERS`. Names are
loaded when they are first used."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
