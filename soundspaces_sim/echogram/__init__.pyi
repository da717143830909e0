"""The names that other packages use, and where they live."""

from .measures import room_measures

__all__ = ["room_measures"]
