"""Energy with other absorption as tensors (extra ``torch``), so that gradients pass to the absorption: what
`closure.change` says of nepers, for k echograms with counts of reflections.

Shapes: k echograms, W windows, M groups, b bands, n bins. Branches are those of `closure`; where a change is 0 the
derivative is that towards less absorption.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from soundspaces_sim import Echogram
from soundspaces_sim.parts import MOST_GAIN, MOST_RATIO, MaterialGroups, between_windows, window_strength


def log_ratios(groups: MaterialGroups, absorption: Tensor) -> Tensor:
    """(k, M, b) `refurnish.log_ratios` of absorption (k, M, b)."""
    rest = 1.0 - torch.as_tensor(groups.transmission).to(absorption)
    before = rest - torch.as_tensor(groups.absorption).to(absorption)
    return torch.log((rest - absorption) / before)


def nepers(echograms: Sequence[Echogram], x: Tensor) -> Tensor:
    """(k, b, n) nepers by which x (k, M, b), ln ρ'/ρ, changes the bins of echograms with counts."""
    of_windows = _nepers(echograms, x)
    places = []
    for echogram in echograms:
        counts, edges = echogram.counts, echogram.time_edges
        assert counts is not None
        middle = 0.5 * (edges[1:] + edges[:-1])
        places.append(between_windows(counts.time, middle, window_strength(echogram, counts)))
    before, after = (torch.from_numpy(np.stack([p[i] for p in places])).to(x.device) for i in (0, 1))
    u = torch.from_numpy(np.stack([p[2] for p in places])).to(x)
    made = (1.0 - u) * torch.gather(of_windows, 1, before) + u * torch.gather(of_windows, 1, after)
    return made.transpose(1, 2)


def _nepers(echograms: Sequence[Echogram], x: Tensor) -> Tensor:
    """(k, W, b)."""
    counts = [e.counts for e in echograms if e.counts is not None]
    mean, dispersion, anchored, correlation = (
        torch.from_numpy(np.stack([np.asarray(getattr(c, name), float) for c in counts])).to(x)
        for name in ("mean", "dispersion", "anchored", "correlation")
    )
    anchor = torch.as_tensor(np.asarray(counts[0].groups.anchor, float)).to(x)
    z = torch.expm1(x)[:, None]
    less = (z < 0.0).expand_as(mean)
    own, deviation = mean * z * z * (dispersion - 1.0), z * torch.sqrt(mean * dispersion)
    one, two = np.tril_indices(mean.shape[2], -1)
    both = correlation * deviation[:, :, one] * deviation[:, :, two]
    first, second = less[:, :, one], less[:, :, two]
    sums = []
    for side, pair in ((less, first & second), (~less, ~first & ~second)):
        spread = torch.where(side, own, 0.0).sum(2) + 2.0 * torch.where(pair, both, 0.0).sum(2)
        sums.append((torch.where(side, mean * z, 0.0).sum(2), spread))
    (down, of_down), (up, of_up) = sums
    cross = torch.where(first != second, both, 0.0).sum(2)
    amplified = 1.0 / ((1.0 - _ratio(down, of_down)) * (1.0 - _ratio(up, of_up)))
    third = _third(mean, dispersion, anchored, anchor, z).sum(2)
    return _gamma(down, of_down) + _gamma(up, of_up) + cross * amplified + third


def _third(mean: Tensor, dispersion: Tensor, anchored: Tensor, anchor: Tensor, z: Tensor) -> Tensor:
    t = torch.where(anchor != 0.0, z / torch.where(anchor != 0.0, anchor, 1.0), 0.0)
    m = mean * anchor
    off = _generating(m, (anchored - 1.0) * anchor) - _gamma(m, m * anchor * (dispersion - 1.0))
    order = off * t.clamp(0.0, 1.0) ** 3 * t.clamp(min=1.0) ** 2
    return torch.where((mean > 0.0) & (t > 0.0), order, 0.0)


def _ratio(m: Tensor, f: Tensor) -> Tensor:
    known = m != 0.0
    r = f / torch.where(known, m, 1.0)
    return torch.where(known, torch.minimum(r, torch.where(m < 0.0, MOST_RATIO, MOST_GAIN).to(r)), 0.0)


def _gamma(m: Tensor, f: Tensor) -> Tensor:
    return _generating(m, _ratio(m, f))


def _generating(m: Tensor, r: Tensor) -> Tensor:
    r = r.clamp(max=MOST_RATIO)
    small = r.abs() < 1e-6
    safe = torch.where(small, 0.5, r)
    # to the first order where r is small, so that it has a derivative there
    return torch.where(small, m * (1.0 + 0.5 * r), -m * torch.log1p(-safe) / safe)
