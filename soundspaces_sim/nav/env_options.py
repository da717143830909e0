"""Options of an environment: one record for a single agent and for many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from soundspaces_sim.core.keywords import check_keywords
from soundspaces_sim.nav.audio_sensor import Cache
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episodes import Episode
from soundspaces_sim.nav.sounds import DEFAULT, SoundBank
from soundspaces_sim.nav.task import TaskOptions, as_sensors


@dataclass(frozen=True, kw_only=True)
class EnvOptions(TaskOptions):
    """Options of `AudioNavEnv` and `AudioNavVectorEnv`. Raises `ConfigError`.

    Parameters
    ----------
    data : folder of datasets, with `splits.toml`, or `NavData`
    split : whose scenes (and, of a bank's split, whose sounds)
    episodes : file or folder of a split, or a list; None draws new ones. Of several, each reset takes one by lot
    sounds : name of a sound; 'train', 'val', 'test': those of that split; a list; a folder of files (those of
        `split`); a `SoundBank`. Only of drawn episodes: others say what sounds
    sensors : names; None: those of the task. See `task.SENSORS`, docs/navigation.md
    max_steps : truncates
    success_radius : m from the goal within which STOP is right; 0: exactly there
    gps_sigma : standard deviation of both components of the displacement to the goal, m
    snr_db : of white noise in what is heard, re its own RMS; None: none
    depth_size : pixels per side
    ears : 'mono' gives both ears their mean (of waveforms, of spectrograms, of power): no direction is heard
    pad_mode : how spectrograms go on beyond a second: 'constant' zeros (librosa from 0.10 on), 'reflect' as before,
        which agents trained on SoundSpaces' observations of then expect; spectrograms baked on disk do not serve it
    distance_reward : 'metre' per m nearer (SoundSpaces' code), 'step' ±1 per edge (the paper's words)
    cache : 'memory', 'disk', 'none', see `AudioSensor`
    """

    data: str | Path | NavData
    split: str = "train"
    episodes: str | Path | Sequence[Episode] | None = None
    sounds: str | Path | Sequence[str] | SoundBank = DEFAULT
    cache: Cache = "memory"


def env_options(what: str, data: str | Path | NavData, given: Mapping[str, Any]) -> EnvOptions:
    """The options of environment `what`. Raises `ConfigError`, also for names that are no option."""
    check_keywords(what, given, [field.name for field in fields(EnvOptions)])
    return EnvOptions(data=data, **{**given, "sensors": as_sensors(given.get("sensors"))})
