"""Room parameters of what was just simulated, and of a dataset's pairs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_parameters.evaluate import Bands, Conditions, Pair, bands_of, spread
from soundspaces_parameters.office import OfficeParameters, office_parameters
from soundspaces_parameters.registry import check_parameters
from soundspaces_parameters.speech import (
    OCTAVES,
    OFFICE_SPEECH_DB,
    Speech,
    a_weighted_level,
    speech_transmission_index,
)
from soundspaces_parameters.table import PairOf, ParameterTable, Progress, evaluate
from soundspaces_sim import Echogram, Echograms, PairIndexError
from soundspaces_sim.parts import (
    StoredResponses,
    as_pairs,
    as_point_rows,
    check_pairs,
    fractional_octaves,
)

if TYPE_CHECKING:
    from collections.abc import Callable


def room_parameters(
    echoes: Echogram | Echograms,
    names: str | Sequence[str] | None = None,
    bands: str | Sequence[float] = "octaves",
    *,
    speech: Speech | None = None,
    hrtf: str | Path | None = None,
    towards: ArrayLike | None = None,
    waves: bool = False,
) -> ParameterTable:
    """Room-acoustic parameters of an echogram, or of all pairs of a simulation, with error bars.

    `names`: of `PARAMETERS`, by default all; `bands`: ``octaves``, ``thirds``, ``stored``, or edges in Hz;
    `speech` and noise are for the speech transmission index, `hrtf` (a SOFA file, KEMAR by default) for the
    interaural cross-correlation; `towards` (3,), from the listener to the source, for one echogram out of
    sight. With `waves`, measures of decay and clarity in bands below the edge of waves are those of the waves.
    Raises `ConfigError`, `HrtfError`.
    """
    conditions = Conditions(speech or Speech(), hrtf)
    asked = bands_of(bands, echoes.bands)
    chosen = check_parameters(names)
    if isinstance(echoes, Echogram):
        way = None if towards is None else np.asarray(towards, float)
        alone = Pair(echoes, asked, conditions, way, waves=waves)
        return evaluate(np.zeros((1, 2), int), chosen, asked, lambda _s, _l: alone)
    errors, several = echoes.measure_error, echoes

    def pair_of(s: int, l: int) -> Pair:
        towards = several.sources[s] - several.listeners[l]
        known = None if errors is None else errors[s, l]
        return Pair(several[s, l], asked, conditions, towards, known, waves)

    return evaluate(np.argwhere(np.ones(echoes.shape)), chosen, asked, pair_of)


def dataset_parameters(
    stored: StoredResponses,
    names: str | Sequence[str] | None,
    bands: str | Sequence[float],
    pairs: ArrayLike | None,
    speech: Speech | None,
    hrtf: str | Path | None,
    directed: Callable[[int, int], Echogram] | None = None,
    waves: bool = False,
    progress: Progress | None = None,
) -> ParameterTable:
    """Of a dataset's (k, 2) pairs, by default all of two points; `directed` reads echograms with a directive
    source, whose stored errors do not hold; `waves` as in `room_parameters`; `progress` is told of pairs done."""
    count = len(stored.points)
    rows = np.argwhere(~np.eye(count, dtype=bool)) if pairs is None else as_pairs(pairs)
    check_pairs(rows, count, str(stored.path))
    conditions = Conditions(speech or Speech(), hrtf)
    asked = bands_of(bands, stored.manifest.config.simulation.bands)

    def of_directed(s: int, l: int) -> Pair:
        assert directed is not None
        towards = stored.points[s] - stored.points[l]
        return Pair(directed(s, l), asked, conditions, towards, waves=waves)

    chosen = check_parameters(names)
    if directed is not None:
        return evaluate(rows, chosen, asked, of_directed, progress=progress)
    of_stored = partial(_pair_of, stored, asked, conditions, waves)
    opened = partial(_opened, str(stored.path), asked, conditions, waves) if stored.plain else None
    return evaluate(rows, chosen, asked, of_stored, opened, progress)


def _pair_of(
    stored: StoredResponses, asked: Bands, conditions: Conditions, waves: bool, s: int, l: int
) -> Pair:
    towards, known = stored.points[s] - stored.points[l], stored.measure_error(s, l)
    return Pair(stored.echogram(s, l), asked, conditions, towards, known, waves)


def _opened(path: str, asked: Bands, conditions: Conditions, waves: bool) -> PairOf:
    """Of another process."""
    return partial(_pair_of, _stored_at(path), asked, conditions, waves)


@lru_cache(maxsize=1)
def _stored_at(path: str) -> StoredResponses:
    return StoredResponses(path)


def dataset_office(
    stored: StoredResponses, source: int, listeners: ArrayLike, noise_db: Sequence[float] | None
) -> OfficeParameters:
    """ISO 3382-3 of a source and a line of listeners; see `RirDataset.office`."""
    points = as_point_rows(listeners, "listeners")
    check_pairs(
        np.stack([np.full(len(points), source), points], axis=1), len(stored.points), str(stored.path)
    )
    edges, _ = fractional_octaves(1, OCTAVES[0], OCTAVES[-1])
    speech = Speech(tuple(OFFICE_SPEECH_DB), noise_db)
    asked = Bands(tuple(edges.tolist()), OCTAVES)
    found = []
    for l in points:
        if l == source:
            raise PairIndexError(f"listeners: point {l} is the source")
        response = Pair(stored.echogram(source, int(l)), asked, Conditions(speech)).response(asked.edges)
        level = a_weighted_level(response, speech.at_1_m)
        index = speech_transmission_index(response, speech)
        found.append((level[0], index[0], spread(level), spread(index)))
    level, index, level_error, index_error = np.array(found, float).T
    distance = np.linalg.norm(stored.points[points] - stored.points[source], axis=1)
    return office_parameters(distance, level, index, level_error, index_error)
