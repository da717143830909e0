"""Materials that a file gives by octaves from 125 Hz on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from soundspaces_sim.core.errors import MaterialError, SceneError
from soundspaces_sim.scene.materials import MaterialTable

OCTAVES = 125.0 * 2.0 ** np.arange(8)  # Hz
SCATTERING = 0.1  # of materials for which a file gives none


def octave_material(
    where: str, name: str, absorption: Sequence[float], scattering: Sequence[float] | None
) -> MaterialTable:
    """A material of shares in 1 to 8 octaves, of which the last goes on. Raises `SceneError`, which begins with
    `where`."""
    rows = []
    for values in (absorption, [SCATTERING] if scattering is None else scattering):
        if not 1 <= len(values) <= len(OCTAVES):
            raise SceneError(f"{where}: expected 1 to {len(OCTAVES)} octaves, got {len(values)}")
        row = np.array(values, float)
        rows.append(np.append(row, np.full(len(OCTAVES) - len(row), row[-1]))[None])
    try:
        return MaterialTable((name,), OCTAVES, rows[0], rows[1], np.zeros((1, len(OCTAVES))))
    except MaterialError as error:
        raise SceneError(f"{where}: {error}") from error
