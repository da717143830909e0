"""Proximal policy optimisation (Schulman et al. 2017) for agents with a memory.

Minibatches are of whole agents, so that the memory runs through their steps. Our own, because the GRU of the
paper and its cadence are not to be had elsewhere (sb3-contrib knows LSTM alone).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor, nn

from soundspaces_agents.learn.net import Policy
from soundspaces_agents.learn.rollout import Collector, Rollout, sample
from soundspaces_agents.presets import TrainConfig


class Loss(NamedTuple):
    """Scalars; `total` is what falls."""

    total: Tensor
    policy: Tensor
    value: Tensor
    entropy: Tensor


def advantages(rollout: Rollout, gamma: float, lam: float, bootstrap: bool) -> tuple[Tensor, Tensor]:
    """(advantages, returns) (t, n): generalised advantage estimation (Schulman et al. 2016).

    With `bootstrap` an episode that ran out of steps goes on to be worth what its last state was.
    """
    rewards = rollout.rewards + gamma * rollout.cut * bootstrap
    out = torch.zeros_like(rewards)
    following, carry = rollout.last_value, torch.zeros_like(rollout.last_value)
    for k in range(len(rewards) - 1, -1, -1):
        alive = 1.0 - rollout.ends[k]
        delta = rewards[k] + gamma * following * alive - rollout.values[k]
        carry = delta + gamma * lam * alive * carry
        out[k], following = carry, rollout.values[k]
    return out, out + rollout.values


def ppo_loss(
    logits: Tensor,
    values: Tensor,
    actions: Tensor,
    old_log_probs: Tensor,
    old_values: Tensor,
    advantage: Tensor,
    returns: Tensor,
    clip: float,
    config: TrainConfig,
) -> Loss:
    """The clipped objective of (…,) steps, logits (…, 4)."""
    log_probs = torch.log_softmax(logits, dim=-1)
    chosen = log_probs.gather(-1, actions.unsqueeze(-1)).squeeze(-1)
    ratio = torch.exp(chosen - old_log_probs)
    policy = -torch.minimum(ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage).mean()
    error = (values - returns) ** 2
    if config.clip_value:
        near = old_values + (values - old_values).clamp(-clip, clip)
        error = torch.maximum(error, (near - returns) ** 2)
    value = 0.5 * error.mean()
    entropy = -(log_probs.exp() * log_probs).sum(dim=-1).mean()
    return Loss(
        policy + config.value_weight * value - config.entropy_weight * entropy, policy, value, entropy
    )


def minibatches(count: int, parts: int, generator: torch.Generator) -> Iterator[Tensor]:
    """Agents in random order, in `parts` groups."""
    yield from torch.randperm(count, generator=generator).chunk(parts)


def make_optimizer(policy: Policy, config: TrainConfig) -> torch.optim.Adam:
    """Adam for all but the encoders, and for these."""
    encoders = list(policy.encoders.parameters())
    known = {id(p) for p in encoders}
    rest = [p for p in policy.parameters() if id(p) not in known]
    groups = [{"params": rest}, {"params": encoders}]
    return torch.optim.Adam(groups, config.learning_rate, eps=config.adam_eps)


def begin_update(
    optimizer: torch.optim.Adam, collector: Collector, config: TrainConfig, done: int
) -> float:
    """Set the learning rates of update `done`, and whether encoders learn in it; the share of updates that is left
    (1 without annealing). Encoders that were taught before learn in the last `finetune` updates alone, at a rate of
    their own, which falls to zero as well."""
    left = 1.0 - done / config.updates if config.anneal else 1.0
    rest, encoders = optimizer.param_groups
    rest["lr"] = encoders["lr"] = config.learning_rate * left
    learning = True
    if config.warm_batches:
        last = config.updates - done  # this one included
        learning = last <= config.finetune
        encoders["lr"] = config.finetune_rate * last / max(config.finetune, 1)
    collector.begin(learning)
    return left


class Ppo:
    """One learner: `update()` collects and learns. `done`: updates so far."""

    def __init__(self, policy: Policy, collector: Collector, config: TrainConfig, seed: int) -> None:
        self.policy, self.collector, self.config, self.done = policy, collector, config, 0
        self.generator = torch.Generator().manual_seed(seed)
        self.optimizer = make_optimizer(policy, config)

    def update(self) -> dict[str, float]:
        """One rollout and what is learnt from it; means over the minibatches."""
        config = self.config
        left = begin_update(self.optimizer, self.collector, config, self.done)
        rollout = self.collector.collect(config.steps, self._choose)
        advantage, returns = advantages(rollout, config.gamma, config.lam, config.bootstrap)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-5)
        losses = []
        for _ in range(config.epochs):
            for agents in minibatches(self.collector.walkers.count, config.minibatches, self.generator):
                losses.append(self._learn(rollout, advantage, returns, agents, config.clip * left))
        self.done += 1
        total, policy, value, entropy = torch.tensor(losses).mean(dim=0).tolist()
        return {"loss": total, "policy_loss": policy, "value_loss": value, "entropy": entropy}

    def _choose(self, _: object, logits: Tensor) -> tuple[Tensor, Tensor]:
        actions = sample(logits, self.generator)
        return actions, actions

    def _learn(
        self, rollout: Rollout, advantage: Tensor, returns: Tensor, agents: Tensor, clip: float
    ) -> tuple[float, ...]:
        logits, values = rollout.replay(self.policy, agents, self.collector.encodings)
        loss = ppo_loss(
            logits,
            values,
            rollout.actions[:, agents],
            rollout.log_probs[:, agents],
            rollout.values[:, agents],
            advantage[:, agents],
            returns[:, agents],
            clip,
            self.config,
        )
        self.optimizer.zero_grad()
        loss.total.backward()
        nn.utils.clip_grad_norm_(self.policy.parameters(), self.config.max_norm)
        self.optimizer.step()
        return tuple(float(part.detach()) for part in loss)
