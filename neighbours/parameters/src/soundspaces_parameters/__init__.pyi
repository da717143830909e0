"""The public names and where they live."""

from .of_echograms import dataset_office, dataset_parameters, room_parameters
from .office import OfficeParameters
from .registry import PARAMETERS, check_parameters
from .speech import Speech
from .table import ParameterTable

__all__ = [
    "PARAMETERS",
    "OfficeParameters",
    "ParameterTable",
    "Speech",
    "check_parameters",
    "dataset_office",
    "dataset_parameters",
    "room_parameters",
]
