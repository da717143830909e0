"""What a pair has of its own, beside which faint paths are not heard."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.transport.tile import Tile


def pair_energies(tile: Tile, bands: int) -> np.ndarray:
    """(A, B, bands) J/m² of direct sound and the discrete paths so far in the lowest bands, summed by size, so that
    both ways have the same bits."""
    tables, pairs = tile.discrete.values(), tile.walls.size
    pair = np.concatenate([np.arange(pairs), *(paths.pair for paths in tables)])
    direct = tile.direct[:, :, :bands].reshape(pairs, bands)
    energy = np.concatenate([direct, *(paths.energy[:, :bands] for paths in tables)])
    total = np.empty((pairs, bands))
    for b in range(bands):
        order = np.lexsort((energy[:, b], pair))
        total[:, b] = np.bincount(pair[order], energy[order, b], pairs)
    return total.reshape(*tile.walls.shape, bands)
