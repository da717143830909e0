"""Navigation: agents that hear, see depth, walk a dataset's graph and stop at the sound.

    import gymnasium, soundspaces_sim.nav
    env = gymnasium.make("SoundSpaces/AudioGoal-v0", data="out")

Importing this package registers the environments where Gymnasium is installed (extra ``nav``). Conventions:
docs/navigation.md. Learners are in neighbours/agents.
"""

from importlib.util import find_spec

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

if find_spec("gymnasium") is not None:
    from soundspaces_sim.nav.env import register_environments

    register_environments()
