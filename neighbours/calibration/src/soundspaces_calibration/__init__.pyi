"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .calibrate import calibrate
from .fit_materials import MaterialFit, fit_materials
from .interference import interference_spread
from .measured.calibration import Calibration
from .measured.reading import read_measured
from .measured.room import MeasuredRoom
from .report import write_calibration_pairs, write_calibration_report

__all__ = [
    "Calibration",
    "MaterialFit",
    "MeasuredRoom",
    "calibrate",
    "fit_materials",
    "interference_spread",
    "read_measured",
    "write_calibration_pairs",
    "write_calibration_report",
]
