"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .agents import EarFollower, Forward, GoalFollower, Oracle, Random
from .audio_sensor import bake_sound
from .data import NavData
from .depth import depth_views
from .env import AudioNavEnv, register_environments
from .episodes import Episode, make_episode, read_episodes, write_episodes
from .evaluate import Result, evaluate
from .generate import make_episodes
from .metrics import Metrics, episode_metrics
from .navigation_graph import NavigationGraph
from .sounds import SoundBank
from .vector import AudioNavVectorEnv
from .views import bake_views

__all__ = [
    "AudioNavEnv",
    "AudioNavVectorEnv",
    "EarFollower",
    "Episode",
    "Forward",
    "GoalFollower",
    "Metrics",
    "NavData",
    "NavigationGraph",
    "Oracle",
    "Random",
    "Result",
    "SoundBank",
    "bake_sound",
    "bake_views",
    "depth_views",
    "episode_metrics",
    "evaluate",
    "make_episode",
    "make_episodes",
    "read_episodes",
    "register_environments",
    "write_episodes",
]
