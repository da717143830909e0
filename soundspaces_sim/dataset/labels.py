"""Where the source is, as a label of a pair."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.dataset.reader import RirDataset


def source_direction(ds: RirDataset, s: int, l: int, heading_deg: float = 0.0) -> tuple[float, float]:
    """Azimuth and elevation in degrees of point `s` from point `l`, for a head that faces `heading_deg`.

    Azimuth is positive to the left, in (-180, 180]; both are NaN if the points are one.
    """
    x, y, z = ds.points[s] - ds.points[l]
    if x == y == z == 0.0:
        return float("nan"), float("nan")
    azimuth = np.rad2deg(np.arctan2(y, x)) - heading_deg
    return float(180.0 - (180.0 - azimuth) % 360.0), float(np.rad2deg(np.arctan2(z, np.hypot(x, y))))
