"""The interface of rlr_audio_propagation 0.0.1 over soundspaces_sim."""

from soundspaces_rlr.api import *  # noqa: F403
from soundspaces_rlr.api import __all__ as __all__
