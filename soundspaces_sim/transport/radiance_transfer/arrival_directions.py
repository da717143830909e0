"""Directions of arrival of radiance transfer: spherical-harmonic moments of the incident histograms.

The energy of a bin is that of all patches, E = sum over c of (4 / R_c) V(c) ∗ F(c). Its moments of order n are

    E_n / E = sum over c of V(c) ∗ F_n(c) / sum over c of V(c) ∗ F(c),

with F_n the incident histogram weighted with spherical harmonic Y_n (ACN, SN3D) of the direction in which the
point sees the reflection. The ratio is taken over fewer patches (`DirectedPatches`) and wider steps
(`CoarseSteps`) than E.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, thread_count
from soundspaces_sim.transport.radiance_transfer.convolution import Convolution, accumulate, transform
from soundspaces_sim.transport.radiance_transfer.first_reflections import Reflections
from soundspaces_sim.transport.radiance_transfer.pair_transfer import ROUNDING, Transfer
from soundspaces_sim.transport.radiance_transfer.patch_histograms import fill_directed
from soundspaces_sim.transport.radiance_transfer.plan import TransferPlan
from soundspaces_sim.transport.tables import CHANNELS

LISTENERS = 16  # whose histograms are held at once, by each thread


class LateEnergies(NamedTuple):
    """Energies between A and B points, decay-compensated, and what undoes that."""

    forward: np.ndarray  # (b, A, B, late bins)
    backward: np.ndarray  # (b, B, A, late bins)
    restore: np.ndarray  # (late bins, b)


class LateBins(NamedTuple):
    """Where the late bins are."""

    first: int  # among all bins
    step: np.ndarray  # (late bins,) coarse step of each


@kernel
def _deposit(
    columns: np.ndarray, energies: LateEnergies, moments: np.ndarray, bins: LateBins, table: np.ndarray
) -> None:
    """Add to the n `columns` of `table` (A, B, bins, 9, b) the mean of both directions of transfer.

    `moments` (b, A, n, 9, coarse steps): as `_convolve_moments` gives them for these columns.
    """
    for n in range(len(columns)):
        j = columns[n]
        for i in range(len(table)):
            for band in range(len(energies.forward)):
                for t in range(len(energies.restore)):
                    mean = 0.5 * (energies.forward[band, i, j, t] + energies.backward[band, j, i, t])
                    energy = mean * energies.restore[t, band]
                    if energy <= 0.0:
                        continue
                    row = table[i, j, bins.first + t]
                    row[0, band] += energy
                    of_pair, step = moments[band, i, n], bins.step[t]
                    if of_pair[0, step] > 0.0:
                        for c in range(1, CHANNELS):
                            ratio = of_pair[c, step] / of_pair[0, step]
                            row[c, band] += energy * min(max(ratio, -1.0), 1.0)


def deposit_transfer(
    plan: TransferPlan, forward: Transfer, backward: Transfer, incident: Reflections, table: np.ndarray
) -> None:
    """Add a transfer with its directions of arrival to `table` (A, B, bins, 9, b).

    `forward` from A to B points, `backward` from B to A, `incident` the first reflections of the B points.
    """
    convolution, rows = plan.coarse.convolution, plan.coarse.steps.rows
    bands, points, _, patches = forward.directed.shape
    listeners = table.shape[1]
    spectra = np.empty((bands, len(convolution.forward), 1, points, patches), np.float32)
    for band in range(bands):
        transform(convolution, forward.directed[band][:, None], spectra[band])

    energies = LateEnergies(forward.energy, backward.energy, plan.restore)
    bins = LateBins(plan.first_bin, plan.coarse.of_bin)
    blocks = -(-listeners // LISTENERS)

    def call(first: int, last: int) -> None:
        for block in range(first, last):
            columns = np.arange(block * LISTENERS, min((block + 1) * LISTENERS, listeners))
            histograms = np.zeros((bands, len(columns), rows, CHANNELS, patches), np.float32)
            scratch = np.empty(CHANNELS)
            fill_directed(columns, incident, plan.coarse.steps, plan.directed, histograms, scratch)
            pairs = zip(spectra, histograms, strict=True)
            moments = np.stack([_convolve_moments(convolution, *of_band) for of_band in pairs])
            _deposit(columns, energies, moments, bins, table)

    over_rows(call, blocks, chunk=-(-blocks // thread_count()))  # histograms for each thread


def _convolve_moments(
    convolution: Convolution, outgoing_spectra: np.ndarray, incident: np.ndarray
) -> np.ndarray:
    """V ∗ F_n summed over patches: (P, Q, 9, coarse steps), of outgoing spectra (R, 1, P, D) and incident
    histograms of Q points (Q, coarse rows, 9, D)."""
    (products, _, points, patches), (listeners, rows) = outgoing_spectra.shape, incident.shape[:2]
    spectra = np.empty((products, listeners, CHANNELS * patches), np.float32)
    histograms = incident.reshape(listeners, rows, -1)
    np.matmul(convolution.forward, histograms, out=spectra.transpose(1, 0, 2))  # in a thread already
    moments = np.zeros((1, points, listeners * CHANNELS, len(convolution.inverse)), np.float32)
    scratch = np.empty(products * points * listeners * CHANNELS, np.float32)
    columns = spectra.reshape(products, 1, -1, patches)
    accumulate(convolution, outgoing_spectra, columns, scratch, moments)
    moments = moments.reshape(points, listeners, CHANNELS, -1)
    energy = moments[:, :, 0]
    energy[energy < ROUNDING * energy.max(axis=2, keepdims=True)] = 0.0
    return moments
