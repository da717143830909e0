"""The names that other packages use, and where they live."""

from .draw import check_scene, depth_views, scene_of_dataset

__all__ = ["check_scene", "depth_views", "scene_of_dataset"]
