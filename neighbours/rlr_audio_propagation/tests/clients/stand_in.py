"""What stands in for large files of AudibleLight's tests where a checkout lacks them.

A made-up apartment in the frame of AudibleLight's test mesh Oyens (Gibson).

Same bounds, rooms where its tests stand: bedroom 1 around (-1.5, -1.5), a living room around (2, -2), bedroom 2
around (2.9, -7), a corridor at x < 1.6. Z up, metres.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import soundfile
import trimesh

_LOW, _HIGH = (-3.043, -10.448, -0.05), (5.973, 2.101, 2.458)
_GAP = 0.001  # m between walls and shell: closed bodies side by side, so that parity tells inside from outside
# x and y of walls, floor to ceiling; door openings are what they leave free.
_WALLS = (
    ((-1.05, -3.1), (-0.95, 0.6)),
    ((-1.05, 1.5), (-0.95, 2.1)),
    ((-3.043, -3.2), (-0.95, -3.1 - _GAP)),
    ((1.6, -10.448), (1.7, -5.9 - _GAP)),
    ((1.6, -5.9), (5.0, -5.8)),
)


def apartment() -> trimesh.Trimesh:
    """The mesh."""
    bodies = [trimesh.creation.box(bounds=(_LOW, _HIGH))]
    bodies[0].invert()
    for (x0, y0), (x1, y1) in _WALLS:
        low = (max(x0, _LOW[0] + _GAP), max(y0, _LOW[1] + _GAP), _LOW[2] + _GAP)
        high = (min(x1, _HIGH[0] - _GAP), min(y1, _HIGH[1] - _GAP), _HIGH[2] - _GAP)
        bodies.append(trimesh.creation.box(bounds=(low, high)))
    whole = trimesh.util.concatenate(bodies)
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def write_apartment(path: Path) -> None:
    """Write it as glTF or whatever the suffix says."""
    path.parent.mkdir(parents=True, exist_ok=True)
    apartment().export(path)


def write_noise(path: Path) -> None:
    """Ten seconds of noise in four channels at 44.1 kHz."""
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, 0.1 * np.random.default_rng(0).standard_normal((441_000, 4)), 44100)
