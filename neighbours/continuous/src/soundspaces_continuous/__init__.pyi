"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .agents import ContinuousOracle, DirectionFollower
from .draw import draw_episode
from .env import ContinuousNavEnv, ContinuousNavVectorEnv, ContinuousSetting
from .episodes import ContinuousEpisode, Rules, SoundSource
from .savnce import savnce_options, savnce_own_sensors
from .sound_field import SoundField
from .state import ContinuousState
from .task import ContinuousOptions

def register_environments() -> None:
    """Make `SoundSpaces/AudioGoalContinuous-v0` known to Gymnasium; twice is as good as once."""

__all__ = [
    "ContinuousEpisode",
    "ContinuousNavEnv",
    "ContinuousNavVectorEnv",
    "ContinuousOptions",
    "ContinuousOracle",
    "ContinuousSetting",
    "ContinuousState",
    "DirectionFollower",
    "Rules",
    "SoundField",
    "SoundSource",
    "draw_episode",
    "register_environments",
    "savnce_options",
    "savnce_own_sensors",
]
