"""A dataset as PyTorch wants it (extra ``torch``): map-style, any number of workers, fork or spawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.reading.dataset import RirDataset


class TorchRirDataset(Dataset[dict[str, Any]]):
    """Items are dicts: ``rir`` (2, `samples`) or (9, `samples`) float32, cut or padded with zeros, and
    ``source``, ``listener`` (3,) m, ``pair`` (2,), ``heading_deg``.

    `pairs`: (k, 2) rows of points, by default all. `headings_deg`: one is drawn per item, from the item
    and `seed` alone.
    """

    def __init__(
        self,
        dataset: RirDataset,
        pairs: np.ndarray | None = None,
        samples: int | None = None,
        kind: str = "binaural",
        headings_deg: Sequence[float] = (0.0, 90.0, 180.0, 270.0),
        seed: int = 0,
    ) -> None:
        if kind not in ("binaural", "ambisonic"):
            raise ConfigError(f"kind: expected binaural or ambisonic, got {kind!r}")
        self.dataset, self.kind, self.seed = dataset, kind, seed
        self.pairs = (
            np.array(list(dataset)) if pairs is None else np.asarray(pairs, np.int64).reshape(-1, 2)
        )
        self.samples = samples or int(np.ceil(dataset.manifest.duration * dataset.rate))
        self.headings = tuple(float(h) for h in headings_deg)

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, item: int) -> dict[str, Any]:
        s, l = (int(i) for i in self.pairs[item])
        heading = self.headings[
            int(np.random.default_rng((self.seed, item)).integers(len(self.headings)))
        ]
        if self.kind == "binaural":
            rir = self.dataset.binaural(s, l, heading)
        else:
            rir = self.dataset.ambisonic(s, l)
        fixed = np.zeros((rir.shape[0], self.samples), np.float32)
        count = min(self.samples, rir.shape[1])
        fixed[:, :count] = rir[:, :count]
        return {
            "rir": torch.from_numpy(fixed),
            "source": torch.from_numpy(self.dataset.points[s].astype(np.float32)),
            "listener": torch.from_numpy(self.dataset.points[l].astype(np.float32)),
            "pair": torch.tensor([s, l]),
            "heading_deg": heading,
        }
