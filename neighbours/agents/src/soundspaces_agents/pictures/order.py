"""The order in which a report shows episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from soundspaces_sim.nav import Episode


def in_turn(episodes: Sequence[Episode]) -> list[Episode]:
    """The episodes with their scenes taking turns."""
    seen: Counter[str] = Counter()
    turns = []
    for episode in episodes:
        turns.append(seen[episode.scene])
        seen[episode.scene] += 1
    return [episodes[k] for k in np.argsort(turns, kind="stable")]
