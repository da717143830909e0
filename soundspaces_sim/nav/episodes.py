"""Episodes: where an agent starts, what sounds, where. Files as SoundSpaces' and Habitat's loaders read them.

Conventions of the files: ``<root>/<name>/v1/<split>/<split>.json.gz`` holds ``{"episodes":[]}`` and
``content/<scene>.json.gz`` the episodes. Positions are those of `graph.pkl`, on the floor in Habitat's frame
(x, z - h, -y); a rotation is [0, sin r/2, 0, cos r/2] with r = heading - 90° in [0°, 360°). SoundSpaces takes r
from the quaternion's length and real part and ignores its axis, so signs are never normalised.
"""

from __future__ import annotations

import gzip
import logging
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import msgspec
import numpy as np

from soundspaces_sim.core.errors import EpisodeError, PointError
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.io.untrusted import read_bytes
from soundspaces_sim.dataset.exporters.points import HABITAT_HEIGHT, habitat_point
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.navigation_graph import NavigationGraph, heading_index

FOLDER = "episodes/replica/v1"  # of a collection's episodes, in its folder
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


_log = logging.getLogger(__name__)
Layout = Literal["replica", "mp3d"]
_PACKED = 500_000_000  # bytes
_LARGEST = 1_000_000_000  # bytes, unpacked
_MOST_VALUES = 20_000_000  # of JSON in a file: half a million episodes
_MOST_EPISODES = 5_000_000  # of a split
_LONGEST_TEXT = 1000  # characters, of an id or a name
_ALIKE = 0.02  # m, in the plane; files and graphs are compared to two decimals
_STOREY = 1.0  # m; a position's height only tells storeys apart
RADIUS = 1e-05  # m, of a goal, as in the published files


@dataclass(frozen=True)
class Episode:
    """`start`, `goal`: rows of the scene's points; `heading` in degrees; `distance` from start to goal, m,
    and `actions`, the fewest on a shortest path with STOP, as the file has them. `start_position`,
    `goal_position`: Habitat's frame. `extra`: the rest of the file's `info`. `semantic`: of semantic episodes."""

    episode_id: str
    scene: str
    start: int
    heading: int
    goal: int
    sound: str
    distance: float
    actions: int
    scene_id: str
    start_position: tuple[float, float, float]
    goal_position: tuple[float, float, float]
    extra: Mapping[str, Any] = field(default_factory=dict)
    semantic: Semantic | None = None


class _Record(SemanticFields, kw_only=True):
    """The fields of Habitat's NavigationEpisode: it is called with these and, if semantic, those above alone."""

    episode_id: str
    scene_id: str
    start_position: tuple[float, float, float]
    start_rotation: tuple[float, float, float, float]
    goals: list[SemanticGoal]
    info: dict[str, Any]
    start_room: str | None = None
    shortest_paths: list[Any] | None = None
    scene_dataset_config: Any = msgspec.UNSET
    additional_obj_config_paths: Any = msgspec.UNSET


class _File(msgspec.Struct):
    """What else a file holds, such as `content_scenes_path`, is not ours to refuse."""

    episodes: list[_Record]


def scene_id_of(scene: str, layout: Layout = "replica") -> str:
    """The scene's path as episode files name it."""
    return f"{scene}/habitat/mesh_semantic.ply" if layout == "replica" else f"{scene}/{scene}.glb"


def scene_of(scene_id: str) -> str:
    """The scene that a path in an episode file means. Raises `EpisodeError`."""
    parts = PurePosixPath(scene_id).parts
    if len(parts) >= 3 and parts[-2:] == ("habitat", "mesh_semantic.ply"):
        return parts[-3]
    if len(parts) >= 2 and parts[-1] == f"{parts[-2]}.glb":
        return parts[-2]
    raise EpisodeError(
        f"scene_id: expected <scene>/habitat/mesh_semantic.ply or <scene>/<scene>.glb, got '{scene_id}'"
    )


def rotation_of(heading_deg: float) -> tuple[float, float, float, float]:
    """[x, y, z, w] of a heading in degrees counter-clockwise from +X."""
    half = math.radians((heading_deg - 90.0) % 360.0) / 2.0
    return 0.0, math.sin(half), 0.0, math.cos(half)


def heading_of(rotation: Sequence[float]) -> int:
    """The heading in degrees of a rotation [x, y, z, w], read as SoundSpaces reads it. Raises `PointError`."""
    x, y, z, w = rotation
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not math.isfinite(length) or abs(length - 1.0) > 1e-2:
        raise PointError(
            f"start_rotation: expected a unit quaternion [x, y, z, w], got {list(rotation)}"
        )
    turn = math.degrees(2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), w))
    return 90 * ((heading_index(turn, "start_rotation") + 1) % 4)


def make_episode(
    graph: NavigationGraph,
    episode_id: str,
    start: int,
    heading: int,
    goal: int,
    sound: str,
    layout: Layout = "replica",
) -> Episode:
    """An episode between two points of a scene, measured. Raises `EpisodeError` if there is no way."""
    hops = int(graph.hops[start, goal])
    if hops < 0:
        raise EpisodeError(
            f"episode {episode_id}: no way leads from point {start} to {goal} of {graph.scene}; choose points "
            "of one component of the navigation graph"
        )
    height = HABITAT_HEIGHT[layout]
    return Episode(
        episode_id,
        graph.scene,
        start,
        heading,
        goal,
        sound,
        hops * graph.spacing,
        int(graph.actions_to(goal)[4 * start + heading_index(heading)]),
        scene_id_of(graph.scene, layout),
        habitat_point(graph.points[start], height),
        habitat_point(graph.points[goal], height),
    )


def write_episodes(episodes: Sequence[Episode], path: str | Path) -> Path:
    """Write a split: `path` is its folder ``…/<split>`` or the file ``…/<split>/<split>.json.gz``. The same
    episodes give the same bytes. Returns the file that readers are given."""
    index = split_file(Path(path))
    content = index.parent / "content"
    content.mkdir(parents=True, exist_ok=True)
    by_scene: dict[str, list[Episode]] = {}
    for episode in episodes:
        by_scene.setdefault(episode.scene, []).append(episode)
    for old in content.glob("*.json.gz"):
        if old.name.removesuffix(".json.gz") not in by_scene:
            old.unlink()  # a loader reads every file of the folder
    for scene, group in by_scene.items():
        publish(content / f"{scene}.json.gz", _packed({"episodes": [_as_json(e) for e in group]}))
    publish(index, _packed({"episodes": []}))
    return index


def split_file(path: Path) -> Path:
    """``<split>/<split>.json.gz`` of a split's folder or of that file."""
    return path if path.name.endswith(".json.gz") else path / f"{path.name}.json.gz"


def read_episodes(path: str | Path, data: NavData) -> list[Episode]:
    """Episodes of a split (its folder or its file) or of one content file, in the order of the files.

    Only scenes that `data` holds can be read. What a file says of distance and actions is kept; where it
    differs from the graph, the log says so. Raises `EpisodeError`, `PointError`, `ConfigError`.
    """
    first = split_file(Path(path))
    out: list[Episode] = []
    differ = 0
    for file in _files(first):
        for row, record in enumerate(_parse(file)):
            where = f"{file}, episode '{record.episode_id[:100]}' (number {row})"
            if len(out) == _MOST_EPISODES:
                raise EpisodeError(f"{where}: a split of more than {_MOST_EPISODES:,} episodes")
            try:
                episode = _from_record(record, data)
            except (PointError, EpisodeError) as error:
                raise type(error)(f"{where}: {error}") from error
            graph = data.graph(episode.scene)
            differ += abs(graph.distance(episode.start, episode.goal) - episode.distance) > 1e-6
            out.append(episode)
    if not out:
        raise EpisodeError(f"{first}: holds no episode, nor do files in {first.parent / 'content'}")
    if differ:
        _log.warning(
            "%s: geodesic_distance of %d of %d episodes differs from the graph's; the file's is used",
            first,
            differ,
            len(out),
        )
    return out


def _files(first: Path) -> Iterator[Path]:
    yield first
    if first.parent.name != "content":
        yield from sorted((first.parent / "content").glob("*.json.gz"))


def _packed(content: Any) -> bytes:
    return gzip.compress(msgspec.json.encode(content), mtime=0)


def _as_json(e: Episode) -> dict[str, Any]:
    of_episode, of_goal = semantic_json(e.semantic, e.sound) if e.semantic else ({}, {})
    return {
        "episode_id": e.episode_id,
        "scene_id": e.scene_id,
        "start_position": e.start_position,
        "start_rotation": rotation_of(e.heading),
        "goals": [{"position": e.goal_position, "radius": RADIUS, **of_goal}],
        "start_room": None,
        "shortest_paths": None,
        "info": {"geodesic_distance": e.distance, "num_action": e.actions, "sound": e.sound, **e.extra},
        **of_episode,
    }


def unpacked(file: Path) -> bytes:
    """What is in a file of episodes, up to a limit of size. Raises `EpisodeError`."""
    try:
        unpack = zlib.decompressobj(wbits=31)
        text = unpack.decompress(read_bytes(file, EpisodeError, "file of episodes", _PACKED), _LARGEST)
    except zlib.error as error:
        raise EpisodeError(f"{file}: not a gzip file of episodes ({error})") from error
    if unpack.unconsumed_tail:
        raise EpisodeError(
            f"{file}: unpacks to more than {_LARGEST / 1e9:.0f} GB; no file of episodes does"
        )
    if not unpack.eof:
        raise EpisodeError(f"{file}: this gzip file breaks off; get it again")
    return text


def _parse(file: Path) -> list[_Record]:
    text = unpacked(file)
    values = sum(text.count(sign) for sign in (b"[", b"{", b",", b":"))
    if values > _MOST_VALUES:
        raise EpisodeError(
            f"{file}: holds some {values:,} values, where {_MOST_VALUES:,} are the most; part it"
        )
    try:
        return msgspec.json.decode(text, type=_File).episodes
    except RecursionError as error:
        raise EpisodeError(f"{file}: not a file of episodes (it is nested too deeply)") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise EpisodeError(f"{file}: not a file of episodes ({str(error)[:1000]})") from error


def _from_record(record: _Record, data: NavData) -> Episode:
    sound = record.info.get("sound")
    for name, text in (
        ("episode_id", record.episode_id),
        ("scene_id", record.scene_id),
        ("info.sound", sound),
    ):
        if isinstance(text, str) and len(text) > _LONGEST_TEXT:
            raise EpisodeError(f"{name}: {len(text):,} characters, where {_LONGEST_TEXT:,} are the most")
    scene = scene_of(record.scene_id)
    graph = data.graph(scene)
    if len(record.goals) != 1:
        raise EpisodeError(f"expected one goal, got {len(record.goals)}")
    info = dict(record.info)
    semantic = semantic_of(record, record.goals[0])
    if semantic is not None:
        info["sound"] = str(record.sound_id).removesuffix(".wav")
    known: dict[str, Any] = {}
    for name, kind in (("geodesic_distance", (int, float)), ("num_action", int), ("sound", str)):
        value = info.pop(name, None)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise EpisodeError(
                f"info.{name}: expected {'text' if kind is str else 'a number'}, got {value!r:.200}"
            )
        known[name] = value
    if known["geodesic_distance"] < 0 or known["num_action"] < 1:
        raise EpisodeError(
            f"info: expected a distance of 0 m or more and at least 1 action, got {known['geodesic_distance']:g} m "
            f"and {known['num_action']}"
        )
    start, goal = (
        _node_at(graph, position, record.scene_id, what)
        for position, what in (
            (record.start_position, "start_position"),
            (record.goals[0].position, "goals[0].position"),
        )
    )
    if graph.hops[start, goal] < 0:
        raise EpisodeError(f"no way leads from start (point {start}) to goal (point {goal}) of {scene}")
    return Episode(
        record.episode_id,
        scene,
        start,
        heading_of(record.start_rotation),
        goal,
        known["sound"],
        float(known["geodesic_distance"]),
        int(known["num_action"]),
        record.scene_id,
        record.start_position,
        record.goals[0].position,
        info,
        semantic,
    )


def _node_at(
    graph: NavigationGraph, position: tuple[float, float, float], scene_id: str, what: str
) -> int:
    """The node on whose floor point a Habitat position lies."""
    height = HABITAT_HEIGHT["replica" if scene_id.endswith(".ply") else "mp3d"]
    place = np.array([position[0], -position[2], position[1] + height])
    if not np.isfinite(place).all():
        raise PointError(f"{what}: expected three finite coordinates in m, got {list(position)}")
    offset = graph.points[graph.nodes] - place
    plane = np.hypot(offset[:, 0], offset[:, 1])
    plane[np.abs(offset[:, 2]) > _STOREY] = np.inf
    if not np.isfinite(plane).any():
        # Another storey: off the graph whatever the plane says.
        plane = np.linalg.norm(offset, axis=1) + _ALIKE
    best = int(plane.argmin())
    if plane[best] > _ALIKE:
        node = int(graph.nodes[best])
        raise PointError(
            f"{what} {[round(x, 3) for x in position]} is off the graph of {graph.scene}: the nearest node is "
            f"{node}, {np.linalg.norm(offset[best]):.2f} m away; build the dataset with POINTS= the graph.pkl or "
            "points.txt that the episodes were made with"
        )
    return int(graph.nodes[best])
