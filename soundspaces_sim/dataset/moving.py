"""Ways in metres through a dataset: `RirDataset.render_path` for ends that move between the points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from soundspaces_sim.core.errors import ConfigError, PairIndexError
from soundspaces_sim.dataset import sound
from soundspaces_sim.dataset.sampling import as_points
from soundspaces_sim.echogram.endpoints import Directivity
from soundspaces_sim.rendering import auralise
from soundspaces_sim.rendering.binaural import binaural_moving
from soundspaces_sim.rendering.directivity import as_directivity
from soundspaces_sim.rendering.ears import as_ears
from soundspaces_sim.rendering.moving import Known, Way, as_way, render_moving

if TYPE_CHECKING:
    from soundspaces_sim.dataset.reader import RirDataset


def in_metres(ends: ArrayLike) -> bool:
    """Whether these are rows (t, x, y, z), not numbers of points."""
    return np.ndim(ends) == 2


def render_path(
    ds: RirDataset,
    audio: ArrayLike,
    sources: ArrayLike,
    listeners: ArrayLike,
    orientations_deg: ArrayLike,
    source: sound.Emits | Sequence[sound.Emits],
) -> np.ndarray:
    """(2, n): a dry sound at the dataset's rate whose source and listener move along paths (`rendering.moving`)."""
    if not (source is None or isinstance(source, Directivity | str)):
        raise ConfigError("source: expected one directivity where a way is given in metres")
    dry = auralise.as_mono(audio)
    config = ds.manifest.config
    if len(ds.points) < 2:
        raise PairIndexError(f"{ds.path} has one point: nothing moves in it")
    apart = np.asarray(KDTree(ds.points).query(ds.points, 2)[0])
    known = Known(
        ds.points, ds.echogram,
        lambda echoes, s, l: sound.response(echoes, ds.renderer, config.dataset.seed, s, l, ds.rate),
        ds.manifest.duration, ds.rate, config.simulation.c,
        float(np.median(apart[:, 1])), config.simulation.least_distance,
    )  # fmt: skip
    until = len(dry) / ds.rate
    a, b = _way(sources, "sources", known, until), _way(listeners, "listeners", known, until)
    field = render_moving(dry, a, b, known, as_directivity(source, "source"))
    turns, ears = np.atleast_2d(np.asarray(orientations_deg, float)), as_ears(ds.hrtf)
    return binaural_moving(
        field, turns, ds.rate, ears.hrtf, decoder=ears.decoder, equalisation=ears.equalisation
    )


def _way(ends: ArrayLike, what: str, known: Known, until: float) -> Way:
    """A way as it is, or along points at even times."""
    if in_metres(ends):
        return as_way(ends, what, known.speed_of_sound)
    rows = as_points(ends, what)
    if rows.min() < 0 or rows.max() >= len(known.points):
        raise PairIndexError(
            f"{what}: expected points 0 to {len(known.points) - 1}, got {rows.tolist()}"
        )
    time = np.linspace(0.0, until, len(rows))
    return as_way(np.column_stack([time, known.points[rows]]), what, known.speed_of_sound)
