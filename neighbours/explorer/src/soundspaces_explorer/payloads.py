"""What the explorer is told of datasets: plain data and responses, through the reader alone."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from soundspaces_parameters.of_waves import has_octave, low_levels, octaves_below

from soundspaces_sim import Echogram, PairIndexError, RirDataset
from soundspaces_sim.echogram import room_measures
from soundspaces_sim.parts import decay_curve, levels_of, nominal, read_floorplan, storeys_of

DECAY_BIN_S = 0.01
SOUNDS = ("speech", "clap", "music")
_LOWEST_DB = -80.0
_MEASURES = ("t30", "edt", "c50", "c80", "d50", "drr")
_OF_WAVES = ("t20", "edt", "c50", "c80", "d50")


def overview(ds: RirDataset) -> dict[str, Any]:
    """Points, navigation graph, walls of every storey, bands and rate of a dataset."""
    m = ds.manifest
    plan = read_floorplan(ds.path)
    storey = storeys_of(plan, ds.points)
    return {
        "name": ds.scene,
        "rate": ds.rate,
        "duration": m.duration,
        "spacing": m.config.grid.spacing,
        "bands": list(m.config.simulation.bands),
        "speedOfSound": m.config.simulation.c,
        "points": rounded(ds.points, 3),
        "storey": storey.tolist(),
        "nodes": list(m.nodes),
        "edges": [list(e) for e in m.edges],
        "walls": [rounded(walls, 3) for walls in plan.walls],
    }


def pair(ds: RirDataset, s: int, l: int) -> dict[str, Any]:
    """Decay curves, measures, errors and discrete arrivals of a pair, and measures of its waves."""
    e = ds.echogram(s, l)
    curve, _ = decay_of(e)
    measures = room_measures(e)
    offset = ds.points[s] - ds.points[l]
    return {
        "source": s,
        "listener": l,
        "visible": bool(e.visible),
        "distance": round(float(np.linalg.norm(offset)), 3),
        "binSeconds": DECAY_BIN_S,
        "decay": rounded(curve, 2),
        "measures": {name: rounded(getattr(measures, name), 4) for name in _MEASURES},
        "error": rounded(e.relative_error, 4),
        "arrivals": arrivals_of(e),
        "waves": _waves(ds, e, s, l),
    }


def decay_of(e: Echogram) -> tuple[np.ndarray, float]:
    """(B, n) decay curves, dB re all energy, and the seconds between two of their values."""
    curve = decay_curve(e.histogram(DECAY_BIN_S))
    return np.where(np.isfinite(curve), np.maximum(curve, _LOWEST_DB), _LOWEST_DB), DECAY_BIN_S


def _waves(ds: RirDataset, e: Echogram, s: int, l: int) -> dict[str, Any] | None:
    """Levels, dB re the direct sound at 1 m, and measures of waves in octaves below their edge; None without."""
    if e.low is None or not has_octave(e.low.edge):
        return None
    edges = octaves_below(e.low.edge)
    found = ds.parameters(_OF_WAVES, edges, [(s, l)], waves=True)
    return {
        "edge": e.low.edge,
        "bands": [nominal(f) for f in found.bands.centre],
        "level": rounded(low_levels(e.low, edges), 2),
        "measures": {name: rounded(found[name][0], 4) for name in _OF_WAVES},
    }


def arrivals_of(e: Echogram) -> list[dict[str, Any]]:
    """Discrete arrivals: delay, direction at the listener, mean level re 1 J at 1 m, mirrors and edges met."""
    out = []
    for a in e.arrivals:
        level = 10.0 * np.log10(max(float(a.energy.mean()) * 4.0 * np.pi, 1e-30))
        out.append(
            {
                "delay": round(a.delay, 6),
                "direction": rounded(a.direction, 4),
                "level": round(level, 1),
                "order": len(a.planes) + 2 * len(a.edges),
            }
        )
    return out


@lru_cache(maxsize=64)
def field(ds: RirDataset, s: int) -> list[float | None]:
    """Level at every point of source `s`, dB re its direct sound at 1 m; None where nothing arrives."""
    levels = levels_of([ds.echogram(s, l) for l in range(len(ds.points))])
    return [round(float(x), 2) if np.isfinite(x) else None for x in levels]


def response(ds: RirDataset, s: int, l: int, heading_deg: float) -> np.ndarray:
    """(2, n) float32: the reader's binaural response."""
    return ds.binaural(s, l, heading_deg)


@lru_cache(maxsize=8)
def sound(name: str, rate: int) -> np.ndarray:
    """(n,) float32: a dry sound by name, peak 0.5."""
    from soundspaces_renderers.dry import hand_clap, music, syllables

    makers = {"speech": syllables, "clap": hand_clap, "music": music}
    signal = np.asarray(makers[name](rate), np.float32)
    return np.asarray(0.5 * signal / np.abs(signal).max(), np.float32)


def check_pair(ds: RirDataset, *points: int) -> None:
    """Raise `PairIndexError` unless all are points of the dataset."""
    for point in points:
        if not 0 <= point < len(ds.points):
            raise PairIndexError(f"point {point} is not among 0 to {len(ds.points) - 1}")


def rounded(values: Any, digits: int) -> Any:
    """Nested lists of rounded numbers; NaN and infinity, which JSON does not have, are None."""
    array = np.asarray(values, float)
    if array.ndim == 0:
        return round(float(array), digits) if np.isfinite(array) else None
    return [rounded(row, digits) for row in array]
