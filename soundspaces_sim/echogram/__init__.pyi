"""The names that other packages use, and where they live."""

from .measures import drop_uncertain, room_measures

__all__ = ["drop_uncertain", "room_measures"]
