"""Agents in continuous space: they stand anywhere on the floor and hear sound go on while they move.

    import gymnasium, soundspaces_continuous
    env = gymnasium.make("SoundSpaces/AudioGoalContinuous-v0", data="out")

Importing this package registers the environment, and so does `soundspaces_sim.nav` where it is installed.
"""

import lazy_loader
from gymnasium.envs.registration import register, registry

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
_NAME = "SoundSpaces/AudioGoalContinuous-v0"


def register_environments() -> None:
    """Make `SoundSpaces/AudioGoalContinuous-v0` known to Gymnasium; twice is as good as once."""
    if _NAME not in registry:
        register(
            _NAME,
            entry_point="soundspaces_continuous.env:ContinuousNavEnv",
            vector_entry_point="soundspaces_continuous.env:ContinuousNavVectorEnv",
        )


register_environments()
