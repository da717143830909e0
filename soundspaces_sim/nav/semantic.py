"""Semantic AudioGoal episodes (Chen, Al-Halah & Grauman 2021): the goal is an object that sounds for a while.

Published files are those of SoundSpaces' `SemanticAudioNav`: the episode states the object's category, its sound
and the number of steps it is heard for, the goal states the object itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from soundspaces_sim.nav.errors import EpisodeError

_LONGEST = 1_000_000  # steps
_GOAL = ("object_id", "object_name", "object_category", "room_id", "room_name", "view_points")


@dataclass(frozen=True)
class Semantic:
    """`category` of the object; it is heard in steps 0 to `duration`, the first observation being step 0. `offset`
    is kept as the file has it: SoundSpaces' simulator reads it and does not use it. `goal`: the other fields of the
    file's goal."""

    category: str
    duration: int
    offset: int = 0
    goal: Mapping[str, Any] = field(default_factory=dict)


class SemanticGoal(msgspec.Struct, forbid_unknown_fields=True):
    """The fields of SoundSpaces' SemanticAudioGoal; a plain goal has the first two."""

    position: tuple[float, float, float]
    radius: float | None = None
    object_id: Any = None
    object_name: str | None = None
    object_category: str | None = None
    room_id: Any = None
    room_name: str | None = None
    view_points: list[Any] | None = None


class SemanticFields(msgspec.Struct, forbid_unknown_fields=True):
    """The fields that SoundSpaces' SemanticAudioGoalNavEpisode has beside those of Habitat's NavigationEpisode."""

    object_category: str | None = None
    sound_id: str | None = None
    offset: float | None = None
    duration: float | None = None
    distractor_sound_id: str | None = None
    distractor_position_index: int | None = None


def semantic_of(record: SemanticFields, goal: SemanticGoal) -> Semantic | None:
    """What a record says, or None if it is no semantic episode. Raises `EpisodeError`."""
    asked = {name: getattr(record, name) for name in ("object_category", "sound_id", "duration")}
    if all(value is None for value in asked.values()):
        return None
    missing = [name for name, value in asked.items() if value is None]
    if missing:
        raise EpisodeError(f"{missing[0]}: missing; a semantic episode has {', '.join(asked)}")
    if record.distractor_sound_id is not None:
        raise EpisodeError(
            f"distractor_sound_id: expected null, got '{record.distractor_sound_id}'; episodes with a second sound "
            "that distracts are not supported"
        )
    assert record.object_category is not None and record.duration is not None
    offset = record.offset or 0.0
    for name, value in (("duration", record.duration), ("offset", offset)):
        if not 0.0 <= value <= _LONGEST:
            raise EpisodeError(f"{name}: expected 0 to {_LONGEST:,} steps, got {value!r}")
    rest = {name: getattr(goal, name) for name in _GOAL if getattr(goal, name) is not None}
    return Semantic(record.object_category, int(record.duration), int(offset), rest)


def semantic_json(semantic: Semantic, sound: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Entries that a file has for it: of the episode, and of its goal."""
    episode = {
        "object_category": semantic.category,
        "sound_id": f"{sound}.wav",
        "offset": semantic.offset,
        "duration": semantic.duration,
    }
    return episode, dict(semantic.goal)
