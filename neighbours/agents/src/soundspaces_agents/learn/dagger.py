"""DAgger (Ross, Gordon & Bagnell 2011): the oracle says what is right wherever the agent itself goes.

At first the oracle acts, too; the share of agents that it leads falls linearly to none.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn

from soundspaces_agents.learn.net import Policy
from soundspaces_agents.learn.ppo import begin_update, make_optimizer, minibatches
from soundspaces_agents.learn.rollout import Collector, Rollout, sample
from soundspaces_agents.learn.walkers import Walkers
from soundspaces_agents.presets import TrainConfig


class Dagger:
    """One learner: `update()` collects and learns. `done`: updates so far."""

    def __init__(self, policy: Policy, collector: Collector, config: TrainConfig, seed: int) -> None:
        self.policy, self.collector, self.config, self.done = policy, collector, config, 0
        self.generator = torch.Generator().manual_seed(seed)
        # Its learning rate stays: with what the oracle says it has no noise to average out.
        self.optimizer = make_optimizer(policy, replace(config, anneal=False))

    def update(self) -> dict[str, float]:
        """One rollout, labelled, and what is learnt from it: the mean cross-entropy and share of right actions."""
        begin_update(self.optimizer, self.collector, replace(self.config, anneal=False), self.done)
        rollout = self.collector.collect(self.config.steps, self._choose)
        losses = []
        for _ in range(self.config.epochs):
            for agents in minibatches(
                self.collector.walkers.count, self.config.minibatches, self.generator
            ):
                losses.append(self._learn(rollout, agents))
        self.done += 1
        loss, right = torch.tensor(losses).mean(dim=0).tolist()
        return {"loss": loss, "agreement": right}

    def _choose(self, walkers: Walkers, logits: Tensor) -> tuple[Tensor, Tensor]:
        labels = torch.from_numpy(walkers.oracle_actions())
        led = 1.0 - self.done / max(self.config.oracle_share * self.config.updates, 1.0)
        own = sample(logits, self.generator).cpu()
        draw = torch.rand(walkers.count, generator=self.generator)
        self.collector.led |= (draw < led).numpy()
        taken = torch.where(draw < led, labels, own)
        return taken.to(logits.device), labels.to(logits.device)

    def _learn(self, rollout: Rollout, agents: Tensor) -> tuple[float, float]:
        logits, _ = rollout.replay(self.policy, agents, self.collector.encodings)
        labels = rollout.labels[:, agents]
        loss = nn.functional.cross_entropy(logits.flatten(0, 1), labels.flatten())
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.policy.parameters(), self.config.max_norm)
        self.optimizer.step()
        return float(loss.detach()), float((logits.argmax(dim=2) == labels).float().mean())
