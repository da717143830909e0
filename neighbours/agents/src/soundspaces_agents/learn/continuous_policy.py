"""A small recurrent network that walks by cues of hearing in continuous space, and the agent that acts by it."""

from __future__ import annotations

import math

import numpy as np
import torch
from soundspaces_continuous import ContinuousState
from torch import Tensor, nn

from soundspaces_agents.learn.cues import CUES, ear_cues
from soundspaces_agents.learn.net import ACTIONS, MOVES
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import STOP

INPUTS = CUES + 5 + MOVES
SENSORS = ("audiogoal", "pose", "collision")
_WIDTH, _WHERE = 128, 3


def inputs_of(observation: dict[str, np.ndarray], last: int | None, rate: int) -> np.ndarray:
    """(INPUTS,) float32 of an observation: cues of what is heard, pose since the beginning, whether it bumped, and
    the `last` action, None at first."""
    pose, move = observation["pose"], np.zeros(MOVES, np.float32)
    bumped = bool(observation["collision"][0])
    move[0 if last is None else last + 1 + 3 * (last == 1 and bumped)] = 1.0
    turn = float(pose[2])
    own = pose[0] / 10.0, pose[1] / 10.0, math.cos(turn), math.sin(turn), pose[3] / 100.0
    return np.concatenate([ear_cues(observation["audiogoal"], rate), np.array(own, np.float32), move])


class ContinuousPolicy(nn.Module):
    """Inputs (t, n, INPUTS) through a layer and a GRU to logits of actions (t, n, 4), and, as auxiliary outputs,
    the way to the goal (t, n, 3): cosine and sine of its direction, log(1 + length / m)."""

    def __init__(self) -> None:
        super().__init__()
        self.enter = nn.Sequential(nn.Linear(INPUTS, _WIDTH), nn.ReLU())
        self.gru = nn.GRU(_WIDTH, _WIDTH)
        self.actor, self.where = nn.Linear(_WIDTH, ACTIONS), nn.Linear(_WIDTH, _WHERE)

    def forward(self, inputs: Tensor, hidden: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """(Logits, where, hidden (1, n, width))."""
        memory, hidden = self.gru(self.enter(inputs), hidden)
        return self.actor(memory), self.where(memory), hidden


def draw(logits: Tensor, generator: torch.Generator) -> Tensor:
    """(n,) actions by logits (n, 4): STOP where it is the most probable, for it cannot be taken back; else one of
    the others, by the squares of their probabilities, for an agent that wavers between left and right stays where
    it is."""
    moves = torch.softmax(2.0 * logits, dim=1)
    moves[:, STOP] = 0.0
    drawn = torch.multinomial(moves + 1e-9 * (torch.arange(ACTIONS) != STOP), 1, generator=generator)[
        :, 0
    ]
    return torch.where(logits.argmax(dim=1) == STOP, torch.full_like(drawn, STOP), drawn)


class ContinuousAgent:
    """Acts as a `ContinuousPolicy` says: `draw`."""

    def __init__(self, policy: ContinuousPolicy, name: str, rate: int) -> None:
        self.policy, self.name, self.rate = policy.eval(), name, rate

    def reset(self, state: ContinuousState, seed: int) -> None:
        """Forget. Raises `ConfigError` for an agent without its sensors."""
        missing = [s for s in SENSORS if s not in state.options.sensors]
        if missing:
            raise ConfigError(f"{self.name}: add the sensors {', '.join(missing)}")
        self.generator = torch.Generator().manual_seed(seed)
        self.hidden: Tensor | None = None
        self.last: int | None = None

    @torch.no_grad()
    def act(self, observation: dict[str, np.ndarray]) -> int:
        """The next action."""
        inputs = torch.from_numpy(inputs_of(observation, self.last, self.rate))[None, None]
        logits, _, self.hidden = self.policy(inputs, self.hidden)
        self.last = int(draw(logits[0], self.generator)[0])
        return self.last
