"""The Python half of the original, under its name."""

from soundspaces_rlr.api import *  # noqa: F403
from soundspaces_rlr.api import __all__ as __all__
