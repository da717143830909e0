"""The public names and where they live."""

from .band_pieces import in_bands
from .of_echograms import dataset_office, dataset_parameters, room_parameters
from .of_waves import low_measures
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
    "in_bands",
    "low_measures",
    "room_parameters",
]
