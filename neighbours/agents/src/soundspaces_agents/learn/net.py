"""The network: what is seen and heard through convolutions, remembered by a GRU, to an action and a value.

After AV-Nav (Chen et al. 2020): one encoder per sense, their features and the goal's direction side by side.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from soundspaces_agents.presets import NetConfig
from soundspaces_sim.parts import POINTGOAL, STOP

Observations = Mapping[str, Tensor]
ACTIONS = 4
MOVES = 6  # nothing yet, STOP, FORWARD, LEFT, RIGHT, FORWARD into a wall
_SHORT = 30  # frames of a spectrogram below which kernels are smaller
_VECTORS = {POINTGOAL: 2, "intensity": 2}
_FLOOR = 1e-6  # of intensities: 120 dB below full scale
_SPREAD_DB = 6.0  # that the two ears of a head differ by, as a rule


class Encoder(nn.Sequential):
    """Pictures (n, height, width, channels) to features (n, features)."""

    def __init__(
        self,
        shape: tuple[int, ...],
        channels: tuple[int, ...],
        kernels: tuple[int, ...],
        strides: tuple[int, ...],
        features: int,
    ) -> None:
        layers: list[nn.Module] = []
        height, width, before = shape
        for out, kernel, stride in zip(channels, kernels, strides, strict=True):
            layers += [nn.Conv2d(before, out, kernel, stride), nn.ReLU(inplace=True)]
            height, width, before = (height - kernel) // stride + 1, (width - kernel) // stride + 1, out
        layers += [nn.Flatten(), nn.Linear(height * width * before, features), nn.ReLU(inplace=True)]
        super().__init__(*layers)
        for name, weight in self.named_parameters():
            if name.endswith("bias"):
                nn.init.zeros_(weight)
            else:
                nn.init.kaiming_normal_(weight, nonlinearity="relu")
        for layer in layers:  # as pictures come: the faster order
            layer.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, pictures: Tensor) -> Tensor:
        return super().forward(pictures.permute(0, 3, 1, 2))


class LoudnessEncoder(nn.Sequential):
    """Intensities (n, 2) of the ears to features: of their level, and of their difference, which two numbers beside
    a hundred features of a picture hardly show: 3 dB between the ears are 0.05 of the level's scale."""

    def __init__(self, features: int) -> None:
        super().__init__(nn.Linear(2, features), nn.ReLU(inplace=True))
        nn.init.kaiming_normal_(self[0].weight, nonlinearity="relu")
        nn.init.zeros_(self[0].bias)

    def forward(self, intensities: Tensor) -> Tensor:
        left, right = torch.log10(intensities + _FLOOR).unbind(dim=1)
        level, difference = (left + right) / 6.0 + 1.0, (left - right) * (20.0 / _SPREAD_DB)
        return super().forward(torch.stack([level, difference], dim=1))


class Policy(nn.Module):
    """`shapes`: of each sensor's observation, without batch. Hidden states are (n, hidden), zero at a start."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]], config: NetConfig) -> None:
        super().__init__()
        self.shapes, self.config = dict(shapes), config
        self.encoders = nn.ModuleDict()
        if "spectrogram" in shapes:
            short = shapes["spectrogram"][1] < _SHORT
            kernels, strides = ((5, 3, 3), (2, 2, 1)) if short else ((8, 4, 3), (4, 2, 1))
            self.encoders["spectrogram"] = Encoder(
                shapes["spectrogram"], config.channels, kernels, strides, config.features
            )
        if "depth" in shapes:
            self.encoders["depth"] = Encoder(
                shapes["depth"],
                config.channels,
                config.depth_kernels,
                config.depth_strides,
                config.features,
            )
        self.loudness = (
            LoudnessEncoder(config.loudness) if config.loudness and "intensity" in shapes else None
        )  # no entry of `encoders`: it learns in every update
        self.vectors = [s for s in _VECTORS if s in shapes]
        size = config.features * len(self.encoders) + MOVES * config.moves
        size += sum(self._width(s) for s in self.vectors)
        self.gru = nn.GRU(size, config.hidden)
        self.actor, self.critic = nn.Linear(config.hidden, ACTIONS), nn.Linear(config.hidden, 1)
        for name, weight in self.gru.named_parameters():
            if name.startswith("weight"):
                nn.init.orthogonal_(weight)
            else:
                nn.init.zeros_(weight)
        for layer, gain in ((self.actor, 0.01), (self.critic, 1.0)):
            nn.init.orthogonal_(layer.weight, gain)
            nn.init.zeros_(layer.bias)
        with torch.no_grad():
            self.actor.bias[STOP] = config.stop_bias

    def _width(self, vector: str) -> int:
        """Numbers that the memory is fed of a sensor without pictures."""
        if vector == "intensity" and self.loudness is not None:
            return self.config.loudness
        return 3 if self.config.tidy and vector == POINTGOAL else _VECTORS[vector]

    def start(self, count: int) -> Tensor:
        """Hidden states of `count` agents that remember nothing."""
        return torch.zeros(count, self.config.hidden)

    def features(
        self, observations: Observations, moves: Tensor, encoded: Observations | None = None
    ) -> Tensor:
        """(n, size) what the memory is fed; `moves` (n,): see `MOVES`; `encoded` (n, features): what encoders made
        of some of the sensors, whose observations are not asked for."""
        made = encoded or {}
        parts = [
            made[name] if name in made else encoder(observations[name])
            for name, encoder in self.encoders.items()
        ]
        for name in self.vectors:
            values = observations[name]
            if name == "intensity" and self.loudness is not None:
                values = self.loudness(values)
            elif self.config.tidy and name == POINTGOAL:
                angle = values[:, 1:]
                values = torch.cat([values[:, :1] / 10.0, torch.cos(angle), torch.sin(angle)], dim=1)
            elif self.config.tidy:
                values = torch.log10(values + _FLOOR) / 3.0 + 1.0
            parts.append(values)
        if self.config.moves:
            parts.append(nn.functional.one_hot(moves, MOVES).float())
        return torch.cat(parts, dim=1)

    def step(
        self,
        observations: Observations,
        moves: Tensor,
        hidden: Tensor,
        encoded: Observations | None = None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """(logits (n, 4), values (n,), hidden (n, h)) after one observation each; `encoded`: see `features`."""
        memory, _ = self.gru(self.features(observations, moves, encoded)[None], hidden[None])
        hidden = memory[0]
        return self.actor(hidden), self.critic(hidden).squeeze(1), hidden

    def sequence(
        self,
        observations: Observations,
        moves: Tensor,
        starts: Tensor,
        hidden: Tensor,
        encoded: Observations | None = None,
    ) -> tuple[Tensor, Tensor]:
        """(logits (t, n, 4), values (t, n)) of observations (t, n, …). `starts` (t, n): an episode begins there,
        and the memory (n, h) is emptied; `encoded` (t, n, features): see `features`."""
        t, n = starts.shape
        flat, made = (
            {name: values.reshape(t * n, *values.shape[2:]) for name, values in inputs.items()}
            for inputs in (observations, encoded or {})
        )
        features = self.features(flat, moves.reshape(t * n), made)
        memory = run_memory(self.gru, features.reshape(t, n, -1), starts, hidden)
        return self.actor(memory), self.critic(memory).squeeze(2)


def run_memory(gru: nn.GRU, inputs: Tensor, starts: Tensor, hidden: Tensor) -> Tensor:
    """(t, n, h) states of `gru` over inputs (t, n, size) from `hidden` (n, h), emptied where `starts` (t, n) is 1.

    PyTorch's own call knows no resets within a sequence; packed sequences, which begin anew at resets, took half as
    long again. Inputs of all steps are projected at once; equations as in PyTorch's documentation of `nn.GRU`.
    """
    t, n, _ = inputs.shape
    of_input, of_memory, input_bias, memory_bias = gru.all_weights[0]
    projected = nn.functional.linear(inputs.reshape(t * n, -1), of_input, input_bias)
    go_on = (1.0 - starts).unsqueeze(2).unbind()
    resets = starts.any(dim=1).tolist()
    size = gru.hidden_size
    states = []
    for row, keep, some in zip(projected.reshape(t, n, -1).unbind(), go_on, resets, strict=True):
        before = hidden * keep if some else hidden
        own = nn.functional.linear(before, of_memory, memory_bias)
        gates = torch.sigmoid(row[:, : 2 * size] + own[:, : 2 * size])
        reset, update = gates.chunk(2, dim=1)
        new = torch.tanh(torch.addcmul(row[:, 2 * size :], reset, own[:, 2 * size :]))
        hidden = torch.lerp(new, before, update)
        states.append(hidden)
    return torch.stack(states)


def moves_of(actions: Tensor, collided: Tensor, starts: Tensor) -> Tensor:
    """(n,) rows of `MOVES`: what an agent knows of its last action, collision included."""
    moves = actions + 1 + 3 * ((actions == 1) & collided.bool()).long()
    return torch.where(starts.bool(), torch.zeros_like(moves), moves)
