"""Reader of measured rooms in all their forms."""

from __future__ import annotations

from pathlib import Path

from soundspaces_calibration.measured.room import MeasuredRoom
from soundspaces_calibration.measured.sofa import read_sofa
from soundspaces_calibration.measured.table import read_table
from soundspaces_sim import DatasetError


def read_measured(path: str | Path) -> MeasuredRoom:
    """A measured room from a table (.csv) of parameters or of WAV files, from a SOFA file, or from a folder of SOFA
    files (docs/materials.md, "Measured rooms"). Raises `DatasetError`."""
    path = Path(path)
    if path.is_dir():
        files = sorted(path.glob("*.sofa"))
        if not files:
            raise DatasetError(f"{path}: expected SOFA files in this folder; or name a .csv table")
        return read_sofa(files)
    if path.suffix.lower() == ".sofa":
        return read_sofa([path])
    if path.suffix.lower() == ".csv":
        return read_table(path)
    raise DatasetError(f"{path}: expected a .csv table, a .sofa file, or a folder of .sofa files")
