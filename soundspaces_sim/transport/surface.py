"""What a wall does to a walk: choose a lobe, weigh the bands.

A wall reflects rho = 1 - absorption - transmission, of which the fraction `scattering` is diffuse
(Lambert) and the rest mirror-like; `transmission` passes straight on. Walls are two-sided.

Every band has its own lobe energies, but a walk serves all bands at once. Choosing lobes by a band
average would make the weights of the other bands grow exponentially with the number of bounces (a
factor 1.13 in variance per bounce for scattering .1 under a mean of .26). Instead each walk follows one
of several *proposals* (one per band with that band's exact probabilities, and one that explores rare
lobes), and its weight is that of the whole mixture: f_b / mean_h p_h, spectral MIS as in hero-wavelength
sampling (Wilkie et al. 2014). A band's weight is then bounded by the number of proposals for ever.
The MIS weights between path techniques use `nominal` probabilities: any function of the path alone
keeps them a partition of one.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

DIFFUSE, MIRROR, THROUGH = 0, 1, 2

# The exploring proposal: at least this probability for a lobe that carries any energy at all.
_EXPLORE_DIFFUSE = 0.25
_EXPLORE_THROUGH = 0.1


class Surfaces(NamedTuple):
    """Per material, for kernels. m materials, b bands, h = b + 1 proposals."""

    energy: np.ndarray  # (m, 3, b) energy fraction of each lobe
    proposal: np.ndarray  # (m, h, 3) probability of each lobe under each proposal
    nominal_diffuse: np.ndarray  # (m,) p_D (1 - p_T) used in MIS weights


def make_surfaces(absorption: np.ndarray, scattering: np.ndarray, transmission: np.ndarray) -> Surfaces:
    """Lobe tables from (m, b) energy fractions."""
    reflected = np.maximum(1.0 - absorption - transmission, 0.0)
    energy = np.stack([reflected * scattering, reflected * (1.0 - scattering), transmission], axis=1)
    mean = energy.mean(axis=2)
    explore = mean.copy()
    total = np.maximum(mean.sum(axis=1), 1e-300)
    for lobe, least in ((DIFFUSE, _EXPLORE_DIFFUSE), (THROUGH, _EXPLORE_THROUGH)):
        present = mean[:, lobe] > 0.0
        explore[present, lobe] = np.maximum(mean[present, lobe], least * total[present])
    proposal = np.concatenate([energy.transpose(0, 2, 1), explore[:, None, :]], axis=1)
    # A band that absorbs everything has no preference: it proposes what the average does.
    empty = proposal.sum(axis=2) <= 0.0
    proposal[empty] = np.broadcast_to(explore[:, None, :], proposal.shape)[empty]
    proposal /= np.maximum(proposal.sum(axis=2, keepdims=True), 1e-300)
    nominal = np.where(mean[:, DIFFUSE] > 0.0, proposal.mean(axis=1)[:, DIFFUSE], 0.0)
    return Surfaces(
        np.ascontiguousarray(energy), np.ascontiguousarray(proposal), np.ascontiguousarray(nominal)
    )


@njit(cache=True, forceinline=True)
def choose_lobe(proposal, material, hero, u):
    """Lobe drawn from proposal `hero` of a material, or -1 if the wall returns nothing."""
    p = proposal[material, hero]
    if p[0] + p[1] + p[2] <= 0.0:
        return -1
    if u < p[DIFFUSE]:
        return DIFFUSE
    if u < p[DIFFUSE] + p[MIRROR]:
        return MIRROR
    if p[THROUGH] > 0.0:
        return THROUGH
    return MIRROR if p[MIRROR] > 0.0 else DIFFUSE  # u within rounding of 1


@njit(cache=True, forceinline=True)
def weigh(surfaces, material, lobe, beta, mixture):
    """Update a walk's band weights `beta` (b,) and proposal ratios `mixture` (h,); True if alive.

    `mixture[h]` is p_h(walk) / mean_h p_h(walk); `beta` is f(walk) / mean_h p_h(walk).
    """
    mean = 0.0
    for h in range(len(mixture)):
        mixture[h] *= surfaces.proposal[material, h, lobe]
        mean += mixture[h]
    mean /= len(mixture)
    for h in range(len(mixture)):
        mixture[h] /= mean
    alive = False
    for b in range(len(beta)):
        beta[b] *= surfaces.energy[material, lobe, b] / mean
        alive |= beta[b] > 1e-9
    return alive
