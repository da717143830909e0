"""The names that other packages use, and where they live."""

from .closure import change
from .measures import drop_uncertain, room_measures

__all__ = ["change", "drop_uncertain", "room_measures"]
