"""The cardioid family: pressure p + (1 - p) cos(theta), and its powers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.echogram.endpoints import Directivity

_ANY_HZ = np.array([1000.0])  # of a pattern that does not depend on frequency


@dataclass(frozen=True, kw_only=True)
class Omni(Directivity):
    """Alike in all directions."""

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _ANY_HZ, np.ones((len(directions), 1))


@dataclass(frozen=True)
class Cardioid(Directivity):
    """Pressure (p + (1 - p) cos(theta))^order: `p` 1 omnidirectional, 0.75 subcardioid, 0.5 cardioid,
    0.25 hypercardioid, 0 figure of eight (the names of pyroomacoustics); `order` 2 and up is narrower.

    Raises `ConfigError` unless 0 <= p <= 1 and order is a whole number from 1 to 8.
    """

    p: float = 0.5
    order: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (isinstance(self.p, int | float | np.number) and 0.0 <= self.p <= 1.0):
            raise ConfigError(
                f"Cardioid: expected p from 0 (figure of eight) to 1 (omnidirectional), got {self.p!r}"
            )
        if self.order not in range(1, 9):
            raise ConfigError(f"Cardioid: expected an order from 1 to 8, got {self.order!r}")

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pressure = (self.p + (1.0 - self.p) * directions[:, :1]) ** self.order
        return _ANY_HZ, pressure**2
