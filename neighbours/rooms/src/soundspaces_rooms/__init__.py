"""Many rooms with few pairs each: random ones for speech, as a stream or in files, and lists of one's own.

    import soundspaces_rooms as sr
    for room in sr.RoomStream(seed=0, count=3):
        print(room["rir"].shape, room["t30"])

`TorchRoomStream` needs PyTorch. Names are loaded when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
