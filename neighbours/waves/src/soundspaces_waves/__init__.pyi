"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .measures import LowMeasures, low_measures
from .responses import Discretisation, LowResponses
from .simulate import simulate_low

__all__ = ["Discretisation", "LowMeasures", "LowResponses", "low_measures", "simulate_low"]
