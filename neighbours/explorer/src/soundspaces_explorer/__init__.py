"""An explorer of datasets in the browser: served on this machine alone, or as a folder that opens from disk."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
