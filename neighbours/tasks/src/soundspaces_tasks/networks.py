"""Small networks, trained on one core (extra ``torch``): convolutions over time and a recurrent layer.

What is kept is the network of the least loss on the homes of the split val, of twenty looks in a training. One seed
gives one result, for any number of cores.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from soundspaces_sim import SimulationError

Loss = Callable[[Tensor, Tensor], Tensor]
Augment = Callable[[Tensor, Tensor, torch.Generator], tuple[Tensor, Tensor]]
_BATCH, _STEP, _DECAY, _LARGEST_GRADIENT = 32, 2e-3, 1e-3, 1.0
_LOOKS = 20  # at the split val


class Regressor(nn.Module):
    """(n, frames, features) to (n, outputs): two convolutions over time, a GRU, means over time."""

    def __init__(self, features: int, outputs: int, width: int = 48) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv1d(features, width, 5, 2), nn.ReLU(), nn.Conv1d(width, width, 5, 2), nn.ReLU()
        )
        self.memory = nn.GRU(width, width, batch_first=True)
        self.out = nn.Linear(2 * width, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Predictions."""
        seen = self.convolutions(x.transpose(1, 2)).transpose(1, 2)
        kept, _ = self.memory(seen)
        return self.out(torch.cat([kept.mean(1), seen.mean(1)], 1))  # type: ignore[no-any-return]


class Mask(nn.Module):
    """(n, frames, bins) of compressed magnitudes to gains between 0 and 1 of the same shape: a GRU over frames."""

    def __init__(self, bins: int, width: int = 96) -> None:
        super().__init__()
        self.into = nn.Sequential(nn.Linear(bins, width), nn.ReLU())
        self.memory = nn.GRU(width, width, batch_first=True)
        self.out = nn.Linear(2 * width, bins)

    def forward(self, x: Tensor) -> Tensor:
        """Gains."""
        seen = self.into(x)
        kept, _ = self.memory(seen)
        return torch.sigmoid(self.out(torch.cat([seen, kept], 2)))


class Attention(nn.Module):
    """Curves (n, k, t) of references, with features (n, k, f) of each, to a curve (n, t): a weighted mean of the
    references, and a correction that depends on that mean and on the features' weighted mean."""

    def __init__(self, features: int, times: int, width: int = 32) -> None:
        super().__init__()
        self.weigh = nn.Sequential(nn.Linear(features, width), nn.ReLU(), nn.Linear(width, 1))
        self.correct = nn.Sequential(
            nn.Linear(features + times, width), nn.ReLU(), nn.Linear(width, times)
        )
        self.times = times

    def forward(self, x: Tensor) -> Tensor:
        """Curves of x (n, k, t + f): curves, then features."""
        curves, features = x[..., : self.times], x[..., self.times :]
        share = torch.softmax(self.weigh(features), 1)
        mean, about = (share * curves).sum(1), (share * features).sum(1)
        return mean + self.correct(torch.cat([about, mean], 1))  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Data:
    """Inputs (n, …) and targets (n, …) of a split, float32."""

    x: np.ndarray
    y: np.ndarray


def train(
    make: Callable[[], nn.Module],
    data: Data,
    val: Data,
    loss: Loss,
    seed: int,
    updates: int,
    augment: Augment | None = None,
) -> Callable[[np.ndarray], np.ndarray]:
    """A function from inputs to predictions, learnt by AdamW in `updates`; the best of all looks at `val`."""
    torch.set_num_threads(1)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        net = make()
    return _fitted(net, data, val, loss, seed, updates, augment)


def _fitted(
    net: nn.Module,
    data: Data,
    val: Data,
    loss: Loss,
    seed: int,
    updates: int,
    augment: Augment | None,
) -> Callable[[np.ndarray], np.ndarray]:
    generator = torch.Generator().manual_seed(seed)
    adam = torch.optim.AdamW(net.parameters(), _STEP, weight_decay=_DECAY)
    x, y, val_y = (torch.from_numpy(np.asarray(a, np.float32)) for a in (data.x, data.y, val.y))
    best, kept = float("inf"), {k: v.clone() for k, v in net.state_dict().items()}
    every = -(-updates // _LOOKS)
    for step, rows in zip(range(1, updates + 1), _batches(len(x), generator), strict=False):
        a, b = x[rows], y[rows]
        if augment is not None:
            a, b = augment(a, b, generator)
        net.train()
        adam.zero_grad()
        loss(net(a), b).backward()
        nn.utils.clip_grad_norm_(net.parameters(), _LARGEST_GRADIENT)
        adam.step()
        if step % every and step < updates:
            continue
        now = float(loss(torch.from_numpy(_applied(net, val.x)), val_y))
        if not np.isfinite(now):
            raise SimulationError(f"training: expected a finite loss on the split val, got {now}")
        if now < best:
            best, kept = now, {k: v.clone() for k, v in net.state_dict().items()}
    net.load_state_dict(kept)
    return lambda inputs: _applied(net, inputs)


def _batches(count: int, generator: torch.Generator) -> Iterator[Tensor]:
    """Rows of batches without end: all examples in a drawn order, again and again."""
    while True:
        yield from torch.randperm(count, generator=generator).split(_BATCH)


def _applied(net: nn.Module, inputs: np.ndarray) -> np.ndarray:
    net.eval()
    with torch.no_grad():
        parts = torch.from_numpy(np.asarray(inputs, np.float32)).split(256)
        return torch.cat([net(part) for part in parts]).numpy()
