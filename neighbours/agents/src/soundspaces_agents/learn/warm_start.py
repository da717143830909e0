"""Encoders learn what can be seen and heard before agents walk: by supervision, in the table of states.

A network's features of a state are to tell the goal's direction and distance (from sound), whether a step ahead is
free (from depth), and the oracle's action (from all sensors together). The heads that say so are dropped. Targets
of this kind are those of Mirowski et al. 2017 (auxiliary depth) and Chen et al. 2021 (SAVi's goal descriptor).
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from soundspaces_agents.learn.net import ACTIONS, MOVES, Policy
from soundspaces_agents.learn.state_table import StateTable, Targets
from soundspaces_agents.presets import TrainConfig

_HIDDEN = 128


class _Heads(nn.Module):
    """`where`: cosine, sine, log(1 + distance / m); `ahead`: logit of a free step; `action`: logits."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        features = policy.config.features
        self.where = nn.Linear(features, 3) if "spectrogram" in policy.encoders else None
        self.ahead = nn.Linear(features, 1) if "depth" in policy.encoders else None
        size = policy.gru.input_size
        self.action = nn.Sequential(nn.Linear(size, _HIDDEN), nn.ReLU(), nn.Linear(_HIDDEN, ACTIONS))


def warm_start(
    policy: Policy, table: StateTable, config: TrainConfig, seed: int, device: torch.device
) -> dict[str, float]:
    """Teach the encoders of `policy` with `config.warm_batches` batches of the states from which there is a way to
    the goal, all of them in turn, in random order. Returns means over the last tenth of the batches: `loss` and the
    share of right actions, `agreement`."""
    rng = np.random.default_rng((seed, 0x3A27))
    states = np.concatenate([table.block_of_source(k) for k in range(len(table))])
    states = states[table.targets_known(states)]
    heads = _Heads(policy).to(device)
    parameters = [*policy.encoders.parameters(), *heads.parameters()]
    if policy.loudness is not None:
        parameters += policy.loudness.parameters()
    optimizer = torch.optim.Adam(parameters, config.warm_rate)
    total = config.warm_batches
    said: list[tuple[float, float]] = []
    left = np.empty(0, np.int64)
    for done in range(total):
        while len(left) < config.warm_batch:
            left = np.concatenate([left, rng.permutation(states)])
        batch, left = left[: config.warm_batch], left[config.warm_batch :]
        for group in optimizer.param_groups:
            group["lr"] = config.warm_rate * (1.0 - done / total)
        loss, right = _loss(policy, heads, table, batch, device)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        said.append((float(loss.detach()), right))
    loss_mean, agreement = np.mean(said[-max(total // 10, 1) :], axis=0)
    return {"loss": float(loss_mean), "agreement": float(agreement)}


def _loss(
    policy: Policy, heads: _Heads, table: StateTable, states: np.ndarray, device: torch.device
) -> tuple[Tensor, float]:
    """Sum of what each head loses, and the share of right actions."""
    targets = _tensors(table.targets(states), device)
    encoded = {name: _encode(policy, name, table, states, device) for name in policy.encoders}
    vectors = {name: torch.from_numpy(table.vectors(name, states)).to(device) for name in policy.vectors}
    moves = torch.randint(MOVES, (len(states),)).to(device)  # to be relied on for nothing
    logits = heads.action(policy.features(vectors, moves, encoded))
    loss = nn.functional.cross_entropy(logits, targets["action"])
    if heads.where is not None:
        wanted = torch.cat([targets["direction"], torch.log1p(targets["distance"])[:, None]], dim=1)
        loss = loss + nn.functional.mse_loss(heads.where(encoded["spectrogram"]), wanted)
    if heads.ahead is not None:
        said = heads.ahead(encoded["depth"]).squeeze(1)
        loss = loss + nn.functional.binary_cross_entropy_with_logits(said, targets["ahead"])
    return loss, float((logits.argmax(dim=1) == targets["action"]).float().mean())


def _encode(
    policy: Policy, name: str, table: StateTable, states: np.ndarray, device: torch.device
) -> Tensor:
    """(k, features) with gradients; what several states share is encoded once."""
    source, second, pose = table.place(states)
    numbers = table.numbers(
        name, source, table.first_pose[source] + pose, table.steps_of(source, second)
    )
    distinct, at = np.unique(numbers, return_inverse=True)
    pictures = torch.from_numpy(table.observe(name, distinct)).to(device)
    made: Tensor = policy.encoders[name](pictures)
    return made[torch.from_numpy(at).to(device)]


def _tensors(targets: Targets, device: torch.device) -> dict[str, Tensor]:
    return {
        "direction": torch.from_numpy(targets.direction).float().to(device),
        "distance": torch.from_numpy(targets.distance).float().to(device),
        "action": torch.from_numpy(targets.action).to(device),
        "ahead": torch.from_numpy(targets.ahead).float().to(device),
    }
