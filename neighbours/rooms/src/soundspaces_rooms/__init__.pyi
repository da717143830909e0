"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .many_rooms import simulate_many
from .random_room_files import build_random_rooms
from .room_files import build_rooms
from .room_stream import RoomStream
from .torch_rooms import TorchRoomStream

__all__ = ["RoomStream", "TorchRoomStream", "build_random_rooms", "build_rooms", "simulate_many"]
