"""Kernels of this room: plane waves added up at a point, and single rays."""

import math

import numpy as np

from soundspaces_sim.base.kernel import kernel
from soundspaces_sim.rays.geometry import cast


@kernel
def gather(out, spectra, turns, weights):
    """Add to `out` (C, F) the waves `spectra` (K, F), wave k times exp(i turns[k] f) and weights[k] (C,)."""
    for k in range(spectra.shape[0]):
        step = complex(math.cos(turns[k]), math.sin(turns[k]))
        z = complex(1.0, 0.0)
        for f in range(spectra.shape[1]):
            value = np.complex64(spectra[k, f] * z)
            for c in range(out.shape[0]):
                out[c, f] += weights[k, c] * value
            z *= step


@kernel
def probe(geometry, x, y, z, dx, dy, dz, limit):
    """(distance, triangle) of the nearest surface along a unit direction; (inf, -1) if none within `limit`."""
    return cast(geometry, x, y, z, dx, dy, dz, limit)
