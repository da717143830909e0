"""Head-related transfer functions: reading SOFA files, and preparing a set for decoding.

Conventions: directions are unit vectors in head axes (x front, y left, z up); ear 0 is the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import h5py
import numpy as np
from scipy.signal import resample_poly
from scipy.spatial import SphericalVoronoi

from soundspaces_sim.base.errors import SoundSpacesSimError
from soundspaces_sim.base.resources import resource

_ONSET = 10.0 ** (-10.0 / 20.0)


class HrtfError(SoundSpacesSimError):
    """An HRTF file is missing or not a SimpleFreeFieldHRIR SOFA file."""


@dataclass(frozen=True, eq=False)
class Hrtf:
    """A measured set: `ir` (P, 2, n), `directions` (P, 3) unit, `rate` Hz, `citation`."""

    ir: np.ndarray
    directions: np.ndarray
    rate: float
    citation: str

    @cached_property
    def weights(self) -> np.ndarray:
        """(P,) share of the sphere of each direction (spherical Voronoi cells), sum 1."""
        area = SphericalVoronoi(self.directions, radius=1.0).calculate_areas()
        return np.asarray(area / area.sum())


@lru_cache(maxsize=4)
def load_hrtf(path: str | Path | None = None) -> Hrtf:
    """Read a SOFA file (SimpleFreeFieldHRIR); by default MIT's KEMAR (Gardner & Martin 1994).

    Raises `HrtfError`.
    """
    file = Path(path) if path is not None else resource("sound/hrtf_data", "mit_kemar.sofa")
    try:
        with h5py.File(file, "r") as sofa:
            ir = np.asarray(sofa["Data.IR"][:], float)
            position = np.asarray(sofa["SourcePosition"][:], float)
            kind = _text(sofa["SourcePosition"].attrs.get("Type", "spherical"))
            rate = float(np.ravel(sofa["Data.SamplingRate"][:])[0])
            citation = _text(sofa.attrs.get("References", "")) or _text(sofa.attrs.get("Title", ""))
    except (OSError, KeyError) as error:
        raise HrtfError(
            f"{file}: expected a SOFA file with Data.IR, SourcePosition and Data.SamplingRate ({error})"
        ) from error
    if ir.ndim != 3 or ir.shape[1] != 2 or position.shape != (len(ir), 3) or len(ir) < 16:
        raise HrtfError(
            f"{file}: expected Data.IR of shape (directions >= 16, 2, taps) and as many positions, got "
            f"{ir.shape} and {position.shape}"
        )
    if kind.startswith("cartesian"):
        directions = position / np.linalg.norm(position, axis=1, keepdims=True)
    else:
        azimuth, elevation = np.deg2rad(position[:, 0]), np.deg2rad(position[:, 1])
        directions = np.stack(
            [
                np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ],
            axis=1,
        )  # fmt: skip
    _, unique = np.unique(np.round(directions, 6), axis=0, return_index=True)
    unique.sort()
    return Hrtf(ir[unique], directions[unique], rate, citation)


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def onset_delays(hrtf: Hrtf) -> np.ndarray:
    """(P, 2) s: when each response, eight times oversampled, first reaches `_ONSET` of its peak."""
    up = 8
    level = np.abs(resample_poly(hrtf.ir, up, 1, axis=2))
    return np.asarray(
        (level >= _ONSET * level.max(axis=2, keepdims=True)).argmax(axis=2) / (up * hrtf.rate)
    )
