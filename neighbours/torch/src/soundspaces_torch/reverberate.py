"""Reverberation as a module, for chains of augmentation (extra ``torch``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from soundspaces_sim import ConfigError, MicrophoneArray
from soundspaces_sim.parts import as_pairs, check_pairs, pairs_of_two
from soundspaces_torch.renderer import Renderer

Hearing = Literal["binaural", "ambisonic", "monaural"]


class Reverberate(torch.nn.Module):
    """Dry signals (k, m) or (k, 1, m) as they are heard in a dataset's rooms: (k, channels, m), one pair for each.

    `pairs`: (q, 2) rows of points, of which PyTorch's generator draws, by default all of two points; a call may
    give its own. `kind`: ``binaural``, ``ambisonic``, ``monaural``, or a `MicrophoneArray`. `headings_deg`: of
    heads, drawn alike. `p`: the share of signals that are reverberated; others go to all channels as they are.
    `full`: with the reverberation after the end, (k, channels, m + n - 1). `align`: without the direct sound's time
    of travel, so that a signal and its reverberation begin together. `target_s`: a call returns also the signals
    through responses up to so many seconds after the direct sound's arrival, which an enhancer is to find.

    Gradients pass to the signals. It is a module without parameters, and does the same in training and evaluation.
    Raises `ConfigError`, `PairIndexError`.
    """

    def __init__(
        self,
        renderer: Renderer,
        pairs: ArrayLike | None = None,
        kind: Hearing | MicrophoneArray = "binaural",
        headings_deg: Sequence[float] = (0.0, 90.0, 180.0, 270.0),
        p: float = 1.0,
        full: bool = False,
        align: bool = False,
        target_s: float | None = None,
    ) -> None:
        super().__init__()
        if not isinstance(kind, MicrophoneArray) and kind not in get_args(Hearing):
            names = ", ".join(get_args(Hearing))
            raise ConfigError(f"kind: expected {names} or a MicrophoneArray, got {kind!r}")
        if not 0.0 <= p <= 1.0:
            raise ConfigError(f"p: expected 0 to 1, got {p}")
        self.headings = tuple(float(h) for h in headings_deg)
        if not self.headings or not np.isfinite(self.headings).all():
            raise ConfigError(f"headings_deg: expected one or more finite numbers, got {headings_deg!r}")
        if pairs is None:
            pairs = pairs_of_two(len(renderer.dataset.points))
        self.pairs = as_pairs(pairs)
        if len(self.pairs) == 0:
            raise ConfigError("pairs: expected at least one")
        check_pairs(self.pairs, len(renderer.dataset.points), str(renderer.dataset.path))
        self.renderer, self.kind, self.p, self.full, self.align = renderer, kind, p, full, align
        self.target_s = target_s

    def forward(
        self, samples: Tensor, pairs: ArrayLike | None = None, sample_rate: int | None = None
    ) -> Any:
        """The signals in the rooms of `pairs` (k, 2), drawn if they are not given, and their targets with
        `target_s`. `sample_rate`, if given, has to be the dataset's."""
        made = self.renderer
        if sample_rate is not None and sample_rate != made.dataset.rate:
            raise ConfigError(
                f"sample_rate: the dataset is opened at {made.dataset.rate} Hz, the signals have {sample_rate} Hz; "
                f"open it with rate={sample_rate}"
            )
        if samples.ndim not in (2, 3) or (samples.ndim == 3 and samples.shape[1] != 1):
            raise ConfigError(
                f"samples: expected mono signals, (k, m) or (k, 1, m), got {tuple(samples.shape)}"
            )
        dry = samples.reshape(len(samples), samples.shape[-1]).to(made.device)
        if pairs is None:
            pairs = self.pairs[torch.randint(len(self.pairs), (len(dry),)).numpy()]
        rows = as_pairs(pairs)
        if len(rows) != len(dry):
            raise ConfigError(f"pairs: expected one for each of {len(dry)} signals, got {len(rows)}")
        responses = self._responses(rows)
        array = self.kind if isinstance(self.kind, MicrophoneArray) else None
        chosen = (torch.rand(len(dry)) < self.p).to(made.device)[:, None, None]
        heard = self._heard(dry, responses, rows, chosen)
        if self.target_s is None:
            return heard
        early = made.until(responses, rows, self.target_s, array=array)
        return heard, self._heard(dry, early, rows, chosen)

    def _responses(self, rows: np.ndarray) -> Tensor:
        made = self.renderer
        if isinstance(self.kind, MicrophoneArray):
            return made.microphones(rows, self.kind)
        if self.kind == "ambisonic":
            return made.ambisonic(rows)
        if self.kind == "monaural":
            return made.monaural(rows)
        turns = np.array(self.headings)[torch.randint(len(self.headings), (len(rows),)).numpy()]
        return made.binaural(rows, turns)

    def _heard(self, dry: Tensor, responses: Tensor, rows: np.ndarray, chosen: Tensor) -> Tensor:
        length = dry.shape[1] + (responses.shape[2] - 1 if self.full else 0)
        wet = self.renderer.convolve(dry, responses)
        if self.align:
            points, dataset = self.renderer.dataset.points, self.renderer.dataset
            way = np.linalg.norm(points[rows[:, 0]] - points[rows[:, 1]], axis=1)
            late = np.rint(way / dataset.manifest.config.simulation.c * dataset.rate).astype(np.int64)
            at = torch.arange(length) + torch.from_numpy(late)[:, None]
            inside = (at < wet.shape[2]).to(wet.device)
            place = at.clamp(max=wet.shape[2] - 1).to(wet.device)
            wet = torch.gather(wet, 2, place[:, None].expand(-1, wet.shape[1], -1)) * inside[:, None]
        wet = wet[..., :length]
        if self.p >= 1.0:
            return wet
        plain = torch.nn.functional.pad(dry, (0, length - dry.shape[1]))[:, None].expand_as(wet)
        return torch.where(chosen, wet, plain)
