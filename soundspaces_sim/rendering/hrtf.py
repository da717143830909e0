"""Head-related transfer functions: reading SOFA files, and preparing a set for decoding.

Conventions: directions are unit vectors in head axes (x front, y left, z up); ear 0 is the left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import scipy
from scipy.spatial import SphericalVoronoi

from soundspaces_sim.core.errors import SoundSpacesSimError
from soundspaces_sim.core.io.hdf5 import attribute, in_our_words, open_hdf5, plain_dataset, read_numbers
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.core.io.sofa import check_convention, data_delay, delayed

MOST_SAMPLES = 2**25  # of Data.IR: 32,000 directions of 500 taps for both ears
_CONVENTIONS = ("SimpleFreeFieldHRIR", "FreeFieldHRIR", "GeneralFIR")
_EXPECTED = (
    "expected a SOFA file (SimpleFreeFieldHRIR) with Data.IR, SourcePosition and Data.SamplingRate"
)
FAR_M = 2.0  # where distance no longer matters
_ONSET = 10.0 ** (-10.0 / 20.0)


class HrtfError(SoundSpacesSimError):
    """An HRTF file is missing or not a SimpleFreeFieldHRIR SOFA file."""


@dataclass(frozen=True, eq=False)
class Hrtf:
    """A measured set: `ir` (P, 2, n), `directions` (P, 3) unit, `rate` Hz, `citation`; `distance` of the
    loudspeakers, m (the median; a set that does not say counts as far)."""

    ir: np.ndarray
    directions: np.ndarray
    rate: float
    citation: str
    distance: float = FAR_M

    @cached_property
    def weights(self) -> np.ndarray:
        """(P,) share of the sphere of each direction (spherical Voronoi cells), sum 1."""
        area = SphericalVoronoi(self.directions, radius=1.0).calculate_areas()
        return np.asarray(area / area.sum())


@lru_cache(maxsize=4)
def load_hrtf(path: str | Path | None = None) -> Hrtf:
    """Read a SOFA file (SimpleFreeFieldHRIR); by default MIT's KEMAR (Gardner & Martin 1994). Its `Data.Delay` is
    part of the responses.

    Raises `HrtfError`.
    """
    file = Path(path) if path is not None else resource("rendering/hrtf_data", "mit_kemar.sofa")
    where = str(file)
    with open_hdf5(Path(file), HrtfError, "SOFA file", _EXPECTED) as sofa:
        with in_our_words(where, HrtfError, _EXPECTED):
            check_convention(sofa, _CONVENTIONS, where, HrtfError)
        names = "Data.IR", "SourcePosition", "Data.SamplingRate"
        items = [plain_dataset(sofa, name, where, HrtfError, _EXPECTED) for name in names]
        with in_our_words(where, HrtfError, _EXPECTED):
            if math.prod(items[0].shape) > MOST_SAMPLES or math.prod(items[1].shape) > MOST_SAMPLES:
                raise HrtfError(f"{file}: has more than {MOST_SAMPLES:,} samples, which is the limit")
            ir, position, rates = (
                np.asarray(read_numbers(item, ..., where, HrtfError, _EXPECTED), float) for item in items
            )
        kind, units = (
            str(attribute(items[1], name, where, HrtfError, _EXPECTED) or default).strip().lower()
            for name, default in (("Type", "spherical"), ("Units", "degree"))
        )
        own = (attribute(sofa, name, where, HrtfError, _EXPECTED) for name in ("References", "Title"))
        citation = next((str(text) for text in own if text), "")
        _check_responses(where, ir, position, rates)
        with in_our_words(where, HrtfError, _EXPECTED):
            ir = delayed(ir, data_delay(sofa, len(ir), ir.shape[1], where, HrtfError))
    rate = float(rates.flat[0])
    if kind.startswith("cartesian"):
        distance = np.linalg.norm(position, axis=1, keepdims=True)
        if not (distance > 0.0).all():
            raise HrtfError(f"{file}: a source in SourcePosition stands at the listener")
        directions, distance = position / distance, distance[:, 0]
    elif kind.startswith("spherical"):
        angles = position[:, :2] if units.startswith("rad") else np.deg2rad(position[:, :2])
        azimuth, elevation = angles.T
        directions = np.stack(
            [
                np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ],
            axis=1,
        )  # fmt: skip
        distance = position[:, 2]
    else:
        raise HrtfError(
            f"{file}: SourcePosition is of type {kind[:40]!r}, expected spherical or cartesian"
        )
    _, unique = np.unique(np.round(directions, 6), axis=0, return_index=True)
    unique.sort()
    _check_directions(where, directions[unique])
    away = float(np.median(distance))
    found = Hrtf(ir[unique], directions[unique], rate, citation, away if 0.1 <= away <= FAR_M else FAR_M)
    with in_our_words(where, HrtfError, _EXPECTED):
        _ = found.weights  # Qhull has a word to say on odd directions
    return found


def _check_responses(where: str, ir: np.ndarray, position: np.ndarray, rates: np.ndarray) -> None:
    """Raise `HrtfError` unless the numbers can be those of a measured set."""
    if (
        ir.ndim != 3
        or ir.shape[1] != 2
        or ir.shape[2] < 2
        or position.shape != (len(ir), 3)
        or len(ir) < 16
    ):
        raise HrtfError(
            f"{where}: expected Data.IR of shape (directions >= 16, 2, taps >= 2) and as many positions, got "
            f"{ir.shape} and {position.shape}"
        )
    if not np.isfinite(ir).all() or not np.isfinite(position).all() or np.abs(ir).max() > 1e6:
        raise HrtfError(
            f"{where}: Data.IR or SourcePosition has values that are not finite, or beyond 1e6"
        )
    silent = np.argwhere(np.abs(ir).max(axis=2) == 0.0)
    if len(silent):
        row, ear = silent[0]
        raise HrtfError(
            f"{where}: {len(silent)} of {ir.shape[0] * ir.shape[1]} responses in Data.IR are all zeros, the first "
            f"of measurement {row}, receiver {ear}"
        )
    if rates.size == 0 or not (rates == rates.flat[0]).all() or not 8e3 <= rates.flat[0] <= 192e3:
        raise HrtfError(
            f"{where}: expected one Data.SamplingRate of 8000 to 192000 Hz, got {rates.ravel()[:3]}"
        )


def _check_directions(where: str, directions: np.ndarray) -> None:
    """Raise `HrtfError` unless directions lie all round, so that each has a share of the sphere."""
    if len(directions) < 16 or not np.isfinite(directions).all():
        raise HrtfError(f"{where}: expected 16 different directions or more, got {len(directions)}")
    if np.linalg.svd(directions - directions.mean(axis=0), compute_uv=False)[-1] < 1e-3:
        raise HrtfError(f"{where}: SourcePosition lies in a plane; a set that goes all round is needed")


def onset_delays(hrtf: Hrtf) -> np.ndarray:
    """(P, 2) s: when each response, eight times oversampled, first reaches `_ONSET` of its peak."""
    up = 8
    level = np.abs(scipy.signal.resample_poly(hrtf.ir, up, 1, axis=2))
    return np.asarray(
        (level >= _ONSET * level.max(axis=2, keepdims=True)).argmax(axis=2) / (up * hrtf.rate)
    )
