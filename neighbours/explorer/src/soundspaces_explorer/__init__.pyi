"""The names that other packages use, and where they live."""

from .export import export_explorer
from .server import ExplorerServer

__all__ = ["ExplorerServer", "export_explorer"]
