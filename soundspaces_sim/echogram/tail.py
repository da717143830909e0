"""Continuation of the tail of an echogram over empty bins.

Late in a decay few simulated paths are left, and bins with energy stand between empty ones, which would be
rendered as isolated bursts of noise. From a band's first empty bin on, once all but a thousandth of its energy
has arrived, energy and moments of a few filled bins and the gaps between them are spread along the band's own
decay, the last of them to the end of the time grid. The energy of every such group stays as it is.
"""

from __future__ import annotations

import numpy as np

_LATE = 1e-3  # share of a band's energy that may be spread
_FIT = (0.3, 1e-3)  # shares left between which the decay is fitted, about -5 to -30 dB
_FILLED = 4  # bins with energy in a group


def continued(energy: np.ndarray, time_edges: np.ndarray) -> np.ndarray:
    """(bins, 9, b) energies and moments without holes in their tails; `time_edges` (bins + 1,) s."""
    out = energy.copy()
    for band in range(energy.shape[2]):
        _continue(out[:, :, band], np.asarray(time_edges, float))
    return out


def _continue(energy: np.ndarray, edges: np.ndarray) -> None:
    """In place, one band (bins, 9)."""
    total = energy[:, 0].astype(float)
    left = total[::-1].cumsum()[::-1]  # from each bin on
    if not left[0] > 0.0:
        return
    left /= left[0]
    filled = total > 0.0
    start = np.flatnonzero((left < _LATE) & ~filled)
    rate = _decay(left, edges)
    if len(start) == 0 or rate is None or not filled[start[0] :].any():
        return
    first = int(start[0])
    before: np.ndarray = np.cumsum(filled[first:]) - filled[first:]
    group = before // _FILLED
    last = int(group[filled[first:]].max())
    if last > 0 and filled[first:][group == last].sum() < _FILLED:
        last -= 1
    group = np.minimum(group, last)
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    low, high = edges[first:-1], edges[first + 1 :]
    origin = low[starts][group]
    weight = np.exp(-rate * (low - origin)) - np.exp(-rate * (high - origin))
    weight /= np.add.reduceat(weight, starts)[group]
    sums = np.add.reduceat(energy[first:].astype(float), starts, axis=0)
    energy[first:] = weight[:, None] * sums[group]


def _decay(left: np.ndarray, edges: np.ndarray) -> float | None:
    """Rate in 1/s at which the share that is left falls, or None if fewer than three bins are left to fit."""
    use = (left <= _FIT[0]) & (left >= _FIT[1])
    if use.sum() < 3:
        return None
    slope = float(np.polyfit(edges[:-1][use], np.log(left[use]), 1)[0])
    return -slope if slope < 0.0 else None
