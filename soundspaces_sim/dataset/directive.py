"""Directive ends in a dataset: a pair's echogram and the way back's, weighted on reading."""

from __future__ import annotations

from collections.abc import Callable

from soundspaces_sim.echogram.directed import directed
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.endpoints import Directivity
from soundspaces_sim.rendering.directivity import as_directivity


def echogram(
    read: Callable[[int, int], Echogram],
    s: int,
    l: int,
    source: Directivity | str | None,
    listener: Directivity | str | None,
    speed_of_sound: float,
) -> Echogram:
    """The echogram of pair (s, l) of what `read` gives, with directive ends, given themselves or by name."""
    emits, picks_up = as_directivity(source, "source"), as_directivity(listener, "listener")
    back = None if emits is None else read(l, s)
    return directed(read(s, l), back, emits, picks_up, speed_of_sound)
