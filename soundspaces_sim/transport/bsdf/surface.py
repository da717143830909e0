"""What a wall does to a walk: choose a lobe, weigh the bands. Only here are lobe energies read.

A wall reflects rho = 1 - absorption - transmission, of which the fraction `scattering` is diffuse
(Lambert) and the rest mirror-like; `transmission` passes straight on. Walls are two-sided.

Of a material that answers by angle (`angle`) these are means over random incidence. With g(c) what it returns
at an angle of cosine c over that mean, the mirror lobe is weighed by g(c), transmission by a ratio of its own,
and the diffuse lobe by g of both angles, f = (rho s / pi) g(c_in) g(c_out): as the mean of g is 1, it sends on
rho s g(c_in), and it is reciprocal. Lobes are drawn as if there were no angles, so densities and the weights of
techniques are what they were; only energies change, on arrival (`weigh`, `weaken`) and departure (`depart`).

Every band has its own lobe energies, but a walk serves all bands at once. Choosing lobes by a band
average alone would make the weights of the other bands grow exponentially with the number of bounces (a
factor 1.13 in variance per bounce for scattering .1 under a mean of .26). Choosing by one band alone
serves only that band. So each walk follows one *proposal* drawn from several: the average over bands,
which stays close to all bands where they are alike; each band's exact probabilities; and one that
explores rare lobes on the first bounces. The weight of a walk is that of the whole mixture,
f_b / sum_h c_h p_h, spectral MIS as in hero-wavelength sampling (Wilkie et al. 2014), so a band's weight
never exceeds 1 / c of its own proposal. The MIS weights between path techniques use `nominal`
probabilities: any function of the path alone keeps them a partition of one.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport import bsdf as lobes
from soundspaces_sim.transport.bsdf import DIFFUSE, LOBES, THROUGH
from soundspaces_sim.transport.bsdf.impedance import make_laws

# The exploring proposal: at least this probability for a lobe that carries any energy at all.
_EXPLORE_DIFFUSE = 0.25
_EXPLORE_THROUGH = 0.1
_EXPLORE_EVENTS = 3  # afterwards it is the average
_AVERAGE_SHARE, _EXPLORE_SHARE = 0.45, 0.15  # of walks; the bands share the rest


class Surfaces(NamedTuple):
    """Per material, for kernels. m materials, b bands, h = b + 2 proposals: bands, average, explore."""

    energy: np.ndarray  # (m, LOBES, b) energy fraction of each lobe
    proposal: np.ndarray  # (m, h, LOBES) probability of each lobe under each proposal
    chance: np.ndarray  # (h,) share of walks that follow each proposal
    nominal: np.ndarray  # (m, LOBES) probability in MIS weights, 0 of delta lobes
    by_angle: (
        np.ndarray
    )  # (m,) whether energies are those at random incidence, and hang on angles as follows
    zeta: np.ndarray  # (m, b) see `angle.Laws`
    ratio: np.ndarray  # (m, 2, b, 3)


def make_surfaces(
    absorption: np.ndarray,
    scattering: np.ndarray,
    transmission: np.ndarray,
    by_angle: np.ndarray | None = None,
    sheet: np.ndarray | None = None,
) -> Surfaces:
    """Lobe tables from (m, b) energy fractions; (m,) which answer by angle, and which hang free: none."""
    none = np.zeros(len(absorption), bool)
    laws = make_laws(absorption, transmission, none if sheet is None else sheet)
    reflected = np.maximum(1.0 - absorption - transmission, 0.0)
    energy = np.stack([reflected * scattering, reflected * (1.0 - scattering), transmission], axis=1)
    mean = energy.mean(axis=2)
    explore = mean.copy()
    total = np.maximum(mean.sum(axis=1), 1e-300)
    for lobe, least in ((DIFFUSE, _EXPLORE_DIFFUSE), (THROUGH, _EXPLORE_THROUGH)):
        present = mean[:, lobe] > 0.0
        explore[present, lobe] = np.maximum(mean[present, lobe], least * total[present])
    rows = [energy.transpose(0, 2, 1), mean[:, None, :], explore[:, None, :]]
    proposal = np.concatenate(rows, axis=1)
    # A band that absorbs everything has no preference: it proposes what the average does.
    empty = proposal.sum(axis=2) <= 0.0
    proposal[empty] = np.broadcast_to(mean[:, None, :], proposal.shape)[empty]
    proposal /= np.maximum(proposal.sum(axis=2, keepdims=True), 1e-300)
    nominal = np.where((mean > 0.0) & lobes.SCATTERS, proposal.mean(axis=1), 0.0)
    bands = energy.shape[2]
    chance = np.full(bands + 2, (1.0 - _AVERAGE_SHARE - _EXPLORE_SHARE) / bands)
    chance[-2:] = _AVERAGE_SHARE, _EXPLORE_SHARE
    return Surfaces(
        np.ascontiguousarray(energy), np.ascontiguousarray(proposal), chance,
        np.ascontiguousarray(nominal), none if by_angle is None else np.array(by_angle, bool), *laws,
    )  # fmt: skip


@part
def choose_hero(surfaces, u):
    """Proposal that a walk follows, from a uniform number."""
    for h in range(len(surfaces.chance)):
        u -= surfaces.chance[h]
        if u < 0.0:
            return h
    return len(surfaces.chance) - 1


@part(forceinline=True)
def _row(surfaces, hero, event):
    """Row of `proposal` that proposal `hero` means at the walk's `event`-th wall (from 1)."""
    last = len(surfaces.chance) - 1
    return last - 1 if hero == last and event > _EXPLORE_EVENTS else hero


@part(forceinline=True)
def choose_lobe(surfaces, material, hero, event, u):
    """Lobe drawn from proposal `hero` of a material, or -1 if the wall returns nothing."""
    h = _row(surfaces, hero, event)
    reached, last = 0.0, -1
    for lobe in range(LOBES):
        p = surfaces.proposal[material, h, lobe]
        if p > 0.0:
            reached, last = reached + p, lobe
            if u < reached:
                return lobe
    return last  # u within rounding of 1


@part(forceinline=True)
def _ratio(surfaces, material, lobe, cos, band):
    """What a lobe sends on from an angle, over random incidence. A diffuse lobe: the same for departure."""
    n = surfaces.ratio[material, 1 if lobes.passes(lobe) else 0, band]
    below = 1.0 + surfaces.zeta[material, band] * cos
    return max(n[0] + cos * (n[1] + cos * n[2]), 0.0) / (below * below)


@part(forceinline=True)
def _arrive(surfaces, material, lobe, cos, energy):
    """Multiply `energy` (b,) by what becomes of it by its angle of incidence."""
    if surfaces.by_angle[material]:
        for b in range(len(energy)):
            energy[b] *= _ratio(surfaces, material, lobe, cos, b)


@part(forceinline=True)
def depart(surfaces, material, lobe, cos, energy):
    """Multiply `energy` (b,) of a walk by how a lobe that scatters prefers the direction that it drew."""
    if lobes.scatters(lobe):
        _arrive(surfaces, material, lobe, cos, energy)


@part(forceinline=True)
def weigh(surfaces, material, lobe, cos_in, event, beta, mixture):
    """Update a walk's band weights `beta` (b,) and proposal ratios `mixture` (h,); True if alive.

    With p the mixture's density of the walk, `mixture[h]` is p_h / p and `beta` is f / p, but for `depart`.
    """
    mean = 0.0
    for h in range(len(mixture)):
        mixture[h] *= surfaces.proposal[material, _row(surfaces, h, event), lobe]
        mean += surfaces.chance[h] * mixture[h]
    scale = 1.0 / mean
    for h in range(len(mixture)):
        mixture[h] *= scale
    alive = False
    for b in range(len(beta)):
        beta[b] *= surfaces.energy[material, lobe, b] * scale
    _arrive(surfaces, material, lobe, cos_in, beta)
    for b in range(len(beta)):
        alive |= beta[b] > 1e-9
    return alive


@part(forceinline=True)
def weaken(surfaces, material, lobe, cos, energy, chance):
    """Multiply `energy` (b,) by what a delta lobe passes on, chosen with probability `chance`; the largest
    that is left."""
    left = 0.0
    for b in range(len(energy)):
        energy[b] *= surfaces.energy[material, lobe, b] / chance
    _arrive(surfaces, material, lobe, cos, energy)
    for b in range(len(energy)):
        left = max(left, energy[b])
    return left


@part(forceinline=True)
def total(surfaces, material, lobe):
    """Energy of a lobe at random incidence, summed over bands."""
    out = 0.0
    for b in range(surfaces.energy.shape[2]):
        out += surfaces.energy[material, lobe, b]
    return out


@part(forceinline=True)
def lobe_energy(surfaces, material, lobe, cos, band):
    """Fraction of a band's energy that a lobe takes of what comes at an angle; if it scatters, to be multiplied by
    `depart`'s factor on the way on."""
    here = surfaces.energy[material, lobe, band]
    if surfaces.by_angle[material]:
        here *= _ratio(surfaces, material, lobe, cos, band)
    return here


@part(forceinline=True)
def even_energy(surfaces, material, cos, band):
    """Sum of `lobe_energy` over the lobes that scatter evenly."""
    out = 0.0
    for lobe in range(LOBES):
        if lobes.even(lobe):
            out += lobe_energy(surfaces, material, lobe, cos, band)
    return out


@part(forceinline=True)
def can_join(surfaces, material):
    """Whether a vertex on this material can be joined: some lobe scatters."""
    for lobe in range(LOBES):
        if surfaces.nominal[material, lobe] > 0.0:
            return True
    return False


@part(forceinline=True)
def density(surfaces, material, d_in, normal, d_out):
    """Nominal density, per steradian, with which a walk that comes along `d_in` leaves along `d_out`."""
    out = 0.0
    for lobe in range(LOBES):
        if surfaces.nominal[material, lobe] > 0.0:
            out += surfaces.nominal[material, lobe] * lobes.pdf(lobe, d_in, normal, d_out)
    return out


@part(forceinline=True)
def backward(surfaces, material, d_in, normal, d_out):
    """`density` of the same bounce on the reversed path."""
    return density(
        surfaces, material, (-d_out[0], -d_out[1], -d_out[2]), normal, (-d_in[0], -d_in[1], -d_in[2])
    )


@part(forceinline=True)
def scatter(surfaces, material, d_in, normal, d_out, energy):
    """Multiply `energy` (b,) by what is scattered from `d_in` into `d_out`, per steradian."""
    cos_in = -(normal[0] * d_in[0] + normal[1] * d_in[1] + normal[2] * d_in[2])
    cos_out = normal[0] * d_out[0] + normal[1] * d_out[1] + normal[2] * d_out[2]
    for b in range(len(energy)):
        value = 0.0
        for lobe in range(LOBES):
            if surfaces.nominal[material, lobe] > 0.0:
                here = surfaces.energy[material, lobe, b] * lobes.value(lobe, d_in, normal, d_out)
                if surfaces.by_angle[material]:
                    here *= _ratio(surfaces, material, lobe, cos_in, b)
                    here *= _ratio(surfaces, material, lobe, cos_out, b)
                value += here
        energy[b] *= value


def scattered_energy(surfaces: Surfaces) -> np.ndarray:
    """(m, b) energy that a material scatters evenly at random incidence, summed over such lobes."""
    return np.asarray(surfaces.energy[:, lobes.EVEN].sum(axis=1))


def uneven_lobe(surfaces: Surfaces, materials: np.ndarray) -> str:
    """Name of a lobe by which one of these materials (rows) scatters, but not evenly; "" if there is none."""
    for lobe in np.flatnonzero(lobes.SCATTERS & ~lobes.EVEN):
        if (surfaces.energy[np.unique(materials), lobe] > 0.0).any():
            return lobes.NAMES[lobe]
    return ""
