"""Semantic episodes, as SoundSpaces publishes them, and spectrograms as its agents were trained with."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
import soundspaces_sim.nav as nav
from soundspaces_sim.core.errors import EpisodeError
from soundspaces_sim.nav.audio_sensor import bake_sound
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episodes import Semantic, make_episode, read_episodes, write_episodes
from soundspaces_sim.nav.sounds import SoundBank
from tests.nav.conftest import T_CORRIDOR

ENDS = [T_CORRIDOR.index(c) for c in ((0, 3), (6, 3))]
STATE = {"position": [1.0, 0.0, -2.0], "rotation": [0.0, 0.0, 0.0, 1.0]}


def published(
    data: NavData, tmp_path: Path, change: Callable[[dict[str, Any]], None] = lambda _: None
) -> Path:
    """A file with the keys that SoundSpaces' SemanticAudioGoalNavEpisode and SemanticAudioGoal take."""
    plain = make_episode(data.graph("tee"), "0", ENDS[0], 0, ENDS[1], "telephone")
    index = write_episodes([plain], tmp_path / "val")
    content = index.parent / "content" / "tee.json.gz"
    raw = json.loads(gzip.decompress(content.read_bytes()))
    (episode,) = raw["episodes"]
    episode |= {"object_category": "chair", "sound_id": "telephone.wav", "offset": 3, "duration": 2,
                "distractor_sound_id": None, "distractor_position_index": None}  # fmt: skip
    del episode["info"]["sound"]  # what sounds stands in sound_id
    episode["goals"][0] |= {"object_id": "17", "object_name": "chair_17", "object_category": "chair", "room_id": "4",
                            "room_name": "bedroom", "view_points": [STATE]}  # fmt: skip
    change(episode)
    content.write_bytes(gzip.compress(json.dumps(raw).encode()))
    return index


def test_semantic_episodes_are_read_and_written(data: NavData, tmp_path: Path) -> None:
    (episode,) = read_episodes(published(data, tmp_path), data)
    assert episode.sound == "telephone" and (episode.start, episode.goal) == tuple(ENDS)
    assert episode.semantic == Semantic(
        "chair", 2, 3,
        {"object_id": "17", "object_name": "chair_17", "object_category": "chair", "room_id": "4",
         "room_name": "bedroom", "view_points": [STATE]},
    )  # fmt: skip
    again = write_episodes([episode], tmp_path / "again")
    assert read_episodes(again, data) == [episode]
    raw = json.loads(gzip.decompress((again.parent / "content" / "tee.json.gz").read_bytes()))[
        "episodes"
    ][0]
    assert (
        raw["object_category"] == "chair" and raw["sound_id"] == "telephone.wav" and raw["duration"] == 2
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda e: e.pop("duration"), "duration: missing; a semantic episode has object_category, sound_id, duration"),
        (lambda e: e.update(duration=-1), "duration: expected 0 to 1,000,000 steps, got -1"),
        (lambda e: e.update(distractor_sound_id="tv.wav"), "distractor_sound_id: expected null, got 'tv.wav'"),
        (lambda e: e.update(loudness=3), "unknown field `loudness`"),
        (lambda e: e["goals"][0].update(colour="red"), "unknown field `colour`"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_semantic_episode_is_named(
    data: NavData, tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    with pytest.raises(EpisodeError, match=message):
        read_episodes(published(data, tmp_path, change), data)


def test_the_object_falls_silent_after_its_duration(data: NavData, tmp_path: Path) -> None:
    """Its simulator compares the count of steps: with duration 2 observations 0, 1 and 2 sound, later ones do not."""
    index = published(data, tmp_path)
    sensors = ["spectrogram", "audiogoal", "intensity"]
    env = nav.AudioNavEnv(data, episodes=index, sensors=sensors)
    observation, _ = env.reset(seed=0)
    heard = [observation]
    for _ in range(4):
        heard.append(env.step(2)[0])  # turns: the agent stays where it is
    for name in sensors:
        loud = [bool(np.abs(o[name]).max() > 0.0) for o in heard]
        assert loud == [True, True, True, False, False], name


def test_padding_of_spectrograms(data: NavData, tmp_path: Path) -> None:
    """librosa before 0.10 reflects the signal at both ends, which agents trained then have seen."""
    root = tmp_path / "own"
    shutil.copytree(data.dataset("tee").path, root / "tee")
    own = NavData(root)
    bake_sound(own.dataset("tee"), SoundBank(own.dataset("tee").rate), "telephone", [ENDS[1]])
    episode = make_episode(own.graph("tee"), "0", ENDS[0], 0, ENDS[1], "telephone")
    found = {}
    for mode in ("constant", "reflect"):
        for cache in ("memory", "disk", "none"):
            env = nav.AudioNavEnv(
                own,
                episodes=[episode],
                sensors=["spectrogram", "audiogoal"],
                cache=cache,
                pad_mode=mode,
            )
            alone = nav.AudioNavEnv(
                own, episodes=[episode], sensors=["spectrogram"], cache=cache, pad_mode=mode
            )
            observation = env.reset(seed=0)[0]
            rate = own.dataset("tee").rate
            want = ss.spectrogram(observation["audiogoal"], rate, pad_mode=mode).astype(np.float16)
            np.testing.assert_array_equal(observation["spectrogram"], want.astype(np.float32))
            np.testing.assert_array_equal(alone.reset(seed=0)[0]["spectrogram"], want.astype(np.float32))
            found[mode] = want
    assert np.abs(found["constant"][:, 0] - found["reflect"][:, 0]).max() > 0.0
    with pytest.raises(ss.ConfigError, match="pad_mode: expected constant or reflect, got 'edge'"):
        nav.AudioNavEnv(own, pad_mode="edge")
