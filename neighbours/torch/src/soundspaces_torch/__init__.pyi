"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .dataset import TorchRirDataset
from .random_materials import RandomMaterials, draw_furnished
from .renderer import Renderer
from .reverberate import Reverberate

__all__ = ["RandomMaterials", "Renderer", "Reverberate", "TorchRirDataset", "draw_furnished"]
