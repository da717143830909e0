"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .renderer import Renderer
from .reverberate import Reverberate

__all__ = ["Renderer", "Reverberate"]
