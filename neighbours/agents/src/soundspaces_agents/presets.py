"""How agents are trained: networks and numbers by name; presets.toml has them, and where each is from.

`paper` has the network and the numbers of SoundSpaces' code (AV-Nav). `small` learns in minutes on two cores;
`quick` is a glimpse of it by DAgger.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import msgspec

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import nearest_name as nearest


@dataclass(frozen=True)
class NetConfig:
    """Convolutions have `channels`; what they give goes through a linear layer of `features`; a GRU of `hidden`
    units remembers. `depth_kernels`, `depth_strides` and the same of the ears; those of short spectrograms
    (below 30 frames) are 5-3-3 and 2-2-1. `moves`: the previous action, or a collision, is an input. `tidy`:
    intensities in dB and directions as sine and cosine instead of raw numbers. `stop_bias`: at the start.
    `loudness`: features of an encoder of the two intensities' level and difference, 0: they go into the memory as
    two numbers."""

    channels: tuple[int, int, int] = (32, 64, 64)
    depth_kernels: tuple[int, int, int] = (8, 4, 3)
    depth_strides: tuple[int, int, int] = (4, 2, 2)
    features: int = 512
    hidden: int = 512
    moves: bool = False
    tidy: bool = False
    stop_bias: float = 0.0
    loudness: int = 0


@dataclass(frozen=True)
class TrainConfig:
    """PPO (Schulman et al. 2017) with generalised advantages; `envs` × `steps` make an update, `updates` a run.

    `anneal`: learning rate and clip range fall linearly to zero. `bootstrap`: an episode that is cut off by
    `max_steps` is valued at its end. DAgger uses `envs`, `steps`, `updates`, `minibatches`, `epochs`,
    `learning_rate` and `max_norm`; `oracle_share` of updates pass until only the agent itself acts.
    `scale_rewards`: by the spread of returns so far. `warm_batches`: by which encoders are taught before
    agents walk, of `warm_batch` states each, at `warm_rate`; they then learn in the last `finetune`
    updates alone, at `finetune_rate`. With 0 of them encoders learn in every update, from nothing.
    """

    net: NetConfig = NetConfig()
    envs: int = 5
    steps: int = 150
    updates: int = 40_000
    minibatches: int = 1
    epochs: int = 4
    learning_rate: float = 2.5e-4
    adam_eps: float = 1e-5
    clip: float = 0.1
    clip_value: bool = True
    anneal: bool = True
    gamma: float = 0.99
    lam: float = 0.95
    value_weight: float = 0.5
    entropy_weight: float = 0.20
    max_norm: float = 0.5
    bootstrap: bool = False
    max_steps: int = 500
    depth_size: int = 128
    oracle_share: float = 0.5
    scale_rewards: bool = False
    warm_batches: int = 0
    warm_rate: float = 1e-3
    warm_batch: int = 512
    finetune: int = 0
    finetune_rate: float = 1e-4


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(files(__package__).joinpath("presets.toml").read_text("utf-8"))


#: Names of the tables of presets.toml.
PRESETS = tuple(_tables())


def preset(name: str) -> TrainConfig:
    """A set of numbers by its name. Raises `ConfigError`."""
    if name not in PRESETS:
        raise ConfigError(
            f"preset: expected one of {', '.join(PRESETS)}, got '{name}'{nearest(name, PRESETS)}"
        )
    return msgspec.convert(_values(name), TrainConfig)


def _values(name: str) -> dict[str, Any]:
    """Numbers of a table, those of the table that it is like included; what says where they are from left out."""
    table = dict(_tables()[name])
    like = table.pop("like", None)
    base = _values(like) if like else {}
    table.pop("source")
    return {**base, **table}


def sources(name: str) -> dict[str, str]:
    """Where each number of a preset is from, by its name. Raises `ConfigError`."""
    preset(name)
    table = _tables()[name]
    like = table.get("like")
    return {**(sources(like) if like else {}), **table["source"]}
