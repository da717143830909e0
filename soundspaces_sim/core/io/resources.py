"""Files that travel with the package: materials/, data_schema/, pipelines/, and measured HRTFs.

In a checkout the first three are top-level folders; in a wheel they lie inside the package.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parents[2]


def resource(folder: str, name: str) -> Path:
    """Path of a file in one of the folders above."""
    for root in (_PACKAGE, _PACKAGE.parent):
        path = root / folder / name
        if path.is_file():
            return path
    raise FileNotFoundError(f"{folder}/{name} is missing from this installation of soundspaces_sim")
