"""Steps of path length in which patch histograms are resolved, from the bins of the echogram.

The bins of an echogram are wider late than early. A stretch is a run of late bins of equal width. Every stretch has
steps of its bins' width from length zero on, in which outgoing and incident histograms are convolved; of the result
the steps of the stretch's own bins are kept.

A path of lengths l1 + l2 falls into step floor(l1 / h + 1/4) + floor(l2 / h + 1/4) of width h. Either length
loses a quarter of a step in the mean, together the half that rounding l1 + l2 down would lose.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.echogram.denoise_plan import equal_bins
from soundspaces_sim.transport.radiance_transfer.convolution import Convolution, make_convolution

_DIRECTED_S = 0.02  # resolution of directions of arrival


class TimeSteps(NamedTuple):
    """Steps of S stretches. A histogram has a row for every step of every stretch."""

    step: np.ndarray  # (S,) m, width
    offset: np.ndarray  # (S,) m by which the edges of the bins are off multiples of the step
    steps: np.ndarray  # (S,) up to the end of the stretch
    base: np.ndarray  # (S + 1,) row at which those of a stretch start
    outgoing_shift: float  # in steps: that of l1 above
    incident_shift: float  # in steps: that of l2

    @property
    def rows(self) -> int:
        """Of a histogram."""
        return int(self.base[-1])


class Stretch(NamedTuple):
    """A stretch outside kernels."""

    rows: slice  # of a histogram
    bins: slice  # of the echogram's late bins
    convolution: Convolution


class CoarseSteps(NamedTuple):
    """Wider steps, in which directions of arrival are resolved, of a single stretch."""

    steps: TimeSteps
    ratio: int  # of their width to that of the last stretch's, whose rows they sum
    convolution: Convolution
    of_bin: np.ndarray  # (late bins,) step of the convolution in which the middle of a bin lies


def stretch_steps(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the S stretches of equal bins between `edges`, m: bins at which they begin and end (S + 1,), their step,
    m, steps of it before them, and steps up to their end."""
    bounds = equal_bins(np.diff(edges))
    starts, ends = bounds[:-1], bounds[1:]
    step = (edges[ends] - edges[starts]) / (ends - starts)
    before = np.floor(edges[starts] / step + 1e-6).astype(np.int64)
    return bounds, step, before, before + ends - starts


def coarse_steps(step: float, steps: int, c: float) -> tuple[int, int]:
    """How many of a stretch's `steps` of `step` m make one coarse step, and how many coarse steps there are;
    `c` m/s."""
    ratio = max(round(_DIRECTED_S * c / step), 1)
    return ratio, -(-steps // ratio)


def make_stretches(edges: np.ndarray) -> tuple[TimeSteps, list[Stretch]]:
    """Stretches of equal bins between `edges`, m."""
    bounds, step, before, steps = stretch_steps(edges)
    starts, ends = bounds[:-1], bounds[1:]
    base = np.concatenate([[0], np.cumsum(steps)])
    offset = np.maximum(edges[starts] - before * step, 0.0)
    rows = [slice(*r) for r in pairwise(base)]
    bins = [slice(*r) for r in zip(starts, ends, strict=True)]
    convolutions = [make_convolution(*n) for n in zip(steps, before, strict=True)]
    stretches = [Stretch(*s) for s in zip(rows, bins, convolutions, strict=True)]
    return TimeSteps(step, offset, steps, base, 0.25, 0.25), stretches


def make_coarse(fine: TimeSteps, edges: np.ndarray, c: float) -> CoarseSteps:
    """Steps of about `_DIRECTED_S` for late bins between `edges`, m, of the stretches `fine`; `c` m/s."""
    step, offset, steps = float(fine.step[-1]), float(fine.offset[-1]), int(fine.steps[-1])
    ratio, rows = coarse_steps(step, steps, c)
    middles = 0.5 * (edges[1:] + edges[:-1])
    of_bin = np.clip(((middles - offset) / (ratio * step)).astype(np.int64), 0, rows - 1)
    # Outgoing rows are sums of fine ones, which were shifted by less.
    shift = fine.outgoing_shift / ratio
    base = np.array([0, rows])
    wide = TimeSteps(
        np.array([ratio * step]), np.array([offset]), np.array([rows]), base, shift, 0.5 - shift
    )
    first = int(of_bin[0])
    return CoarseSteps(wide, ratio, make_convolution(rows, first), of_bin - first)


def coarse_rows(coarse: CoarseSteps, histograms: np.ndarray) -> np.ndarray:
    """(n, coarse rows, columns): the rows of the last stretch (n, rows, columns), summed by coarse steps."""
    out = np.zeros((len(histograms), coarse.steps.rows, histograms.shape[2]), np.float32)
    for n in range(coarse.ratio):
        every = histograms[:, n :: coarse.ratio]
        out[:, : every.shape[1]] += every
    return out


@part(forceinline=True)
def outgoing_row(steps: TimeSteps, s: int, length: float) -> int:
    """Row in stretch `s` of an outgoing histogram after `length` m, -1 past its end."""
    i = int(length / steps.step[s] + steps.outgoing_shift)
    return steps.base[s] + i if i < steps.steps[s] else -1


@part(forceinline=True)
def incident_row(steps: TimeSteps, s: int, length: float) -> int:
    """Row in stretch `s` of an incident histogram after `length` m, -1 past its end."""
    i = int(max(length - steps.offset[s], 0.0) / steps.step[s] + steps.incident_shift)
    return steps.base[s] + i if i < steps.steps[s] else -1
