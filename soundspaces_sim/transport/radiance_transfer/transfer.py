"""Acoustic radiance transfer as a technique: late paths that a patch scatters (equations: the package's
docstring).

Both directions of every pair, p → q and q → p, estimate the same energy with different transfer subpaths; a pair
gets their mean.
"""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from soundspaces_sim.core.numerics.kernel import over_rows, rows_of_thread
from soundspaces_sim.core.profile import stage
from soundspaces_sim.transport.radiance_transfer.arrival_directions import deposit_transfer
from soundspaces_sim.transport.radiance_transfer.batch_moments import (
    BatchProducts,
    Crossed,
    PairEnergies,
    add_batches,
    make_bin_steps,
)
from soundspaces_sim.transport.radiance_transfer.pair_transfer import Transfer, make_endpoints, transfer
from soundspaces_sim.transport.radiance_transfer.plan import TransferPlan, make_transfer_plan
from soundspaces_sim.transport.tile import Sums, Tile, Walks

_PAIRS = 128  # for which it is worth to start a thread


def join(tile: Tile, of_a: Walks, of_b: Walks, sums: Sums) -> None:
    """Add the late energy of every pair that a patch scatters."""
    model = tile.model
    if not model.world.settings.radiance_transfer:
        return
    with stage("plan"):
        plan = make_transfer_plan(model)
    with stage("endpoints"):
        a, b = of_a.once(make_endpoints), of_b.once(make_endpoints)
    with threadpool_limits(limits=1, user_api="blas"):  # threads are ours
        forward, backward, products = transfer(plan, a, b)
        with stage("directions of arrival"):
            deposit_transfer(plan, forward, backward, b.reflections, sums.to_b)
            if not tile.same and sums.to_a.shape[2] > 0:
                deposit_transfer(plan, backward, forward, a.reflections, sums.to_a)
    with stage("energy by batch"):
        _add_error_bars(plan, forward, backward, products, tile, sums)


def _add_error_bars(
    plan: TransferPlan,
    forward: Transfer,
    backward: Transfer,
    products: BatchProducts,
    tile: Tile,
    sums: Sums,
) -> None:
    """Add the energy by batch, counts of reflections and the difference of the directions to those of a tile."""
    windows = tile.model.world.window_of_bin[plan.first_bin :]
    bins = make_bin_steps(plan.windows, plan.edges, windows)
    shape = plan.windows.total, plan.moment_rows + 1
    for band in range(plan.bands):
        restore = np.ascontiguousarray(plan.restore[:, band])
        energies = PairEnergies(forward.energy[band], backward.energy[band], restore)
        arguments = tile.pairs, energies, _of_band(products, band), bins, sums.batches[..., band]
        over_rows(
            add_batches, len(tile.pairs), *arguments, scratch=lambda: np.empty(shape), least=_PAIRS
        )
        _add_difference(sums.difference[..., band], energies)


def _of_band(products: BatchProducts, band: int) -> BatchProducts:
    there, back = (Crossed(*(table[band] for table in way)) for way in (products.there, products.back))
    return BatchProducts(*(table[band] for table in products[:4]), there, back)


def _add_difference(difference: np.ndarray, energies: PairEnergies) -> None:
    """Add half of what both directions differ by to `difference` (A, B, last bins).

    That misses the part of their noise that both owe to the first reflections of the two endpoints.
    """
    bins = difference.shape[2]
    forward, backward, restore = energies
    late = restore[len(restore) - bins :]

    def call(first: int, last: int) -> None:
        for i in range(first, last):
            apart = (forward[i] - backward[:, i])[:, forward.shape[2] - bins :]
            difference[i] += 0.5 * late * apart

    over_rows(call, len(difference), least=rows_of_thread(difference))
