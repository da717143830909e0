"""The names that other modules use, and where they live."""

from .of_echograms import dataset_office, dataset_parameters, room_parameters

__all__ = ["dataset_office", "dataset_parameters", "room_parameters"]
