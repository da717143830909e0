"""Pictures and reports of agents (extra ``figures``): loaded, and matplotlib with them, when first used."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
