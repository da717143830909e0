"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .registry import BUILDINGS, building_mesh, building_of, building_rooms
from .shell import Room
from .walkway import inside

__all__ = ["BUILDINGS", "Room", "building_mesh", "building_of", "building_rooms", "inside"]
