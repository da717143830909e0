"""Some steps of many agents, kept as tensors: what PPO and DAgger learn from."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from soundspaces_agents.learn.encodings import Encodings
from soundspaces_agents.learn.net import Policy, moves_of
from soundspaces_agents.learn.walkers import Step, Walkers

#: (walkers, logits) -> actions to take and labels to learn (n,); PPO has no labels.
Choose = Callable[[Walkers, Tensor], tuple[Tensor, Tensor]]
_RECENT = 400  # episodes of which running means are made
_EPSILON = 1e-8


@dataclass
class Rollout:
    """Tensors (t, n, …), `hidden` (n, h) before the first step; `cut`: value of the state in which an episode ran
    out of steps, else 0; `last_value` (n,) of the state after the last step. `numbers`: of sensors that have an
    encoder, which observation each step had; `encoded`: what the encoder made of it."""

    observations: dict[str, Tensor]
    numbers: dict[str, Tensor]
    encoded: dict[str, Tensor]
    moves: Tensor
    starts: Tensor
    hidden: Tensor
    actions: Tensor
    labels: Tensor
    log_probs: Tensor
    values: Tensor
    rewards: Tensor
    ends: Tensor
    cut: Tensor
    last_value: Tensor

    def replay(
        self, policy: Policy, agents: Tensor, encodings: dict[str, Encodings]
    ) -> tuple[Tensor, Tensor]:
        """(logits (t, k, 4), values (t, k)) that `policy` has for the steps of some agents (k,), with gradients."""
        encoded = {}
        for name, of in encodings.items():
            if of.learning:
                pictures, at = of.pictures(self.numbers[name][:, agents])
                encoded[name] = policy.encoders[name](pictures)[at]
            else:
                encoded[name] = self.encoded[name][:, agents]
        seen = {name: values[:, agents] for name, values in self.observations.items()}
        return policy.sequence(
            seen, self.moves[:, agents], self.starts[:, agents], self.hidden[agents], encoded
        )


class RewardScale:
    """Divides rewards by the standard deviation of discounted returns so far (Engstrom et al. 2020, section 3)."""

    def __init__(self, count: int, gamma: float) -> None:
        self.gamma, self.returns = gamma, np.zeros(count)
        self.seen, self.mean, self.squares = 0.0, 0.0, 0.0

    def __call__(self, rewards: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Rewards (n,) of a step, scaled; `ends`: whose episode is over."""
        self.returns = self.returns * self.gamma + rewards
        # Chan, Golub & LeVeque's update of mean and sum of squares by a batch.
        n, mean = float(len(rewards)), float(self.returns.mean())
        total, off = self.seen + n, mean - self.mean
        self.squares += float(np.square(self.returns - mean).sum()) + off * off * self.seen * n / total
        self.mean, self.seen = self.mean + off * n / total, total
        self.returns[ends] = 0.0
        return np.asarray(rewards / np.sqrt(self.squares / self.seen + _EPSILON))


class Collector:
    """Agents under way among `walkers`; `recent`: (success, spl) of episodes that ended lately and that agents
    walked alone; `led` (n,): who was led in this episode, as `choose` says."""

    def __init__(
        self,
        walkers: Walkers,
        policy: Policy,
        seed: int,
        scale: RewardScale | None = None,
        device: str | torch.device = "cpu",
    ) -> None:
        self.walkers, self.policy, self.scale = walkers, policy, scale
        self.device = torch.device(device)
        walkers.reset(seed)
        n = walkers.count
        self.hidden = policy.start(n).to(self.device)
        self.starts = torch.ones(n, device=self.device)
        self.moves = torch.zeros(n, dtype=torch.long, device=self.device)
        self.encodings = {
            name: Encodings(name, encoder, walkers.table, self.device)
            for name, encoder in policy.encoders.items()
        }
        self._feels = "collision" in policy.shapes
        self.recent: deque[tuple[float, float]] = deque(maxlen=_RECENT)
        self.episodes = 0
        self.led = np.zeros(n, bool)

    def begin(self, learning: bool) -> None:
        """Before an update in which encoders learn, or the first one in which they do not."""
        for encodings in self.encodings.values():
            if learning or encodings.learning:
                encodings.begin(learning)

    def _observe(
        self, source: np.ndarray, pose: np.ndarray, steps: np.ndarray
    ) -> tuple[dict[str, Tensor], dict[str, np.ndarray], dict[str, Tensor]]:
        """(observations without encoder, numbers of the others, what encoders make of them) of agents."""
        table = self.walkers.table
        numbers = {name: table.numbers(name, source, pose, steps) for name in self.encodings}
        states = table.state_numbers(source, pose, steps)
        return (
            {
                name: torch.from_numpy(table.vectors(name, states)).to(self.device)
                for name in self.policy.vectors
            },
            numbers,
            {name: of.of(numbers[name]) for name, of in self.encodings.items()},
        )

    @torch.no_grad()
    def collect(self, steps: int, choose: Choose) -> Rollout:
        """The next `steps` steps of every agent."""
        walkers, policy, first = self.walkers, self.policy, self.hidden
        rows: dict[str, list[Tensor]] = {
            k: [] for k in "moves starts actions labels log_probs values rewards ends cut".split()
        }
        parts: dict[str, dict[str, list[Tensor]]] = {"observations": {}, "numbers": {}, "encoded": {}}
        for _ in range(steps):
            seen, numbers, encoded = self._observe(walkers.source, walkers.pose, walkers.steps)
            alive = self.hidden * (1.0 - self.starts).unsqueeze(1)
            logits, values, hidden = policy.step(seen, self.moves, alive, encoded)
            actions, labels = choose(walkers, logits)
            log_probs = torch.log_softmax(logits, dim=1).gather(1, actions[:, None]).squeeze(1)
            as_tensors = {name: torch.from_numpy(of) for name, of in numbers.items()}
            for what, found in (("observations", seen), ("numbers", as_tensors), ("encoded", encoded)):
                for name, value in found.items():
                    parts[what].setdefault(name, []).append(value)
            rows["moves"].append(self.moves)
            rows["starts"].append(self.starts)
            step = walkers.step(actions.cpu().numpy())
            self._note(step)
            self.hidden = hidden
            rewards = step.rewards if self.scale is None else self.scale(step.rewards, step.ends)
            rows["cut"].append(self._value_of_cut(step, actions, hidden))
            ends = self._floats(step.ends)
            self.moves = moves_of(actions, self._bumps(walkers.collided), ends)
            self.starts = ends
            for key, value in (
                ("actions", actions),
                ("labels", labels),
                ("log_probs", log_probs),
                ("values", values),
                ("rewards", self._floats(rewards)),
                ("ends", ends),
            ):
                rows[key].append(value)
        seen, _, encoded = self._observe(walkers.source, walkers.pose, walkers.steps)
        alive = self.hidden * (1.0 - self.starts).unsqueeze(1)
        last = policy.step(seen, self.moves, alive, encoded)[1]
        observations, kept, features = (
            {name: torch.stack(values) for name, values in parts[what].items()} for what in parts
        )
        stacked = {key: torch.stack(values) for key, values in rows.items()}
        return Rollout(
            observations=observations,
            numbers=kept,
            encoded=features,
            hidden=first,
            last_value=last,
            moves=stacked["moves"],
            starts=stacked["starts"],
            actions=stacked["actions"],
            labels=stacked["labels"],
            log_probs=stacked["log_probs"],
            values=stacked["values"],
            rewards=stacked["rewards"],
            ends=stacked["ends"],
            cut=stacked["cut"],
        )

    def _floats(self, values: np.ndarray) -> Tensor:
        return torch.from_numpy(values).float().to(self.device)

    def _bumps(self, collided: np.ndarray) -> Tensor:
        """(n,) whether agents feel that they have run into something; those without the sensor do not."""
        return torch.from_numpy(collided & self._feels).to(self.device)

    def _note(self, step: Step) -> None:
        self.episodes += len(step.measures)
        alone = ~self.led[step.ended]
        self.recent.extend(
            (m.success, m.spl) for m, own in zip(step.measures, alone, strict=True) if own
        )
        self.led[step.ended] = False

    def _value_of_cut(self, step: Step, actions: Tensor, hidden: Tensor) -> Tensor:
        """(n,) value of the state that an episode was cut off in."""
        out = torch.zeros(self.walkers.count, device=self.device)
        cut = step.truncated[step.ended]
        if not cut.any():
            return out
        seen, _, encoded = self._observe(step.source[cut], step.pose[cut], step.steps[cut])
        index = torch.from_numpy(step.ended[cut]).to(self.device)
        bumps = self._bumps(step.collided[cut])
        moves = moves_of(actions[index], bumps, torch.zeros(len(index), device=self.device))
        out[index] = self.policy.step(seen, moves, hidden[index], encoded)[1]
        return out

    def means(self) -> dict[str, float]:
        """Success and SPL of episodes that ended lately."""
        if not self.recent:
            return {"success": 0.0, "spl": 0.0}
        success, spl = np.mean(self.recent, axis=0)
        return {"success": float(success), "spl": float(spl)}

    def snapshot(self) -> dict[str, Any]:
        """All that decides what comes next."""
        scale = None
        if self.scale is not None:
            s = self.scale
            scale = {"returns": s.returns.tolist(), "seen": s.seen, "mean": s.mean, "squares": s.squares}
        return {
            "walkers": self.walkers.snapshot(),
            "hidden": self.hidden.cpu(),
            "starts": self.starts.cpu(),
            "moves": self.moves.cpu(),
            "recent": [list(row) for row in self.recent],
            "episodes": self.episodes,
            "led": self.led.tolist(),
            "scale": scale,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a `snapshot`."""
        self.walkers.restore(state["walkers"])
        for name in ("hidden", "starts", "moves"):
            setattr(self, name, state[name].to(self.device))
        self.recent.clear()
        self.recent.extend((a, b) for a, b in state["recent"])
        self.episodes = int(state["episodes"])
        self.led = np.array(state["led"], bool)
        if self.scale is not None and state["scale"] is not None:
            saved = state["scale"]
            self.scale.returns = np.array(saved["returns"])
            self.scale.seen, self.scale.mean = saved["seen"], saved["mean"]
            self.scale.squares = saved["squares"]


def sample(logits: Tensor, generator: torch.Generator) -> Tensor:
    """(n,) actions drawn by their probabilities, by a generator of the processor on whatever device."""
    chances = torch.softmax(logits, dim=1).cpu()
    return torch.multinomial(chances, 1, generator=generator).squeeze(1).to(logits.device)
