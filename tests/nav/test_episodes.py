"""Episode files: rotations, positions, what Habitat's loader would take, and what is refused."""

from __future__ import annotations

import gzip
import json
import math
import tracemalloc
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.errors import EpisodeError
from soundspaces_sim.nav import episodes as module
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episodes import (
    Episode,
    heading_of,
    make_episode,
    read_episodes,
    rotation_of,
    write_episodes,
)
from soundspaces_sim.nav.generate import make_episodes
from tests.nav.conftest import T_CORRIDOR

H = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("heading", "r", "quaternion", "azimuth"),
    [
        (90, 0, (0, 0, 0, 1), 0),  # +Y of the mesh is -Z of Habitat: no turn
        (180, 90, (0, H, 0, H), 270),
        (270, 180, (0, 1, 0, 0), 180),
        (0, 270, (0, H, 0, -H), 90),  # facing +X: azimuth 90
    ],
)
def test_headings_rotations_azimuths(
    heading: int, r: int, quaternion: tuple[float, ...], azimuth: int
) -> None:
    assert (heading - 90) % 360 == r and (-r) % 360 == azimuth
    np.testing.assert_allclose(rotation_of(heading), quaternion, atol=1e-12)
    assert heading_of(quaternion) == heading
    # SoundSpaces: round(deg(2 atan2(|v|, w))) % 360, whatever the axis
    angle = 2 * math.atan2(math.hypot(*quaternion[:3]), quaternion[3])
    assert round(math.degrees(angle)) % 360 == r


def test_signs_are_read_as_soundspaces_reads_them() -> None:
    """Its code takes 90 from (0, -0.7, 0, 0.7), a turn to the right: the axis is ignored."""
    assert heading_of((0, -H, 0, H)) == 180
    with pytest.raises(ss.PointError, match="unit quaternion"):
        heading_of((0, 0, 0, 2))
    with pytest.raises(ss.PointError, match="multiple of 90"):
        heading_of((0, math.sin(0.4), 0, math.cos(0.4)))


def some(data: NavData) -> list[Episode]:
    tee = data.graph("tee")
    ends = [T_CORRIDOR.index(c) for c in ((0, 3), (6, 3), (3, 0))]
    return [
        replace(
            make_episode(tee, str(k), ends[k % 3], 90 * (k % 4), ends[(k + 1) % 3], "bell_1"),
            extra={"offset": k},
        )
        for k in range(5)
    ] + [make_episode(data.graph("ladder"), "5", 0, 0, 5, "telephone")]


def test_write_then_read_is_the_identity(data: NavData, tmp_path: Path) -> None:
    episodes = some(data)
    index = write_episodes(episodes, tmp_path / "replica" / "v1" / "val")
    assert index == tmp_path / "replica/v1/val/val.json.gz"
    by_name = {(e.scene, e.episode_id): e for e in episodes}
    found = read_episodes(index, data)
    assert {(e.scene, e.episode_id): e for e in found} == by_name
    assert read_episodes(index.parent, data) == found
    assert read_episodes(index.parent / "content" / "tee.json.gz", data) == episodes[:5]
    first = {p: p.read_bytes() for p in index.parent.rglob("*.gz")}
    write_episodes(episodes, index)
    assert {p: p.read_bytes() for p in index.parent.rglob("*.gz")} == first
    write_episodes(episodes[:5], index)  # a scene that is gone leaves no file behind
    assert read_episodes(index, data) == episodes[:5]


@dataclass
class NavigationEpisode:
    """Fields of Habitat's record of that name (habitat-lab 0.2.2), which is called with a file's keys."""

    episode_id: str
    scene_id: str
    start_position: list[float]
    start_rotation: list[float]
    info: dict[str, Any] | None = None
    goals: list[Any] | None = None
    start_room: str | None = None
    shortest_paths: Any = None
    scene_dataset_config: str = "default"


def test_as_habitat_and_soundspaces_load_it(data: NavData, tmp_path: Path) -> None:
    """What `AudioNavDataset.from_json` and `SoundSpacesSim` do with a file, against the exporter's graph."""
    from soundspaces_sim.dataset.exporters.points import HABITAT_HEIGHT, habitat_graph

    write_episodes(some(data), tmp_path / "train")
    graph = habitat_graph(data.dataset("tee").graph(), HABITAT_HEIGHT["replica"])
    encode = "{:.2f}_{:.2f}_{:.2f}".format
    node_at = {encode(*graph.nodes[n]["point"]): n for n in graph.nodes}
    raw = json.loads(gzip.decompress((tmp_path / "train" / "content" / "tee.json.gz").read_bytes()))
    assert json.loads(gzip.decompress((tmp_path / "train" / "train.json.gz").read_bytes())) == {
        "episodes": []
    }
    for entry, episode in zip(raw["episodes"], some(data), strict=False):
        loaded = NavigationEpisode(**entry)
        assert ("data/scene_datasets/replica/" + loaded.scene_id).split("/")[3] == "tee"
        assert node_at[encode(*loaded.start_position)] == episode.start
        assert loaded.goals and set(loaded.goals[0]) == {"position", "radius"}
        assert node_at[encode(*loaded.goals[0]["position"])] == episode.goal
        assert loaded.info and loaded.info["sound"] + ".wav" == "bell_1.wav"
        assert (
            loaded.info["geodesic_distance"] == episode.distance
            and loaded.info["num_action"] == episode.actions
        )


def broken(data: NavData, tmp_path: Path, change: Any) -> Path:
    """A file of one episode, changed."""
    path = write_episodes(some(data)[:1], tmp_path / "x").parent / "content" / "tee.json.gz"
    content = json.loads(gzip.decompress(path.read_bytes()))
    change(content["episodes"][0])
    path.write_bytes(gzip.compress(json.dumps(content).encode()))
    return path


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda e: e.update(sound="bell"), EpisodeError, "unknown field `sound`"),
        (
            lambda e: e.update(start_position=[9.0, 0.0, 0.0]),
            ss.PointError,
            r"off the graph of tee: .* m away",
        ),
        (lambda e: e["start_position"].__setitem__(1, -9.0), ss.PointError, "off the graph"),
        (lambda e: e.update(start_rotation=[0, 0.38, 0, 0.92]), ss.PointError, "multiple of 90"),
        (lambda e: e.update(scene_id="nowhere/habitat/mesh_semantic.ply"), ss.ConfigError, "no dataset"),
        (lambda e: e.update(scene_id="tea/tea.glb"), ss.ConfigError, "did you mean 'tee'"),
        (lambda e: e.update(scene_id="tee.ply"), EpisodeError, "expected <scene>/habitat"),
        (lambda e: e.update(goals=[]), EpisodeError, "expected one goal, got 0"),
        (lambda e: e["info"].pop("sound"), EpisodeError, "info.sound: expected text"),
        (
            lambda e: e["info"].update(geodesic_distance="far"),
            EpisodeError,
            "geodesic_distance: expected a number",
        ),
        (lambda e: e["info"].update(num_action=0), EpisodeError, "at least 1 action"),
        (
            lambda e: e.update(start_position=[float("nan"), 0, 0]),
            EpisodeError,
            "not a file of episodes",
        ),
    ],
)
def test_what_is_wrong_is_named(
    data: NavData, tmp_path: Path, change: Any, error: type, message: str
) -> None:
    path = broken(data, tmp_path, change)
    with pytest.raises(error, match=message) as caught:
        read_episodes(path, data)
    assert "\n" not in str(caught.value)


def test_damaged_files(data: NavData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_episodes(some(data)[:1], tmp_path / "x").parent / "content" / "tee.json.gz"
    whole = path.read_bytes()
    for content, message in (
        (whole[:-20], "breaks off"),
        (b"no gzip", "not a gzip file"),
        (gzip.compress(b'{"scenes": []}'), "not a file of episodes"),
        (gzip.compress(b'{"episodes": []}'), "holds no episode"),
    ):
        path.write_bytes(content)
        with pytest.raises(EpisodeError, match=message):
            read_episodes(path, data)
    path.write_bytes(whole)
    monkeypatch.setattr(module, "_LARGEST", 50)
    with pytest.raises(EpisodeError, match="unpacks to more than"):
        read_episodes(path, data)
    with pytest.raises(EpisodeError, match="cannot read this file"):
        read_episodes(tmp_path / "nothing", data)


def test_a_distance_that_differs_is_kept_and_told(
    data: NavData, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = broken(data, tmp_path, lambda e: e["info"].update(geodesic_distance=7.5))
    (episode,) = read_episodes(path, data)
    assert episode.distance == 7.5 and "of 1 of 1 episodes differs" in caplog.text


def test_made_episodes_keep_the_rules(data: NavData) -> None:
    episodes = make_episodes(data, "test", 60, seed=3)
    tee = data.graph("tee")
    assert len({(e.start, e.goal, e.heading) for e in episodes}) > 20
    for e in episodes:
        straight = np.linalg.norm(tee.points[e.start] - tee.points[e.goal])
        assert e.distance == tee.distance(e.start, e.goal) >= 4.0 and e.distance >= 1.1 * straight
        assert e.actions == tee.actions_to(e.goal)[4 * e.start + e.heading // 90]
    assert make_episodes(data, "test", 60, seed=3) == episodes != make_episodes(data, "test", 60, seed=4)


def test_no_pair_is_left(data: NavData) -> None:
    with pytest.raises(EpisodeError, match=r"closer than 40 m \(the longest way is 6 m\)"):
        make_episodes(data, "test", 1, min_distance=40.0)
    with pytest.raises(EpisodeError, match=r"less than 1\.5 times the straight line"):
        make_episodes(data, "test", 1, min_ratio=1.5)
    with pytest.raises(EpisodeError, match="below the dry sound"):
        make_episodes(data, "test", 1, audible_db=30.0)
    with pytest.raises(ss.ConfigError, match=r"split 'tset'.*did you mean 'test'"):
        make_episodes(data, "tset", 1)


def test_splits_share_no_scene(data: NavData, tmp_path: Path) -> None:
    for name in ("tee", "ladder"):
        (tmp_path / name).symlink_to(data.root / name)
    assert NavData(tmp_path).splits == {"train": ("ladder", "tee")}
    table = tmp_path / "splits.toml"
    for text, message in (
        ('train = ["tee"]\ntest = ["tee"]', "in the splits 'train' and 'test'"),
        ('train = ["teee"]', "did you mean 'tee'"),
        ("train = 3", "expected a list of scenes"),
        ("", "at least one split"),
        ("train = [", "not valid TOML"),
    ):
        table.write_text(text)
        with pytest.raises(ss.ConfigError, match=message):
            NavData(tmp_path)
    with pytest.raises(ss.DatasetError, match="no dataset"):
        NavData(tmp_path / "empty")


def _file(path: Path, text: bytes) -> Path:
    path.write_bytes(gzip.compress(text, 1))
    return path


def _record(data: NavData, **change: Any) -> bytes:
    return json.dumps({**module._as_json(some(data)[0]), **change}).encode()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"episode_id": "x" * 10**6}, r"episode_id: 1,000,000 characters, where 1,000 are the most"),
        ({"scene_id": "x" * 10**6}, r"scene_id: 1,000,000 characters"),
        ({"info": {"geodesic_distance": 1.0, "num_action": 1, "sound": "x" * 10**6}}, r"info\.sound: 1,000,000"),
        ({"info": {"geodesic_distance": "x" * 10**6, "num_action": 1, "sound": "x"}}, r"geodesic_distance: expected"),
    ],
)  # fmt: skip
def test_texts_without_end(data: NavData, tmp_path: Path, change: dict[str, Any], words: str) -> None:
    path = _file(tmp_path / "x.json.gz", b'{"episodes":[' + _record(data, **change) + b"]}")
    with pytest.raises(EpisodeError, match=words) as caught:
        read_episodes(path, data)
    assert len(str(caught.value)) < 1000


def test_episodes_nested_without_end(data: NavData, tmp_path: Path) -> None:
    deep = b"[" * 10**5 + b"]" * 10**5
    for text in (
        deep,
        b'{"episodes":' + deep + b"}",
        b'{"episodes":[' + _record(data).replace(b"null", deep, 1) + b"]}",
        b'{"more":' + deep + b',"episodes":[]}',
    ):
        with pytest.raises(EpisodeError, match="not a file of episodes"):
            read_episodes(_file(tmp_path / "x.json.gz", text), data)


def test_tiny_values_are_counted_before_they_are_made(
    data: NavData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_MOST_VALUES", 1_000_000)
    many = b"[" + b"[]," * 700_000 + b"[]]"
    text = b'{"episodes":[' + _record(data).replace(b"null", many, 1) + b"]}"
    path = _file(tmp_path / "x.json.gz", text)
    tracemalloc.start()
    try:
        with pytest.raises(EpisodeError, match=r"holds some 1,4.* values, where 1,000,000 are"):
            read_episodes(path, data)
        assert tracemalloc.get_traced_memory()[1] < 4 * len(text)
    finally:
        tracemalloc.stop()


def test_a_split_of_too_many_episodes(
    data: NavData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_MOST_EPISODES", 3)
    index = write_episodes(some(data), tmp_path / "v1" / "val")
    with pytest.raises(EpisodeError, match="a split of more than 3 episodes"):
        read_episodes(index, data)
