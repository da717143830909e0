"""Endpoints of a path: sources and listeners as records, with or without a directivity.

A directivity is a pattern of energy over directions, in axes of its own (front +X, left +Y, up +Z) that
heading, pitch and roll turn as they turn a head (`axes.head_matrix`); a `Source` or `Listener` turns it
once more. A kind of pattern is a subclass with one method, `energy`; `rendering.directivity` has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError, PointError
from soundspaces_sim.core.keywords import Checked
from soundspaces_sim.core.numerics.axes import head_matrix

Level = Literal["power", "pattern"]
CENTRED = (0.0, 0.0, 0.0)
_MOST_OFFSET = 0.5  # m


@dataclass(frozen=True, kw_only=True)
class Directivity(metaclass=Checked):
    """How strongly a source emits, or a receiver picks up, by direction and frequency.

    `level` says what the pattern is relative to. ``power``: its mean over all directions is 1 in every
    band, so that a source emits the 1 J of an omnidirectional one. ``pattern``: as the pattern says, so
    1 straight ahead for most. None: ``power`` for a source, ``pattern`` for a receiver, whose
    sensitivity is stated on axis. `gain_db` is added. `offset` (x, y, z) m: where it sits from its end's
    point, in its own axes as they are turned: a mouth ahead of the head's centre. Raises `ConfigError`.
    """

    heading_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    level: Level | None = None
    gain_db: float = 0.0
    offset: tuple[float, float, float] = CENTRED

    def __post_init__(self) -> None:
        check_angles(type(self).__name__, self.heading_deg, self.pitch_deg, self.roll_deg, self.gain_db)
        if self.level is not None and self.level not in get_args(Level):
            raise ConfigError(f"level: expected {' or '.join(get_args(Level))}, got {self.level!r}")
        check_offset(f"{type(self).__name__}: offset", self.offset)

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy gains (n, k) in directions (n, 3), unit vectors in its own axes, at (k,) frequencies in
        Hz; k = 1 if they do not depend on frequency."""
        raise NotImplementedError(f"{type(self).__name__}.energy")

    @property
    def turn(self) -> np.ndarray:
        """(3, 3), own axes to those of what it is mounted on."""
        return head_matrix(self.heading_deg, self.pitch_deg, self.roll_deg)


def check_angles(what: str, *values: float) -> None:
    """Raise `ConfigError` unless all values are finite numbers."""
    try:
        finite = bool(np.isfinite(np.asarray(values, float)).all())
    except (TypeError, ValueError):
        finite = False
    if not finite:
        raise ConfigError(f"{what}: expected finite angles in degrees and gain in dB, got {values}")


def check_offset(what: str, offset: object) -> None:
    """Raise `ConfigError` unless this is a displacement of at most half a metre, over which the reverberant
    field is the same."""
    try:
        place = np.asarray(offset, float)
    except (TypeError, ValueError):
        place = np.empty(0)
    if place.shape != (3,) or not np.isfinite(place).all() or np.linalg.norm(place) > _MOST_OFFSET:
        raise ConfigError(
            f"{what}: expected (x, y, z) of at most {_MOST_OFFSET} m, got {offset!r}; move the point instead"
        )


@dataclass(frozen=True)
class _Endpoint(metaclass=Checked):
    position: tuple[float, float, float]
    directivity: Directivity | None = None
    heading_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0

    def __post_init__(self) -> None:
        what = type(self).__name__
        place = np.asarray(self.position, float)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise PointError(
                f"{what}: expected a position of three finite coordinates in m, got {self.position!r}"
            )
        object.__setattr__(self, "position", tuple(float(x) for x in place))
        check_angles(what, self.heading_deg, self.pitch_deg, self.roll_deg)
        if self.directivity is not None and not isinstance(self.directivity, Directivity):
            raise ConfigError(f"{what}: expected a Directivity or None, got {self.directivity!r}")

    @property
    def turn(self) -> np.ndarray:
        """(3, 3), own axes to world axes."""
        return head_matrix(self.heading_deg, self.pitch_deg, self.roll_deg)

    @property
    def centre(self) -> tuple[float, float, float]:
        """Where its directivity is, m: its position plus the directivity's offset."""
        if self.directivity is None or not any(self.directivity.offset):
            return self.position
        x, y, z = self.position + self.turn @ self.directivity.turn @ np.asarray(self.directivity.offset)
        return float(x), float(y), float(z)


@dataclass(frozen=True)
class Source(_Endpoint):
    """A sound source: `position` (3,) m, a `directivity` (None: omnidirectional), and how it is turned."""


@dataclass(frozen=True)
class Listener(_Endpoint):
    """A receiver of sound: `position` (3,) m, and how it is turned. With a `directivity` it is a microphone, whose
    response is channel 0; without, the whole sound field is kept, for the ears of a head turned so."""


E = TypeVar("E", Source, Listener)


def centred(end: E) -> E:
    """The same end, its directivity at its position."""
    if end.directivity is None or not any(end.directivity.offset):
        return end
    return replace(end, directivity=replace(end.directivity, offset=CENTRED))


Points: TypeAlias = ArrayLike | Source | Listener | Sequence[Source | Listener | ArrayLike]


def as_ends(points: Points, kind: type[E]) -> tuple[ArrayLike, tuple[E, ...] | None]:
    """(where they sit, the records) of ends given as records, as positions or mixed; None if all are positions.

    Raises `PointError` for a record of the other kind.
    """
    if isinstance(points, _Endpoint):
        points = [points]
    if not isinstance(points, list | tuple) or not any(isinstance(p, _Endpoint) for p in points):
        return points, None  # type: ignore[return-value]
    wrong = next((p for p in points if isinstance(p, _Endpoint) and not isinstance(p, kind)), None)
    if wrong is not None:
        raise PointError(f"expected {kind.__name__} records or positions, got a {type(wrong).__name__}")
    ends = tuple(p if isinstance(p, kind) else kind(p) for p in points)
    return [end.centre for end in ends], ends
