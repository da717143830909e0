"""A measured room.

Positions are in the coordinates of the scene, m, Z up. Octaves follow each other; what was not measured is NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from soundspaces_sim import DatasetError
from soundspaces_sim.parts import fractional_octaves, nominal

#: What is measured of a pair, in s, s, dB and as a share.
MEASURED = ("t30", "edt", "c80", "d50")
#: Just-noticeable differences of ISO 3382-1, table A.1: 5 % of times, 1 dB, .05.
JND = (0.05, 0.05, 1.0, 0.05)
_LOWEST, _HIGHEST = 31.0, 16100.0  # Hz, of octaves' midband frequencies
_NEAR = 1.06  # ratio by which a printed midband frequency may differ


@dataclass(frozen=True)
class MeasuredRoom:
    """S sources, R receivers, K octaves. `values` and `error` (S, R, measures, K) of `MEASURED`: NaN where there is
    none; an error that is NaN was not stated."""

    source_names: tuple[str, ...]
    receiver_names: tuple[str, ...]
    sources: np.ndarray  # (S, 3) m
    receivers: np.ndarray  # (R, 3) m
    octaves: tuple[float, ...]  # (K,) nominal midband frequencies, Hz
    values: np.ndarray
    error: np.ndarray

    def __repr__(self) -> str:
        pairs = int(np.isfinite(self.values).any(axis=(2, 3)).sum())
        return (
            f"MeasuredRoom: {pairs} pairs of {len(self.source_names)} sources and {len(self.receiver_names)} "
            f"receivers, octaves of {self.octaves[0]:g} to {self.octaves[-1]:g} Hz"
        )

    @property
    def edges(self) -> tuple[float, ...]:
        """(K + 1,) of the octaves, Hz."""
        return octave_edges(self.octaves)

    @property
    def jnd(self) -> np.ndarray:
        """(S, R, measures, K) just-noticeable differences at the measured values."""
        times = np.arange(len(MEASURED)) < 2
        return np.array(JND)[:, None] * np.where(times[:, None], self.values, 1.0)

    def pairs_of(self, names: Sequence[str], what: str = "") -> np.ndarray:
        """(S, R) which pairs any of `names` names: a source, a receiver, or both as ``SOURCE:RECEIVER``. `what`: of
        messages. Raises `DatasetError`."""
        out = np.zeros((len(self.source_names), len(self.receiver_names)), bool)
        for name in names:
            source, colon, receiver = name.partition(":")
            rows = [n == source for n in self.source_names]
            columns = [n == (receiver if colon else source) for n in self.receiver_names]
            if colon and any(rows) and any(columns):
                out |= np.outer(rows, columns)
            elif not colon and (any(rows) or any(columns)):
                out |= np.array(rows)[:, None] | np.array(columns)[None, :]
            else:
                raise DatasetError(
                    f"{what}{name}: expected a source ({', '.join(self.source_names)}), a receiver "
                    f"({', '.join(self.receiver_names)}), or both as SOURCE:RECEIVER"
                )
        return out


def octave_edges(octaves: tuple[float, ...]) -> tuple[float, ...]:
    """Edges of neighbouring octaves of nominal midband frequencies, Hz."""
    edges, centre = fractional_octaves(1, octaves[0] / _NEAR, octaves[-1] * _NEAR)
    assert len(centre) == len(octaves)
    return tuple(edges.tolist())


def octaves_between(low: float, high: float) -> tuple[float, ...]:
    """Nominal midband frequencies of the octaves from one of about `low` to one of about `high`, Hz."""
    _, centre = fractional_octaves(1, low / _NEAR, high * _NEAR)
    return tuple(nominal(float(f)) for f in centre)


def octave_of(frequency_hz: float, where: str) -> float:
    """The nominal midband frequency of the octave that is meant. Raises `DatasetError`."""
    _, centre = fractional_octaves(1, _LOWEST, _HIGHEST)
    near = centre[np.abs(np.log(centre / max(frequency_hz, 1e-9))).argmin()]
    if not 1.0 / _NEAR <= frequency_hz / near <= _NEAR:
        expected = ", ".join(f"{nominal(float(f)):g}" for f in centre)
        raise DatasetError(
            f"{where}: expected the midband frequency of an octave ({expected}), got {frequency_hz:g}"
        )
    return nominal(float(near))
