"""Responses between points of any scene, without a context: what other programs' rooms are given."""

from __future__ import annotations

import math

import numpy as np

from soundspaces_rlr.preparation import Kept
from soundspaces_rlr.propagation import Propagation, group_listeners, noise_seeds
from soundspaces_rlr.records import ChannelLayout, ChannelLayoutType, Config
from soundspaces_rlr.render import GroupListener, render_group
from soundspaces_sim import Scene

_MONO = ChannelLayout(ChannelLayoutType.Mono, 1)


def responses(
    scene: Scene, sources: np.ndarray, places: np.ndarray, rate: float, indirect: bool, seed: int
) -> list[list[np.ndarray]]:
    """(n,) float64 responses [place][source] between (S, 3) and (M, 3) points, m; direct sound 1 / r. Places within
    0.3 m are one simulation."""
    config = Config(
        sample_rate=float(rate), indirect=int(indirect), global_volume=math.sqrt(4.0 * math.pi)
    )
    groups = group_listeners(places)
    middles = np.ascontiguousarray(places[[g.place for g in groups]])
    table = Propagation(scene, np.zeros(len(scene.faces), np.int64), Kept()).echograms(
        sources, middles, config
    )
    seeds = noise_seeds(sources, middles, False) + np.uint64(seed)
    out: list[list[np.ndarray]] = [[np.empty(0)] * len(sources) for _ in places]
    for s in range(len(sources)):
        for g, group in enumerate(groups):
            ears = [GroupListener(places[i] - middles[g], _MONO, np.eye(3), None) for i in group.members]
            distance = np.linalg.norm(places[list(group.members)] - sources[s], axis=1).tolist()
            found = render_group(table[s][g], ears, distance, config, int(seeds[s, g]))
            for i, response in zip(group.members, found, strict=True):
                out[i][s] = response[0]
    return out
