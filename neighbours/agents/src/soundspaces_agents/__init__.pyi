"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .experiments import VARIANTS, Variant
from .pipeline import run_study
from .presets import PRESETS, NetConfig, TrainConfig, preset
from .trained import load_agent

__all__ = [
    "PRESETS",
    "VARIANTS",
    "NetConfig",
    "TrainConfig",
    "Variant",
    "load_agent",
    "preset",
    "run_study",
]
