"""File formats to `Scene`: the only place that knows axes and units of files."""

from soundspaces_sim.loaders.load import load_scene

__all__ = ["load_scene"]
