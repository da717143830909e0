"""Tasks on collections of homes, with loaders, baselines and scores: README.md."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
