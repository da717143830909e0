"""Generated buildings: the scenes `home-7`, `hall-3` and their like, drawn from numbers.

    import soundspaces_sim as ss, soundspaces_buildings as sb
    scene = ss.load_scene("home-7")
    rooms = sb.building_rooms("home", 7)

Names are loaded when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
