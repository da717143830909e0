"""What a tile takes of memory, before it is begun: long echograms in narrow bins take much for few pairs, too."""

from __future__ import annotations

import math
from typing import NamedTuple

from soundspaces_sim.transport.bsdf.surface import group_count
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.radiance_transfer.arrival_directions import LISTENERS
from soundspaces_sim.transport.radiance_transfer.batch_variance import moment_rows
from soundspaces_sim.transport.radiance_transfer.convolution import product_count
from soundspaces_sim.transport.radiance_transfer.pair_transfer import bands_at_once
from soundspaces_sim.transport.radiance_transfer.plan import DIRECTED, batch_edges
from soundspaces_sim.transport.radiance_transfer.time_steps import coarse_steps, stretch_steps
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, count_rows
from soundspaces_sim.transport.tile import batch_rows

_SUBPATHS = 6e6  # bytes that a point's subpaths leave, measured (docs/clusters.md)
SUBPATHS_ALONE = 3e6  # the same, without the discrete paths of its pairs, which take …
_PATHS = 1.6e4  # … so many a pair while they are put in order, measured in the demo
_SINGLE, _DOUBLE = 4, 8  # bytes of a number
_MAKING = 6  # matrices in double precision while a convolution is made, of half as many rows as steps


class TileMemory(NamedTuple):
    """Bytes: `fixed`, for each point on a side, and for each pair, both ways."""

    fixed: float
    point: float
    pair: float

    def of(self, side: int) -> float:
        """For a tile of `side` points on either side."""
        return self.fixed + 2.0 * self.point * side + self.pair * side**2

    def largest_side(self, memory: float) -> int:
        """The most points on either side for which `memory` bytes are enough; at least one."""
        left = max(memory - self.fixed, 0.0)
        side = (math.sqrt(self.point**2 + self.pair * left) - self.point) / self.pair
        return max(int(side), 1)


def tile_memory(model: Model, threads: int, same: bool = False) -> TileMemory:
    """What a tile of a model takes where `threads` threads work at it; `same`: of all pairs of one side, with one
    table and one way of transfer, and the histograms of either end of its points."""
    bins, bands = len(model.time_edges) - 1, model.world.air.shape[1]
    ways, subpaths = (1, 0.5 * SUBPATHS_ALONE) if same else (2, _SUBPATHS)
    table = _SINGLE * CHANNELS * bins * bands
    point, pair = subpaths + 2.0 * threads * table, ways * table + 3.0 * _SINGLE * bins * bands
    pair += _PATHS if same else 0.0
    pair += _SINGLE * batch_rows(model) * model.windows * bands
    groups, windows = group_count(model.world.surfaces), model.windows
    if groups:  # moments of counts, what is kept of them, and what smoothing moves
        pair += _SINGLE * windows * bands * (2.0 * count_rows(groups) + windows)
    patches = len(model.world.patches.weight)
    if not patches:
        return TileMemory(0.0, point, pair)
    edges = model.time_edges * model.config.c
    edges = edges[edges >= model.world.settings.late_length - 1e-6]
    _, step, before, steps = stretch_steps(edges)
    _, rows = coarse_steps(float(step[-1]), int(steps[-1]), model.config.c)
    products = [product_count(int(n), int(first)) for n, first in zip(steps, before, strict=True)]
    coarse = product_count(rows, 0)
    matrices = [p * int(n) for p, n in zip([*products, coarse], [*steps, rows], strict=True)]
    chunk, directed = min(CHUNK, patches), min(DIRECTED, patches)
    of_listener = CHANNELS * directed * (bands * rows + coarse)
    of_thread = LISTENERS * of_listener + int(steps.sum()) * chunk * bands
    lanes = bands_at_once(bands, threads)
    of_point = chunk * (bands * int(steps.sum()) + lanes * max(products))
    of_point += directed * bands * (rows + coarse)
    fixed = 2.0 * _SINGLE * sum(matrices) + _MAKING * _DOUBLE * max(matrices) / 3.0
    below = moment_rows(groups) - BATCHES
    # by batch, within groups of patches, below the batches and across both ends
    by_step = BATCHES + 2 + ways * (below + groups * (groups + 1))
    windows_m = batch_edges(model)
    _, _, before, steps = stretch_steps(windows_m)
    by_thread = max(product_count(int(n), int(first)) for n, first in zip(steps, before, strict=True))
    of_pair = lanes * max(products) + by_step * (len(windows_m) - 1) * bands + threads * by_thread
    return TileMemory(
        fixed + _SINGLE * threads * of_thread, point + _SINGLE * of_point, pair + _SINGLE * of_pair
    )
