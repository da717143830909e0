"""Some steps of many agents, kept as tensors: what PPO and DAgger learn from."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from soundspaces_sim.nav.learn.encoding_cache import EncodingCache
from soundspaces_sim.nav.learn.net import Policy, moves_of
from soundspaces_sim.nav.vector import AudioNavVectorEnv

#: (walks, logits) -> actions to take and labels to learn (n,); PPO has no labels.
Choose = Callable[[list[Any], Tensor], tuple[Tensor, Tensor]]
_RECENT = 400  # episodes of which running means are made


@dataclass
class Rollout:
    """Tensors (t, n, …), `hidden` (n, h) before the first step; `cut`: value of the state in which an episode ran
    out of steps, else 0; `last_value` (n,) of the state after the last step. `pictures`: of sensors that have an
    encoder, the distinct observations (m, …) and which of them each step had (t, n)."""

    observations: dict[str, Tensor]
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
    pictures: dict[str, tuple[Tensor, Tensor]]

    def replay(self, policy: Policy, agents: Tensor) -> tuple[Tensor, Tensor]:
        """(logits (t, k, 4), values (t, k)) that `policy` has for the steps of some agents (k,), with gradients."""
        encoded = {}
        for name, (pictures, numbers) in self.pictures.items():
            rows, at = torch.unique(numbers[:, agents], return_inverse=True)
            encoded[name] = policy.encoders[name](pictures[rows])[at]
        seen = {name: values[:, agents] for name, values in self.observations.items()}
        return policy.sequence(
            seen, self.moves[:, agents], self.starts[:, agents], self.hidden[agents], encoded
        )


class Collector:
    """Agents under way in `env`, SAME_STEP; `recent`: (success, spl) of episodes that ended lately."""

    def __init__(self, env: AudioNavVectorEnv, policy: Policy, seed: int) -> None:
        self.env, self.policy = env, policy
        observations, _ = env.reset(seed=seed)
        self.observations = _tensors(observations)
        n = env.num_envs
        self.hidden, self.starts = policy.start(n), torch.ones(n)
        self.moves = torch.zeros(n, dtype=torch.long)
        self.recent: deque[tuple[float, float]] = deque(maxlen=_RECENT)
        self.episodes = 0

    @torch.no_grad()
    def collect(self, steps: int, choose: Choose) -> Rollout:
        """The next `steps` steps of every agent."""
        policy, first = self.policy, self.hidden
        rows: dict[str, list[Tensor]] = {
            k: [] for k in "moves starts actions labels log_probs values rewards ends cut".split()
        }
        caches = {name: EncodingCache(encoder) for name, encoder in policy.encoders.items()}  # type: ignore[arg-type]
        seen: dict[str, list[Tensor]] = {name: [] for name in policy.shapes}
        for _ in range(steps):
            encoded = {name: cache.encode(self.observations[name]) for name, cache in caches.items()}
            logits, values, hidden = policy.step(
                self.observations,
                self.moves,
                self.hidden * (1.0 - self.starts).unsqueeze(1),
                {name: made for name, (_, made) in encoded.items()},
            )
            actions, labels = choose(self.env.states, logits)
            log_probs = torch.log_softmax(logits, dim=1).gather(1, actions[:, None]).squeeze(1)
            for name, values_seen in self.observations.items():
                seen[name].append(encoded[name][0] if name in encoded else values_seen)
            rows["moves"].append(self.moves)
            rows["starts"].append(self.starts)
            observations, rewards, terminated, truncated, infos = self.env.step(actions.numpy())
            self._note(infos)
            self.hidden = hidden
            rows["cut"].append(self._value_of_cut(truncated, infos, actions, hidden))
            ends = torch.from_numpy(terminated | truncated)
            self.observations, self.starts = _tensors(observations), ends.float()
            self.moves = moves_of(actions, _bumps(self.observations, len(ends)), self.starts)
            for key, value in (
                ("actions", actions),
                ("labels", labels),
                ("log_probs", log_probs),
                ("values", values),
                ("rewards", torch.from_numpy(rewards).float()),
                ("ends", self.starts),
            ):
                rows[key].append(value)
        _, last, _ = policy.step(
            self.observations, self.moves, self.hidden * (1.0 - self.starts).unsqueeze(1)
        )
        stacked = {name: torch.stack(parts) for name, parts in seen.items()}
        return Rollout(
            observations={name: values for name, values in stacked.items() if name not in caches},
            pictures={name: (cache.pictures(), stacked[name]) for name, cache in caches.items()},
            hidden=first,
            last_value=last,
            **{key: torch.stack(parts) for key, parts in rows.items()},
        )

    def _note(self, infos: dict[str, Any]) -> None:
        if "final_info" in infos:
            final, mask = infos["final_info"], infos["_final_info"]
            self.episodes += int(mask.sum())
            self.recent.extend(
                zip(final["success"][mask].tolist(), final["spl"][mask].tolist(), strict=True)
            )

    def _value_of_cut(
        self, truncated: np.ndarray, infos: dict[str, Any], actions: Tensor, hidden: Tensor
    ) -> Tensor:
        """(n,) value of the state that an episode was cut off in."""
        out = torch.zeros(len(truncated))
        rows = np.flatnonzero(truncated)
        if len(rows) == 0:
            return out
        final = infos["final_obs"]
        observations = {
            name: torch.from_numpy(np.stack([final[i][name] for i in rows])) for name in final[rows[0]]
        }
        index = torch.from_numpy(rows)
        moves = moves_of(actions[index], _bumps(observations, len(rows)), torch.zeros(len(rows)))
        out[index] = self.policy.step(observations, moves, hidden[index])[1]
        return out

    def means(self) -> dict[str, float]:
        """Success and SPL of episodes that ended lately."""
        if not self.recent:
            return {"success": 0.0, "spl": 0.0}
        success, spl = np.mean(self.recent, axis=0)
        return {"success": float(success), "spl": float(spl)}


def _tensors(observations: dict[str, np.ndarray]) -> dict[str, Tensor]:
    return {name: torch.from_numpy(values) for name, values in observations.items()}


def _bumps(observations: dict[str, Tensor], count: int) -> Tensor:
    """(n,) whether agents feel that they have run into something; those without the sensor do not."""
    if "collision" in observations:
        return observations["collision"][:, 0] > 0.5
    return torch.zeros(count, dtype=torch.bool)


def sample(logits: Tensor, generator: torch.Generator) -> Tensor:
    """(n,) actions drawn by their probabilities."""
    return torch.multinomial(torch.softmax(logits, dim=1), 1, generator=generator).squeeze(1)
