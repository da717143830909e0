"""How well an episode went: the measures of the paper, of Habitat, and of SoundSpaces' code.

Letters: l, distance to the goal at the start; d, at the end; p, length of the path walked (m); n, actions,
STOP included; m, the fewest along a shortest path.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

HABITAT_SUCCESS = 1.0  # m, SUCCESS_DISTANCE of SoundSpaces' configuration


@dataclass(frozen=True)
class Metrics:
    """`success`: STOP within the success radius (0: exactly at the goal; paper). `success_1m`: STOP closer
    than 1 m (Habitat's measure as SoundSpaces configures it). `spl`: success · l / max(l, p), arXiv
    1807.06757. `softspl`: max(0, 1 - d / l) · l / max(l, p), Habitat. `sna`: success · m / max(m, n); `na` n;
    `distance_to_goal` d, m; `normalized_distance_to_goal` d / l; `collisions`: SoundSpaces' code."""

    success: float
    success_1m: float
    spl: float
    softspl: float
    sna: float
    na: float
    distance_to_goal: float
    normalized_distance_to_goal: float
    collisions: float


NAMES = tuple(f.name for f in fields(Metrics))


def episode_metrics(
    *,
    start_distance: float,
    distance: float,
    path: float,
    actions: int,
    fewest: int,
    collisions: int,
    stopped: bool,
    success_radius: float = 0.0,
) -> Metrics:
    """The measures of one episode, or of one that still goes on. Distances in m.

    An episode that starts at its goal (l = 0) has path efficiency 1 if it never leaves it, else 0.
    """
    success = float(stopped and distance <= success_radius)
    longest = max(start_distance, path)
    efficiency = start_distance / longest if longest > 0.0 else 1.0
    left = distance / start_distance if start_distance > 0.0 else float(distance > 0.0)
    return Metrics(
        success=success,
        success_1m=float(stopped and distance < HABITAT_SUCCESS),
        spl=success * efficiency,
        softspl=max(0.0, 1.0 - left) * efficiency,
        sna=success * fewest / max(fewest, actions, 1),
        na=float(actions),
        distance_to_goal=distance,
        normalized_distance_to_goal=left,
        collisions=float(collisions),
    )
