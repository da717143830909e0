"""A pattern for each of some frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.echogram.endpoints import Directivity


@dataclass(frozen=True)
class FrequencyDependent(Directivity):
    """`patterns` at increasing `frequencies` in Hz, e.g. narrower cardioids higher up; between two of them
    the nearer one counts (geometrically), as with coefficients of materials.

    Turns and gains of the patterns count, their levels do not. Raises `ConfigError` unless there are as
    many of either, in order, and no pattern depends on frequency itself.
    """

    frequencies: tuple[float, ...]
    patterns: tuple[Directivity, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "frequencies", tuple(float(f) for f in self.frequencies))
        object.__setattr__(self, "patterns", tuple(self.patterns))
        f = np.array(self.frequencies)
        if (
            len(f) == 0
            or len(f) != len(self.patterns)
            or not ((f > 0.0).all() and (np.diff(f) > 0.0).all())
        ):
            raise ConfigError(
                f"FrequencyDependent: expected increasing frequencies in Hz and as many patterns, got {len(f)} "
                f"frequencies {self.frequencies} and {len(self.patterns)} patterns"
            )
        for pattern in self.patterns:
            if not isinstance(pattern, Directivity) or pattern.energy(np.eye(3))[1].shape[1] != 1:
                raise ConfigError(
                    f"FrequencyDependent: expected patterns without frequencies of their own, got {pattern!r}"
                )

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        columns = [10.0 ** (p.gain_db / 10.0) * p.energy(directions @ p.turn)[1] for p in self.patterns]
        return np.array(self.frequencies), np.concatenate(columns, axis=1)
