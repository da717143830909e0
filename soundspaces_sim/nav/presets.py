"""How agents are trained: networks and numbers, each set under a name.

`paper` has the network and the numbers of SoundSpaces' code (AV-Nav). `small` learns in minutes on two cores;
`quick` is a glimpse of it by DAgger.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.nav.data import nearest


@dataclass(frozen=True)
class NetConfig:
    """Convolutions have `channels`; what they give goes through a linear layer of `features`; a GRU of `hidden`
    units remembers. `depth_kernels`, `depth_strides` and the same of the ears; those of short spectrograms
    (below 30 frames) are 5-3-3 and 2-2-1. `moves`: the previous action, or a collision, is an input. `tidy`:
    intensities in dB and directions as sine and cosine instead of raw numbers. `stop_bias`: at the start."""

    channels: tuple[int, int, int] = (32, 64, 64)
    depth_kernels: tuple[int, int, int] = (8, 4, 3)
    depth_strides: tuple[int, int, int] = (4, 2, 2)
    features: int = 512
    hidden: int = 512
    moves: bool = False
    tidy: bool = False
    stop_bias: float = 0.0


@dataclass(frozen=True)
class TrainConfig:
    """PPO (Schulman et al. 2017) with generalised advantages; `envs` × `steps` make an update, `updates` a run.

    `anneal`: learning rate and clip range fall linearly to zero. `bootstrap`: an episode that is cut off by
    `max_steps` is valued at its end. DAgger uses `envs`, `steps`, `updates`, `minibatches`, `epochs`,
    `learning_rate` and `max_norm`; `oracle_share` of updates pass until only the agent itself acts.
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


_SMALL = TrainConfig(
    net=NetConfig(
        channels=(16, 32, 32),
        depth_kernels=(5, 3, 3),
        depth_strides=(2, 2, 1),
        features=128,
        hidden=128,
        moves=True,
        tidy=True,
        stop_bias=-3.0,
    ),
    envs=64,
    steps=64,
    updates=366,
    minibatches=4,
    epochs=3,
    learning_rate=5e-4,
    clip=0.2,
    clip_value=False,
    entropy_weight=0.02,
    bootstrap=True,
    max_steps=200,
    depth_size=32,
)

#: 366 updates of 64 × 64 steps are 1.5 million.
PRESETS: dict[str, TrainConfig] = {
    "paper": TrainConfig(),
    "small": _SMALL,
    "quick": replace(_SMALL, updates=30),
}


def preset(name: str) -> TrainConfig:
    """A set of numbers by its name. Raises `ConfigError`."""
    if name not in PRESETS:
        raise ConfigError(
            f"preset: expected one of {', '.join(PRESETS)}, got '{name}'{nearest(name, PRESETS)}"
        )
    return PRESETS[name]
