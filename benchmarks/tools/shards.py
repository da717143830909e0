"""Shards in memory, of echograms that no job has made."""

from __future__ import annotations

import numpy as np

import soundspaces_sim as ss
from soundspaces_sim.dataset.format.writing import encode_echograms

_TEXTS = ("key", "scene", "scene_digest", "config", "code_version", "licence", "citation")


def encoded(echoes: ss.Echograms, sources: np.ndarray, listeners: np.ndarray) -> bytes:
    """A shard of echograms from points of these numbers (S,) to points of those (L,)."""
    attributes = {**dict.fromkeys(_TEXTS, "x"), "seed": 0, "speed_of_sound": 343.0}
    return encode_echograms(echoes, sources, listeners, attributes)
