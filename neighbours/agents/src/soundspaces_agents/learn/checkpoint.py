"""Checkpoints: a trained network with what it needs to know of its task; and the agent that acts by it."""

from __future__ import annotations

import io
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

from soundspaces_agents.learn.net import Policy, moves_of
from soundspaces_agents.presets import NetConfig
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import EpisodeState, Observation, publish_file as publish, read_bytes

_FORMAT = "soundspaces_sim/agent-1"
_MOST = 2**31  # bytes
#: Names of weights in checkpoints of version 0.1, whose memory was one cell.
_BEFORE = {f"gru.{part}": f"gru.{part}_l0" for part in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")}


def save_checkpoint(
    path: Path, policy: Policy, name: str, learner: dict[str, Any] | None = None
) -> None:
    """Publish a network, and, to go on with, what its learner was at."""
    content = {
        "format": _FORMAT,
        "name": name,
        "net": asdict(policy.config),
        "shapes": {k: list(v) for k, v in policy.shapes.items()},
        "weights": policy.state_dict(),
        "learner": learner or {},
    }
    buffer = io.BytesIO()
    torch.save(content, buffer)
    publish(path, buffer.getvalue())


def read_checkpoint(path: Path) -> dict[str, Any]:
    """What `save_checkpoint` wrote; nothing in it is run. Raises `ConfigError`."""
    try:
        content = load(path, "checkpoint of an agent")
    except ConfigError:
        raise
    except Exception as error:  # whatever torch meets in a damaged archive
        raise ConfigError(f"{path}: not a checkpoint of an agent that can be read ({error})") from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise ConfigError(f"{path}: not a checkpoint of an agent (expected {_FORMAT})")
    return content


def load(path: Path, what: str) -> Any:
    """What `torch.save` wrote: nothing in it is run, and it takes no more memory than the file has bytes. Raises
    `ConfigError` for a file that can be none, and whatever torch meets in a damaged one."""
    data = read_bytes(path, ConfigError, what, _MOST)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
    except Exception as error:  # zipfile raises whatever it met
        raise ConfigError(f"{path}: not a {what} that can be read ({error})") from error
    packed = any(e.compress_type != zipfile.ZIP_STORED for e in entries)
    if packed or sum(e.file_size for e in entries) > len(data):
        raise ConfigError(f"{path}: not a {what}: its parts are packed, or overlap")
    return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)


def policy_of(content: dict[str, Any], path: Path) -> Policy:
    """The network of a checkpoint. Raises `ConfigError`."""
    try:
        net = msgspec.convert(content["net"], NetConfig)
        shapes = msgspec.convert(content["shapes"], dict[str, tuple[int, ...]])
        with torch.device("meta"):  # no memory is taken for sizes that the weights do not have
            plan = {name: value.shape for name, value in Policy(shapes, net).state_dict().items()}
        weights = {_BEFORE.get(name, name): value for name, value in content["weights"].items()}
        found = {name: value.shape for name, value in weights.items()}
        if found != plan:
            raise ValueError("its weights have other sizes than its network")
        held = {w.untyped_storage().data_ptr(): w.untyped_storage().nbytes() for w in weights.values()}
        if sum(w.numel() * w.element_size() for w in weights.values()) > sum(held.values()):
            raise ValueError("its weights stand for more numbers than it holds")
        policy = Policy(shapes, net)
        policy.load_state_dict(weights)
    except Exception as error:  # as above: torch raises whatever it met
        raise ConfigError(
            f"{path}: the network of this checkpoint is not one of this version ({error})"
        ) from error
    return policy


class TrainedAgent:
    """Acts as a network says, actions drawn by their probabilities, as in SoundSpaces' code."""

    def __init__(self, policy: Policy, name: str, device: str = "cpu") -> None:
        self.policy, self.name, self.device = policy.to(device).eval(), name, device

    def reset(self, state: EpisodeState, seed: int) -> None:
        """Forget; raises `ConfigError` if the episode's agent lacks the sensors that this one was trained with."""
        missing = [s for s in self.policy.shapes if s not in state.task.sensors]
        if missing:
            raise ConfigError(
                f"agent '{self.name}' was trained with the sensors {', '.join(self.policy.shapes)}; this "
                f"environment has {', '.join(state.task.sensors)}: give it sensors={list(self.policy.shapes)!r}"
            )
        self.state, self.generator = state, torch.Generator().manual_seed(seed)
        self.hidden = self.policy.start(1).to(self.device)
        self.last: torch.Tensor | None = None

    def act(self, observation: Observation) -> int:
        """The next action. Raises `ConfigError` for observations of another size."""
        chances, self.hidden = self._decide(observation)
        self.last = torch.multinomial(chances, 1, generator=self.generator)[0]
        return int(self.last[0])

    def chances(self, observation: Observation) -> np.ndarray:
        """(4,) probabilities of actions on an observation, if it were the next; nothing is remembered of it."""
        return np.asarray(self._decide(observation)[0][0].numpy())

    @torch.no_grad()
    def _decide(self, observation: Observation) -> tuple[torch.Tensor, torch.Tensor]:
        """(1, 4) probabilities, and what is remembered."""
        for name, shape in self.policy.shapes.items():
            if observation[name].shape != tuple(shape):
                raise ConfigError(
                    f"agent '{self.name}' was trained with {name} of shape {tuple(shape)}, this environment gives "
                    f"{observation[name].shape}: check depth_size and the datasets' rate"
                )
        seen = {
            name: torch.from_numpy(observation[name])[None].to(self.device)
            for name in self.policy.shapes
        }
        moves = torch.zeros(1, dtype=torch.long)
        if self.last is not None:
            bumped = torch.tensor(
                [bool(observation["collision"][0]) if "collision" in observation else False]
            )
            moves = moves_of(self.last, bumped, torch.zeros(1))
        logits, _, hidden = self.policy.step(seen, moves.to(self.device), self.hidden)
        return torch.softmax(logits, dim=1).cpu(), hidden


def load_trained(path: Path, device: str = "cpu") -> TrainedAgent:
    """The agent of a checkpoint. Raises `ConfigError`."""
    content = read_checkpoint(path)
    return TrainedAgent(policy_of(content, path), str(content.get("name", path.stem)), device)
