"""The names that other packages use, and where they live."""

from .hrtf import load_hrtf
from .rendering import Rendering

__all__ = ["Rendering", "load_hrtf"]
