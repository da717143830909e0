"""Where energy enters a table.

A table row is (bins, 9, bands): energy, then the energy-weighted real spherical harmonics of the
arrival direction (ACN order, SN3D), so that channel 0 is the energy itself.
"""

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import part

CHANNELS = 9
BATCHES = 16  # interleaved batches of subpaths: error bars with 15 degrees of freedom


@part(forceinline=True)
def copy(source: np.ndarray, target: np.ndarray) -> None:
    """Copy a row: kernels know no allocation, which assigning slices would need."""
    for k in range(len(target)):
        target[k] = source[k]


@part(forceinline=True)
def harmonics(x: float, y: float, z: float, out: np.ndarray) -> None:
    """Nine real spherical harmonics of a unit direction, ACN order, SN3D (AmbiX) into `out`."""
    out[0] = 1.0
    out[1] = y
    out[2] = z
    out[3] = x
    root3 = math.sqrt(3.0)
    out[4] = root3 * x * y
    out[5] = root3 * y * z
    out[6] = 0.5 * (3.0 * z * z - 1.0)
    out[7] = root3 * x * z
    out[8] = 0.5 * root3 * (x * x - y * y)


@part(forceinline=True)
def time_bin(length: float, bin_of_step: np.ndarray, step: float) -> int:
    """Row of the table for a path length in metres, or -1 past its end."""
    i = int(length / step)
    if i >= len(bin_of_step):
        return -1
    return bin_of_step[i]


@part(forceinline=True)
def absorb_air(energy: np.ndarray, air: np.ndarray, step: float, length: float) -> None:
    """Attenuate band energies (b,) by the air along a path; `air` (steps, b) is given every `step` m."""
    i = int(length / step)
    frac = length / step - i
    for band in range(len(energy)):
        energy[band] *= air[i, band] + frac * (air[i + 1, band] - air[i, band])


@part(forceinline=True, fastmath={"contract"})
def deposit(row: np.ndarray, bin_index: int, directions: np.ndarray, energy: np.ndarray) -> None:
    """Add a path's band energies (b,) with arrival harmonics (9,) to a table row."""
    for c in range(CHANNELS):
        y = np.float32(directions[c])
        for b in range(len(energy)):
            row[bin_index, c, b] += y * energy[b]


@part(forceinline=True)
def deposit_batch(batches: np.ndarray, batch: int, window: int, energy: np.ndarray) -> None:
    """Add a path's band energies to its batch: `batches` is (BATCHES, windows, b)."""
    for b in range(len(energy)):
        batches[batch, window, b] += energy[b]


def count_rows(groups: int) -> int:
    """Rows below the batches for so many groups of materials: counts n_m, what each group's anchor takes
    (`taken`), and products n_m n_k, k <= m, in `product_row`s."""
    return 2 * groups + groups * (groups + 1) // 2


@part(forceinline=True)
def product_row(groups: int, m: int, k: int) -> int:
    """Row of n_m n_k, k <= m, among all rows."""
    return BATCHES + 2 * groups + m * (m + 1) // 2 + k


@part(forceinline=True)
def deposit_counts(
    batches: np.ndarray, counts: np.ndarray, kept: np.ndarray, window: int, energy: np.ndarray
) -> None:
    """Add a path's band energies, times its counts of reflections (groups,), what is `taken` from it if each keeps
    `kept` (groups, b), and products of two counts, to the `count_rows` below its batches."""
    for m in range(len(counts)):
        if counts[m] > 0:
            for b in range(len(energy)):
                batches[BATCHES + m, window, b] += counts[m] * energy[b]
                batches[BATCHES + len(counts) + m, window, b] += taken(kept[m, b], counts[m]) * energy[b]
            for k in range(m + 1):
                if counts[k] > 0:
                    both, at = float(counts[m]) * counts[k], product_row(len(counts), m, k)
                    for b in range(len(energy)):
                        batches[at, window, b] += both * energy[b]


@part(forceinline=True)
def taken(kept: float, count: int) -> float:
    """What `count` reflections take away, each of which keeps so much: 1 - kept^n, negative where it keeps more."""
    return 1.0 - kept ** np.int64(count)
