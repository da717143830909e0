"""Replays: an episode as a GIF of the map, with what is seen and heard, and a WAV of it."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from soundspaces_pictures.episode_map import MapPage

from soundspaces_sim.nav import Episode, Metrics
from soundspaces_sim.parts import Agent, EpisodeState, make_folder, publish_file as publish, wav_bytes


@dataclass(frozen=True)
class Replay:
    """Where a replay lies, and how the episode went. `trail`: states."""

    gif: Path
    wav: Path
    metrics: Metrics
    trail: tuple[int, ...]


def write_replay(
    agent: Agent, env: Any, episode: Episode, out: Path, name: str, seed: int = 0
) -> Replay:
    """Walk one episode and write ``<name>.gif`` and ``<name>.wav``, one second per action, into a folder."""
    from PIL import Image

    logging.getLogger("PIL").setLevel(logging.WARNING)
    make_folder(out)
    base = env.unwrapped
    observation, _ = env.reset(seed=seed, options={"episode": episode})
    state: EpisodeState = base.state
    agent.reset(state, seed)
    ds = base.setting.data.dataset(episode.scene)
    page = MapPage(ds, episode.goal, perceived=True)
    audio = base.setting.sensor_suite.audio(episode.scene)
    frames, heard = [], []
    while True:
        frames.append(Image.fromarray(page.draw(state, base.trail, observation)))
        second = state.steps % audio.seconds(episode.sound)
        ears = audio.ears(episode.sound, episode.goal, state.node, second, (state.pose & 3,))[0]
        heard.append(np.zeros_like(ears) if state.silent else ears)
        if state.over:
            break
        observation, *_ = env.step(agent.act(observation))
    gif, wav = out / f"{name}.gif", out / f"{name}.wav"
    frames[0].save(gif, save_all=True, append_images=frames[1:], duration=1000, loop=0)
    sound = np.concatenate(heard, axis=1)
    publish(wav, wav_bytes(0.9 * sound / max(float(np.abs(sound).max()), 1e-30), ds.rate))
    return Replay(gif, wav, state.metrics(), tuple(base.trail))
